//! Goals of a scenario, each at its time.

use super::{Demand, GoalError, GoalRequest};
use ::settings::Impossible;
use motion::limits::Stated;
use serde::{Deserialize, Serialize};

/// Number of the first goal of a schedule. Requests of operators count from 1.
pub const FIRST_ID: u64 = 1_000_001;

/// A goal, and when it is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scheduled {
    /// Time since the start of the run \[s\].
    pub at_s: f64,
    /// What the robot shall do.
    pub goal: Demand,
    /// Stricter limits for it.
    #[serde(default)]
    pub limits: Stated,
}

/// Checks goals, as far as that is possible without a robot.
///
/// # Errors
/// [`Impossible`] names the first bad one.
pub fn check(goals: &[Scheduled]) -> Result<(), Impossible> {
    goals.iter().enumerate().try_for_each(|(index, goal)| {
        goal.check().map_err(|error| Impossible::new(format!("goals[{index}]"), error.to_string()))
    })
}

impl Scheduled {
    fn check(&self) -> Result<(), GoalError> {
        if !(self.at_s.is_finite() && self.at_s >= 0.0) {
            return Err(GoalError::Schedule { at_s: self.at_s });
        }
        self.request().check()
    }

    fn request(&self) -> GoalRequest {
        GoalRequest { limits: self.limits, ..GoalRequest::of(self.goal.clone()) }
    }
}

/// The goals that have not been given yet.
#[derive(Debug)]
pub struct Schedule {
    /// Tick, number and request of each, the next one last.
    waiting: Vec<(u64, u64, GoalRequest)>,
}

impl Schedule {
    /// The goals of a scenario with a period of `period_s` \[s\].
    pub fn new(goals: &[Scheduled], period_s: f64) -> Self {
        let goals = goals.iter().zip(FIRST_ID..);
        let mut waiting: Vec<_> = goals
            .map(|(goal, id)| ((goal.at_s / period_s).round() as u64, id, goal.request()))
            .collect();
        waiting.sort_by_key(|(tick, id, _)| std::cmp::Reverse((*tick, *id)));
        Self { waiting }
    }

    /// The number and the request of the last goal that is due at `tick`. Those before it are
    /// dropped.
    pub fn due(&mut self, tick: u64) -> Option<(u64, GoalRequest)> {
        let mut due = None;
        while self.waiting.last().is_some_and(|(at, ..)| *at <= tick) {
            due = self.waiting.pop().map(|(_, id, request)| (id, request));
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_goal_is_due_once_at_its_tick() {
        let goal = |at_s| Scheduled { at_s, goal: Demand::Hold {}, limits: Stated::default() };
        let mut schedule = Schedule::new(&[goal(2.0), goal(1.0)], 0.1);
        let due: Vec<(u64, u64)> =
            (0..40).filter_map(|tick| schedule.due(tick).map(|(id, _)| (tick, id))).collect();
        assert_eq!(due, [(10, FIRST_ID + 1), (20, FIRST_ID)]);
    }

    #[test]
    fn a_goal_at_no_time_is_refused() {
        let goal = Scheduled { at_s: f64::NAN, goal: Demand::Hold {}, limits: Stated::default() };
        assert!(matches!(goal.check(), Err(GoalError::Schedule { .. })));
    }
}
