//! Exchanges settings and goals between two ticks, and reports the progress of a goal.

use super::Controller;
use super::tuning::Tuned;
use crate::goal::{Course, Outlook};
use protocol::message::Goal;

/// Interval at which the present goal is told \[s\].
const GOAL_EVERY_S: f64 = 0.1;

impl Controller {
    /// Exchanges the parts that depend on settings, for the answer to the first tick from `tick`
    /// on. Called between two ticks. Planning continues from the previous plan. Does not allocate
    /// or free.
    pub fn tune(&mut self, tuned: &mut Tuned, tick: u64) {
        if tuned.reference.is_some() {
            self.guard.approach_reference();
        }
        tuned.since = Some((self.plant_epoch.unwrap_or(0), tick));
        self.planner.tune(tuned, &mut self.knowledge);
    }

    /// From now on the robot holds its pose when a plant starts, in place of the reference.
    pub fn hold_at_start(&mut self) {
        self.holds_at_start = true;
    }

    /// Writes the way ahead into `outlook`. False before the first plan, and without a measurement.
    /// Does not allocate if `outlook` has room.
    pub fn look_out(&self, outlook: &mut Outlook) -> bool {
        let (Some(plant_epoch), Some(before)) = (self.plant_epoch, self.before) else {
            return false;
        };
        (outlook.plant_epoch, outlook.gate) = (plant_epoch, self.gate);
        (outlook.pose, outlook.velocity) = (before.state.pose, before.state.velocity);
        (outlook.goal, outlook.held_up) = (self.goal.active(), self.held_up);
        self.planner.write_ahead(outlook)
    }

    /// Follows `course` from the answer to `tick` on. False if it is too late for that: then
    /// nothing has changed. What is no longer needed is in `course` afterwards. Does not allocate
    /// or free.
    pub fn follow(&mut self, course: &mut Course, tick: u64) -> bool {
        let goal = &course.goal;
        let is_due = (goal.begins_at_tick..=course.latest_tick).contains(&tick);
        if !is_due || self.plant_epoch != Some(goal.plant_epoch) {
            return false;
        }
        self.holds_at_start = true;
        self.goal.follow(course);
        self.guard.approach_reference();
        self.planner.follow(&mut course.reference, &mut self.knowledge);
        true
    }

    /// What is to be told of the goal after the answer to `tick`, one message at a time.
    pub fn told_goal(&mut self, tick: u64) -> Option<Goal> {
        let every = (GOAL_EVERY_S / self.period_s).ceil() as u64;
        self.goal.told(tick, every)
    }
}
