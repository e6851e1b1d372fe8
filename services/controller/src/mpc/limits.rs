//! The limits of a running optimiser: those of the robot, and obstacles.

use super::constraint::{Limits, RobotLimit};
use super::{Mpc, Stage};
use crate::currents::Foretold;
use model::State;
use robot::{Obstacle, WHEELS_MAX};

impl Mpc {
    /// Limits of wheels and state.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// From now on the current rows of these wheels are inactive.
    pub fn drop_current_rows(&mut self, wheels: [bool; WHEELS_MAX]) {
        if self.limits.dropped() != wheels {
            self.limits.drop_current_rows(wheels);
            self.expectation = None;
        }
    }

    /// From now on plans keep to a floor that can hold this share of the limit on currents.
    pub fn keep_to_grip(&mut self, grip: f64) {
        if self.limits.keep_to_grip(grip) {
            self.expectation = None;
        }
    }

    /// From now on plans keep to a drive that changes the rim speeds of its set points by no more
    /// than this in a period, if there is such a bound \[m/s\].
    pub fn keep_to_ramp(&mut self, rim: Option<f64>) {
        if self.limits.keep_to_ramp(rim) {
            self.expectation = None;
        }
    }

    /// Motor currents that the last plan predicts for its first period.
    pub fn foretold_currents(&self) -> Foretold {
        self.first_period()
            .map_or(Foretold::default(), |(first, end)| self.limits.foretold_currents(first, end))
    }

    /// The limit of the robot that the last plan reaches in its first period, if it reaches one.
    pub fn reached_limit(&self) -> Option<RobotLimit> {
        let (first, end) = self.first_period()?;
        self.limits.reached(first, end, &self.last_input)
    }

    /// The first period of the last plan, and the state at its end.
    fn first_period(&self) -> Option<(&Stage, &State)> {
        let end = self.stages.get(1).map_or(&self.terminal, |stage| &stage.state);
        self.stages.first().map(|first| (first, end))
    }

    /// Sets the obstacles around the plan: where they are when it begins. A program that was
    /// written for others is dropped. Does not allocate.
    pub fn see_obstacles(&mut self, seen: impl Iterator<Item = Obstacle>) {
        let state = self.stages.first().map_or(self.terminal, |stage| stage.state);
        if let Some(around) = self.limits.obstacles_mut() {
            around.choose(&state, self.horizon, seen);
            self.expectation = None;
        }
    }

    /// Whether an obstacle holds the last plan.
    pub fn is_held_by_obstacle(&self) -> bool {
        self.held_by_obstacle
    }
}

#[cfg(test)]
mod tests;
