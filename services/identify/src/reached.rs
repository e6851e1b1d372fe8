//! How fast the robot really accelerated and braked.
//!
//! The data are cut into spans of a tenth of a second. On each axis, those five count in which the
//! simulated response changes its speed most: the noise of the measurement has no part in the
//! choice. The value is the mean change of the measured velocity over these spans, and the
//! interval is that of their scatter.

use crate::fit::Beside;
use crate::sensors::Measured;
use robot::{AXES, Velocity};

/// Length of a span \[s\].
const SPAN_S: f64 = 0.1;
/// Spans that count.
const SPANS: usize = 5;
/// Half width of a 95 % interval in standard deviations of the mean of [`SPANS`]: Student's t with
/// 4 degrees of freedom.
const WIDTH_95: f64 = 2.776;
/// Acceleration below which an axis stands or keeps its speed \[m/s², m/s², rad/s²\].
const STEADY: Velocity = [0.05, 0.05, 0.1];

/// Accelerations, if the robot accelerated \[m/s², m/s², rad/s²\].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reached {
    /// While it got faster.
    pub acceleration: [Option<Measured>; AXES],
    /// While it got slower.
    pub braking: [Option<Measured>; AXES],
}

/// What the robot reached in samples of `period_s` \[s\] that stand beside their simulation.
pub fn reached(period_s: f64, beside: &[Vec<Beside>]) -> Reached {
    let mut spans: [[Vec<Span>; AXES]; 2] = Default::default();
    let length = ((SPAN_S / period_s).round() as usize).max(1);
    let time = length as f64 * period_s;
    for stretch in beside {
        let both: Vec<(Velocity, Velocity)> =
            stretch.iter().map(|both| (both.simulated, both.sample.velocity)).collect();
        for ends in both.windows(length + 1).step_by(length) {
            let (Some(first), Some(last)) = (ends.first(), ends.last()) else { continue };
            for axis in 0..AXES {
                let change = last.0[axis] - first.0[axis];
                // A span that passes through rest has both.
                if first.0[axis] * last.0[axis] < 0.0 {
                    continue;
                }
                let slows_down = last.0[axis].abs() < first.0[axis].abs();
                let measured = (last.1[axis] - first.1[axis]) * change.signum() / time;
                spans[usize::from(slows_down)][axis]
                    .push(Span { simulated: change.abs() / time, measured });
            }
        }
    }
    let [acceleration, braking] = spans.map(|axes| {
        let mut number = 0..AXES;
        axes.map(|spans| largest(spans, STEADY[number.next().unwrap_or(0)]))
    });
    Reached { acceleration, braking }
}

/// Change of the speed in one span, towards that of the simulation.
struct Span {
    simulated: f64,
    measured: f64,
}

fn largest(mut spans: Vec<Span>, steady: f64) -> Option<Measured> {
    spans.retain(|span| span.simulated > steady);
    spans.sort_by(|a, b| b.simulated.total_cmp(&a.simulated));
    let chosen = spans.get(..SPANS)?;
    let count = SPANS as f64;
    let value = chosen.iter().map(|span| span.measured).sum::<f64>() / count;
    let squares: f64 = chosen.iter().map(|span| (span.measured - value).powi(2)).sum();
    let half_width = WIDTH_95 * (squares / (count - 1.0) / count).sqrt();
    Some(Measured { value, half_width })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::beside;
    use crate::log::{Log, Sample};
    use crate::response::{Response, Simulation};
    use robot::Robot;

    /// A robot that speeds up with 1.5 m/s² and brakes with 3 m/s², five times.
    #[test]
    fn a_robot_that_brakes_harder_than_it_speeds_up_has_two_accelerations() {
        let wheels = Robot::example().wheels;
        let response = Response {
            time_constant_s: [0.02; AXES],
            acceleration: [1.5; AXES],
            braking: [3.0; AXES],
            ..Response::default()
        };
        let input = |number: usize| if number / 100 % 2 == 1 { [1.0, 0.0, 0.0] } else { [0.0; 3] };
        let mut stretch: Vec<Sample> =
            (0..1200).map(|number| Sample { input: input(number), ..Sample::default() }).collect();
        let run = Simulation::new(&wheels, &stretch, 0.02).whole(&response);
        for (number, (sample, motion)) in stretch.iter_mut().skip(1).zip(run).enumerate() {
            let noise = 0.002 * (number as f64 * 2.399).sin();
            sample.velocity = motion.velocity.map(|it| it + noise);
        }
        let log = Log { period_s: 0.02, stretches: vec![stretch], ..Log::default() };
        let found = reached(log.period_s, &beside(&log, &wheels, &response));
        for (found, truth) in [(found.acceleration[0], 1.5), (found.braking[0], 3.0)] {
            let is_right = found.is_some_and(|it| (it.value - truth).abs() < 0.05);
            assert!(is_right, "{found:?} {truth}");
        }
        assert_eq!(found.acceleration[1], None);
    }
}
