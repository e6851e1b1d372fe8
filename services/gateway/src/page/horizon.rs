//! Plan → the predicted path, and its uncertainty.
//!
//! The variance of the learned residual is that of one period's velocity error. Errors are taken as
//! independent between periods, along the axes of the body, and without correction. With q the
//! variance of one period, T its length, and e ← e + w, p ← p + T (e + w/2),
//!
//! P ← P + 2 T C + T² V + T² q/4,  C ← C + T V + T q/2,  V ← V + q.

use super::round;
use protocol::message::Plan;
use serde::Serialize;

/// The plan of the controller.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Horizon {
    /// Simulated time \[s\].
    t: f64,
    /// x, y, yaw \[m, m, rad\].
    predicted: Vec<[f64; 3]>,
    /// x, y \[m\].
    reference: Vec<[f64; 2]>,
    /// Standard deviation of the position ahead and to the left, at each predicted pose \[m\].
    deviation: Vec<[f64; 2]>,
}

impl Horizon {
    /// The horizon of `plan`, at the time `seconds` and with periods of length `period` \[s\].
    pub(super) fn new(plan: &Plan, seconds: f64, period: f64) -> Self {
        let steps = plan.horizon as usize + 1;
        let rows = || plan.predicted.iter().zip(&plan.reference).take(steps);
        let mut spread = [Spread::default(); 2];
        let deviation = plan.variance.iter().take(steps).map(|variance| {
            let deviation = spread.map(|axis| round(axis.position.sqrt()));
            for (axis, variance) in spread.iter_mut().zip(variance) {
                axis.pass(*variance, period);
            }
            deviation
        });
        Self {
            deviation: deviation.collect(),
            t: round(seconds),
            predicted: rows()
                .map(|(state, _)| [round(state[0]), round(state[1]), round(state[2])])
                .collect(),
            reference: rows()
                .map(|(_, reference)| [round(reference[0]), round(reference[1])])
                .collect(),
        }
    }
}

/// Covariance of position and velocity error along one axis.
#[derive(Debug, Clone, Copy, Default)]
struct Spread {
    position: f64,
    mixed: f64,
    velocity: f64,
}

impl Spread {
    /// Adds one period of length T whose velocity error has the variance q.
    fn pass(&mut self, q: f64, period: f64) {
        self.position += 2.0 * period * self.mixed + period * period * (self.velocity + q / 4.0);
        self.mixed += period * (self.velocity + q / 2.0);
        self.velocity += q;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn the_spread_is_that_of_a_sum_of_independent_errors() {
        let (period, variances): (f64, [f64; 4]) = (0.1, [0.01, 0.04, 0.0, 0.02]);
        let mut spread = Spread::default();
        for variance in variances {
            spread.pass(variance, period);
        }
        // The error of period j lasts for half of its own period and for all later ones.
        let lasts =
            |period_before: usize| period * (variances.len() - period_before) as f64 - period / 2.0;
        let sum: f64 = variances
            .iter()
            .enumerate()
            .map(|(before, variance)| variance * lasts(before).powi(2))
            .sum();
        assert!((spread.position - sum).abs() < 1e-15, "{} is not {sum}", spread.position);
    }

    #[test]
    fn it_is_as_long_as_the_plan_and_certain_at_the_robot() {
        let mut plan: Box<Plan> = Box::new(Plan::zeroed());
        plan.horizon = 5;
        plan.variance = [[0.04, 0.01, 0.0]; 41];
        let horizon = Horizon::new(&plan, 1.0, 0.1);
        assert_eq!(
            (horizon.predicted.len(), horizon.reference.len(), horizon.deviation.len()),
            (6, 6, 6)
        );
        assert_eq!(horizon.deviation.first(), Some(&[0.0, 0.0]));
        assert!(
            horizon
                .deviation
                .is_sorted_by(|before, after| before[0] < after[0] && after[0] > after[1]),
            "{:?}",
            horizon.deviation
        );
    }
}
