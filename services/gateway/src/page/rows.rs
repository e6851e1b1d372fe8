//! message → one row per period for the page, and the last minute of rows.

use crate::page::round;
use protocol::message::{Plan, PlantState};
use serde::{Serialize, Serializer};
use std::collections::VecDeque;

/// Length of the history that a late viewer receives \[s\].
const KEPT_S: f64 = 60.0;
/// Shortest time between stored rows \[s\].
const SPACING_S: f64 = 0.04;

/// A row of a history.
pub(super) trait Row {
    /// Simulated time \[s\].
    fn seconds(&self) -> f64;
    /// Takes the values of a row that is not stored, if they must not be missed.
    fn absorb(&mut self, skipped: &Self);
}

/// A measured state. As JSON: `[t, x, y, yaw, speed, fallback_level, reason]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StateRow {
    pub(super) seconds: f64,
    pose: [f64; 3],
    speed: f64,
    fallback_level: u32,
    reason: u32,
}

impl StateRow {
    pub(super) fn new(state: &PlantState, seconds: f64) -> Self {
        let [forward, left, _] = state.velocity;
        Self {
            seconds,
            pose: state.pose,
            speed: forward.hypot(left),
            fallback_level: state.fallback_level,
            reason: state.cause().code(),
        }
    }
}

impl Row for StateRow {
    fn seconds(&self) -> f64 {
        self.seconds
    }

    fn absorb(&mut self, skipped: &Self) {
        if skipped.fallback_level > self.fallback_level {
            (self.fallback_level, self.reason) = (skipped.fallback_level, skipped.reason);
        }
    }
}

impl Serialize for StateRow {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [x, y, yaw] = self.pose.map(round);
        (round(self.seconds), x, y, yaw, round(self.speed), self.fallback_level, self.reason)
            .serialize(serializer)
    }
}

/// An answer. As JSON: `[t, reference x, reference y, error, residual, innovation, yaw residual,
/// yaw innovation, tick time, version, fallback_level]`, where residual and innovation are lengths
/// in the plane, and the time is in µs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlanRow {
    pub(super) seconds: f64,
    reference: [f64; 2],
    pub(super) error: f64,
    residual: [f64; 3],
    innovation: [f64; 3],
    tick_nanos: u64,
    version: u64,
    fallback_level: u32,
}

impl PlanRow {
    pub(super) fn new(plan: &Plan, seconds: f64) -> Self {
        let [reference, ..] = &plan.reference;
        Self {
            seconds,
            reference: [reference[0], reference[1]],
            error: plan.position_error(),
            residual: plan.residual,
            innovation: plan.innovation,
            tick_nanos: plan.tick_nanos,
            version: plan.model_version,
            fallback_level: plan.fallback_level,
        }
    }
}

impl Row for PlanRow {
    fn seconds(&self) -> f64 {
        self.seconds
    }

    fn absorb(&mut self, skipped: &Self) {
        self.tick_nanos = self.tick_nanos.max(skipped.tick_nanos);
        self.error = self.error.max(skipped.error);
    }
}

impl Serialize for PlanRow {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [x, y] = self.reference.map(round);
        let plane = |[forward, left, _]: [f64; 3]| round(forward.hypot(left));
        let errors = (
            plane(self.residual),
            plane(self.innovation),
            round(self.residual[2].abs()),
            round(self.innovation[2].abs()),
        );
        let row =
            (round(self.seconds), x, y, round(self.error), errors.0, errors.1, errors.2, errors.3);
        let cost = ((self.tick_nanos as f64 * 1e-3).round(), self.version, self.fallback_level);
        (row.0, row.1, row.2, row.3, row.4, row.5, row.6, row.7, cost.0, cost.1, cost.2)
            .serialize(serializer)
    }
}

/// The last minute, thinned.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
pub(super) struct History<R> {
    rows: VecDeque<R>,
}

impl<R: Row> History<R> {
    pub(super) fn new() -> Self {
        Self { rows: VecDeque::new() }
    }

    pub(super) fn clear(&mut self) {
        self.rows.clear();
    }

    pub(super) fn push(&mut self, row: R) {
        match self.rows.back_mut() {
            // Half a row early counts as in time. Else a topic of exactly that spacing would lose
            // every other row.
            Some(last) if row.seconds() - last.seconds() < SPACING_S * 0.75 => last.absorb(&row),
            _ => self.rows.push_back(row),
        }
        let newest = self.rows.back().map_or(0.0, Row::seconds);
        while self.rows.front().is_some_and(|row| newest - row.seconds() > KEPT_S)
            || self.rows.len() > Self::rows_max()
        {
            self.rows.pop_front();
        }
    }

    /// Time may stand still; memory does not grow.
    fn rows_max() -> usize {
        (KEPT_S / (SPACING_S * 0.75)) as usize + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn plan(tick_nanos: u64) -> Plan {
        Plan { tick_nanos, residual: [3.0, 4.0, -0.5], ..Plan::zeroed() }
    }

    #[test]
    fn a_history_keeps_at_most_a_minute_of_any_number_of_rows() {
        let mut history = History::new();
        for tick in 0..200_000 {
            history.push(PlanRow::new(
                &plan(if tick == 199_990 { 9_000 } else { 1_000 }),
                f64::from(tick) * 1e-3,
            ));
        }
        let (first, last) = (
            history.rows.front().map_or(0.0, Row::seconds),
            history.rows.back().map_or(0.0, Row::seconds),
        );
        assert!((59.9..=60.0).contains(&(last - first)), "{first} to {last}");
        assert!(history.rows.len() <= History::<PlanRow>::rows_max());
        assert!(
            history.rows.iter().any(|row| row.tick_nanos == 9_000),
            "a late tick was thinned away"
        );
    }

    #[test]
    fn rows_have_the_layout_that_the_page_reads() -> serde_json::Result<()> {
        let state = PlantState {
            pose: [1.000_000_4, 2.0, f64::NAN],
            velocity: [3.0, 4.0, 1.0],
            fallback_level: 5,
            reason: 2,
            ..PlantState::zeroed()
        };
        assert_eq!(
            serde_json::to_string(&StateRow::new(&state, 0.1))?,
            "[0.1,1.0,2.0,null,5.0,5,2]"
        );
        let stopped = PlantState { fallback_level: 6, reason: 6, stop: 17, ..PlantState::zeroed() };
        let row = serde_json::to_string(&StateRow::new(&stopped, 0.1))?;
        assert!(row.ends_with(",6,17]"), "why it stopped, not the last refusal: {row}");
        assert_eq!(
            serde_json::to_string(&PlanRow::new(&plan(412_300), 0.1))?,
            "[0.1,0.0,0.0,0.0,5.0,0.0,0.5,0.0,412.0,0,0]"
        );
        Ok(())
    }
}
