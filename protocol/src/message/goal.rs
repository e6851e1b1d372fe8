//! controller → watchers: what the robot has been told to do, and how far it is.

use super::define::message;
use super::{GoalKind, GoalPhase};

message! {
    /// The present goal, several times a second and at each change of its phase. Without a goal,
    /// the robot follows the reference of its scenario, and nothing is published.
    Goal = 9 {
        /// Number of the goal: that of the request with which it was given.
        id: u64,
        /// Epoch of the plant whose ticks count.
        plant_epoch: u64,
        /// First tick whose reference belongs to the goal.
        begins_at_tick: u64,
        /// First tick at which its reference stands still.
        ends_at_tick: u64,
        /// Pose at its end (x, y, yaw) \[m, m, rad\].
        target: [f64; 3],
        /// Share of its time that has passed, from 0 to 1. It stands while the gate is shut.
        progress: f64,
        /// Way that the reference still has to its end \[m\].
        left_m: f64,
        /// Time that it still takes \[s\].
        left_s: f64,
        /// [`GoalKind`] of the goal.
        kind: u32 = code(GoalKind),
        /// [`GoalPhase`] of the goal.
        phase: u32 = code(GoalPhase),
    }
}

impl Goal {
    /// Kind of the goal.
    pub fn kind(&self) -> GoalKind {
        GoalKind::try_from(self.kind).unwrap_or(GoalKind::Hold)
    }

    /// Phase of the goal.
    pub fn phase(&self) -> GoalPhase {
        GoalPhase::try_from(self.phase).unwrap_or(GoalPhase::Aborted)
    }
}
