//! A step along a ray that satisfies the strong Wolfe conditions, or the best step found.
//!
//! With φ(t) = f(x + t d): φ(t) ≤ φ(0) + c₁ t φ′(0) and |φ′(t)| ≤ c₂ |φ′(0)|, for 0 < t ≤
//! `longest`.
//!
//! Reference: Nocedal & Wright, *Numerical Optimization*, 2006, algorithms 3.5 and 3.6, here as one
//! loop.

/// c₁: sufficient decrease.
const DECREASE: f64 = 1e-4;
/// c₂: flattening.
const FLATTENING: f64 = 0.9;

/// φ at one step.
#[derive(Debug, Clone)]
pub(crate) struct Trial<P> {
    /// t.
    pub(crate) step: f64,
    /// φ(t).
    pub(crate) value: f64,
    /// φ′(t).
    pub(crate) slope: f64,
    /// Data of the caller for this step.
    pub(crate) point: P,
}

impl<P> Trial<P> {
    fn is_finite(&self) -> bool {
        self.value.is_finite() && self.slope.is_finite()
    }
}

/// Searches along `evaluate`, beginning with `first`, at most `evaluations` times.
///
/// `start` is t = 0 with φ′(0) < 0. Returns the accepted trial. If no step satisfies both
/// conditions within the budget, returns the lowest trial that decreases sufficiently, or `None`.
pub(crate) fn search<P>(
    start: &Trial<()>,
    first: f64,
    longest: f64,
    evaluations: usize,
    mut evaluate: impl FnMut(f64) -> Trial<P>,
) -> Option<Trial<P>> {
    // The lowest trial so far, and the one on the other side of the minimum.
    let mut low = Trial { step: 0.0, ..*start };
    let mut best: Option<P> = None;
    let mut high: Option<Trial<()>> = None;
    let mut step = first.min(longest);
    for _ in 0..evaluations {
        let Trial { step: at, value, slope, point } = evaluate(step);
        let trial = Trial { step: at, value, slope, point: () };
        let before = low.clone();
        if !trial.is_finite()
            || value > start.value + DECREASE * at * start.slope
            || value > low.value
        {
            high = Some(trial);
        } else {
            let done = slope.abs() <= FLATTENING * start.slope.abs()
                || (high.is_none() && slope < 0.0 && at >= longest);
            if slope * high.as_ref().map_or(1.0, |high| high.step - low.step) >= 0.0 {
                high = Some(low);
            }
            low = trial;
            best = Some(point);
            if done {
                break;
            }
        }
        step = match &high {
            Some(high) => inside(&low, high),
            None => beyond(&before, &low).min(longest),
        };
        if (step - low.step).abs() <= f64::EPSILON * low.step.max(step) {
            break;
        }
    }
    best.map(|point| Trial { step: low.step, value: low.value, slope: low.slope, point })
}

/// Minimum of the cubic through two trials, kept away from their ends; the middle if there is none.
fn inside(low: &Trial<()>, high: &Trial<()>) -> f64 {
    let width = high.step - low.step;
    if !high.is_finite() {
        return low.step + 0.25 * width;
    }
    // Nocedal & Wright, eq. 3.59.
    let chord = low.slope + high.slope - 3.0 * (high.value - low.value) / width;
    let root = width.signum() * (chord * chord - low.slope * high.slope).sqrt();
    let fraction = 1.0 - (high.slope + root - chord) / (high.slope - low.slope + 2.0 * root);
    let fraction = if fraction.is_finite() { fraction.clamp(0.1, 0.9) } else { 0.5 };
    low.step + fraction * width
}

/// The step at which the slope, extrapolated linearly, is zero; limited to 1.5 to 5 distances.
fn beyond(before: &Trial<()>, now: &Trial<()>) -> f64 {
    let width = now.step - before.step;
    let secant = -now.slope * width / (now.slope - before.slope);
    let ahead = if secant.is_finite() && secant > 0.0 {
        secant.clamp(0.5 * width, 4.0 * width)
    } else {
        4.0 * width
    };
    now.step + ahead
}

#[cfg(test)]
mod tests {
    use super::{DECREASE, FLATTENING, Trial, search};
    use proptest::prelude::*;

    fn run(
        first: f64,
        longest: f64,
        value: impl Fn(f64) -> f64,
        slope: impl Fn(f64) -> f64,
    ) -> Option<Trial<()>> {
        let start = Trial { step: 0.0, value: value(0.0), slope: slope(0.0), point: () };
        search(&start, first, longest, 40, |step| Trial {
            step,
            value: value(step),
            slope: slope(step),
            point: (),
        })
    }

    proptest! {
        #[test]
        fn the_step_is_a_strong_wolfe_step(
            minimum in 1e-3..1e3_f64,
            first in 1e-2..1e2_f64,
            skew in -0.9..0.9_f64,
        ) {
            // A quartic valley with its minimum at `minimum`, tilted but still falling at zero.
            let value = |t: f64| {
                let z = t / minimum - 1.0;
                z * z + skew * z * z * z / 3.0 + 0.25 * z.powi(4)
            };
            let slope = |t: f64| {
                let z = t / minimum - 1.0;
                (2.0 * z + skew * z * z + z.powi(3)) / minimum
            };
            let found = run(first, f64::INFINITY, value, slope);
            let Some(found) = found else { return Err(TestCaseError::fail("nothing found")) };
            prop_assert!(found.value <= value(0.0) + DECREASE * found.step * slope(0.0));
            prop_assert!(found.slope.abs() <= FLATTENING * slope(0.0).abs());
        }
    }

    #[test]
    fn a_function_that_still_falls_gives_the_longest_step() {
        let found = run(1.0, 3.0, |t| -t, |_| -1.0);
        assert!(found.is_some_and(|found| (found.step - 3.0).abs() < 1e-15));
    }

    #[test]
    fn the_search_steps_back_from_values_that_are_not_finite() {
        let found = run(
            10.0,
            10.0,
            |t| if t > 1.0 { f64::INFINITY } else { (t - 0.5).powi(2) },
            |t| 2.0 * (t - 0.5),
        );
        assert!(found.is_some_and(|found| found.step < 1.0 && found.value < 0.25));
    }

    #[test]
    fn a_function_that_only_rises_gives_no_step() {
        assert!(run(1.0, 10.0, |t| t, |_| -1.0).is_none());
    }
}
