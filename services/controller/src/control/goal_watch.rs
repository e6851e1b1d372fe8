//! How far the robot is on the way to its goal.

use crate::goal::Course;
use crate::reference::Reference;
use model::{State, wrap};
use protocol::message::{Goal, GoalKind, GoalPhase};

/// Distance, heading, speed and yaw rate within which the robot stands at its goal
/// \[m, rad, m/s, rad/s\].
const ARRIVED: (f64, f64, f64, f64) = (0.01, 0.02, 0.02, 0.05);

/// The present goal.
#[derive(Debug, Default)]
pub(super) struct GoalWatch {
    goal: Option<Goal>,
    left_m: Vec<f64>,
    /// The goal before, with its last phase, until it is told.
    ended: Option<Goal>,
    /// Whether the phase has changed since it was told.
    is_new: bool,
    /// Tick at which the goal was told last.
    told_at: u64,
}

impl GoalWatch {
    /// Whether a goal has been given.
    pub(super) fn has_goal(&self) -> bool {
        self.goal.is_some()
    }

    /// Number of the goal that the robot is on the way to.
    pub(super) fn active(&self) -> Option<u64> {
        self.goal.filter(|goal| goal.phase() == GoalPhase::Active).map(|goal| goal.id)
    }

    /// Takes the goal of `course`. The memory of the one before goes into `course`. A goal with the
    /// number of the one before is the same goal on another way.
    pub(super) fn follow(&mut self, course: &mut Course) {
        let active = self.goal.filter(|goal| goal.phase() == GoalPhase::Active);
        let another = active.filter(|goal| goal.id != course.goal.id);
        self.ended = another.map(|goal| Goal { phase: GoalPhase::Preempted.code(), ..goal });
        self.goal = Some(course.goal);
        std::mem::swap(&mut self.left_m, &mut course.left_m);
        self.is_new = true;
    }

    /// Whether the goal is a velocity, and its time is over at `tick`.
    pub(super) fn is_past_velocity(&self, tick: u64) -> bool {
        self.goal.is_some_and(|goal| {
            goal.phase() == GoalPhase::Active
                && goal.kind() == GoalKind::Velocity
                && tick >= goal.ends_at_tick
        })
    }

    /// The goal cannot be reached any more: the plant has restarted and counts its ticks anew, or
    /// the time of a velocity has passed while the robot was held.
    pub(super) fn abort(&mut self) {
        if let Some(goal) = &mut self.goal {
            goal.phase = GoalPhase::Aborted.code();
            self.is_new = true;
        }
    }

    /// Looks where the robot is when the time of the reference is `reference_tick`.
    pub(super) fn look(
        &mut self,
        reference_tick: u64,
        period_s: f64,
        robot: &State,
        reference: &Reference,
    ) {
        let Some(goal) = self.goal.as_mut().filter(|goal| goal.phase() != GoalPhase::Aborted)
        else {
            return;
        };
        let done = reference_tick.saturating_sub(goal.begins_at_tick) as usize;
        goal.left_m = self.left_m.get(done).copied().unwrap_or(0.0);
        let left = goal.ends_at_tick.saturating_sub(reference_tick);
        goal.left_s = left as f64 * period_s;
        let whole = goal.ends_at_tick.saturating_sub(goal.begins_at_tick);
        goal.progress = 1.0 - left as f64 / whole.max(1) as f64;
        if goal.phase() == GoalPhase::Active && left == 0 && stands(robot, reference, goal) {
            goal.phase = GoalPhase::Reached.code();
            self.is_new = true;
        }
    }

    /// What is to be told of the goals: each change of a phase, and the present goal every
    /// `every` ticks.
    pub(super) fn told(&mut self, tick: u64, every: u64) -> Option<Goal> {
        let is_due = self.is_new || tick >= self.told_at + every || tick < self.told_at;
        let mut goal = if let Some(ended) = self.ended.take() {
            ended
        } else {
            let goal = self.goal.filter(|_| is_due)?;
            (self.is_new, self.told_at) = (false, tick);
            goal
        };
        goal.stamp.tick = tick;
        Some(goal)
    }
}

fn stands(robot: &State, reference: &Reference, goal: &Goal) -> bool {
    let end = reference.at(goal.ends_at_tick).pose;
    let [forward, left, rate] = robot.velocity;
    (robot.pose[0] - end[0]).hypot(robot.pose[1] - end[1]) <= ARRIVED.0
        && wrap(robot.pose[2] - end[2]).abs() <= ARRIVED.1
        && forward.hypot(left) <= ARRIVED.2
        && rate.abs() <= ARRIVED.3
}

#[cfg(test)]
mod tests;
