//! The figures of a row: which can be printed, in what unit, and the value of a missing figure.

use super::trial::Row;
use plant_sim::truth::Truth;

/// The start that position figures leave out \[ns\].
const START_NANOS: u64 = 3_000_000_000;
/// Length of the end that [`at_end`] averages over \[ns\].
const END_NANOS: u64 = 5_000_000_000;
/// A robot has recovered when its error is at most this multiple of the error before.
const BACK: f64 = 1.2;

/// A figure that can be printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Figure {
    /// Distance from the reference from 3 s on, RMS.
    PositionRmse,
    /// The largest distance from the reference from 3 s on.
    PositionMax,
    /// Mean distance from the reference over the last 5 s.
    PositionAtEnd,
    /// Time after which the robot stays within 0.10 m of its reference; never counts as the length
    /// of the run.
    Arrival,
    /// Time after which the speed stays within 0.07 m/s of the reference's; never counts as the
    /// length of the run.
    SpeedSettle,
    /// The largest difference of speeds over the last 10 s.
    SteadySpeedError,
    /// Difference of headings from 3 s on, RMS.
    HeadingRmse,
    /// Time after a change in mid-run until the position RMSE is within 1.2 times its former value;
    /// never counts as the length of the run.
    Recovery,
    /// Time until the compensated delay stays within one period of the true one; never counts as
    /// the length of the run.
    DelayFound,
    /// RMS change of the planar input over the period.
    InputEffort,
    /// Share of ticks outside the corridor.
    CorridorViolations,
    /// Share of samples in the learner's 95 % interval, over all axes.
    Coverage,
    /// Position RMSE of the first lap; laps are counted from 3 s on.
    FirstLap,
    /// Position RMSE of the third lap.
    ThirdLap,
    /// Ticks outside the state limits, or without a controller's command.
    ConstraintViolations,
    /// Median of the tick times.
    TickP50,
    /// 99th percentile of the tick times.
    TickP99,
}

impl Figure {
    /// Title in a table, and the number of its units in the SI unit.
    pub fn title_and_scale(self) -> (&'static str, f64) {
        match self {
            Self::PositionRmse => ("position RMSE [mm]", 1e3),
            Self::PositionMax => ("largest position error [mm]", 1e3),
            Self::PositionAtEnd => ("position error of the last 5 s [mm]", 1e3),
            Self::Arrival => ("arrival [s]", 1.0),
            Self::SpeedSettle => ("settling of the speed [s]", 1.0),
            Self::SteadySpeedError => ("steady speed error [mm/s]", 1e3),
            Self::HeadingRmse => ("heading RMSE [mrad]", 1e3),
            Self::Recovery => ("recovery after a change [s]", 1.0),
            Self::DelayFound => ("delay found [s]", 1.0),
            Self::InputEffort => ("input effort [m/s2]", 1.0),
            Self::CorridorViolations => ("outside the corridor [%]", 1e2),
            Self::Coverage => ("within the learner's 95 % interval [%]", 1e2),
            Self::FirstLap => ("position RMSE of the first lap [mm]", 1e3),
            Self::ThirdLap => ("position RMSE of the third lap [mm]", 1e3),
            Self::ConstraintViolations => ("constraint violations [ticks]", 1.0),
            Self::TickP50 => ("tick, median [us]", 1.0),
            Self::TickP99 => ("tick, 99th percentile [us]", 1.0),
        }
    }

    /// Its value in `row`.
    ///
    /// A missing time is the length of the run. A figure that a row cannot have is NaN. Any other
    /// missing figure has the worst possible value.
    pub fn of(self, row: &Row) -> f64 {
        let (value, nothing) = match self {
            Self::PositionRmse => (row.position_rmse_m, f64::INFINITY),
            Self::PositionMax => (row.position_max_m, f64::INFINITY),
            Self::PositionAtEnd => (row.position_at_end_m, f64::INFINITY),
            Self::Arrival => (row.arrival_s, row.duration_s),
            Self::SpeedSettle => (row.speed_settle_s, row.duration_s),
            Self::SteadySpeedError => (row.steady_speed_error_mps, f64::INFINITY),
            Self::HeadingRmse => (row.heading_rmse_rad, f64::INFINITY),
            Self::Recovery => (row.recovery_s, row.duration_s),
            Self::DelayFound => (row.delay_found_s, row.duration_s),
            Self::InputEffort => (Some(row.input_effort), f64::INFINITY),
            Self::CorridorViolations => (row.corridor_violations, f64::NAN),
            Self::Coverage => (
                row.interval.map(|of| of.coverage.iter().sum::<f64>() / of.coverage.len() as f64),
                f64::NAN,
            ),
            Self::FirstLap => (row.laps_rmse_m.first().copied(), f64::NAN),
            Self::ThirdLap => (row.laps_rmse_m.get(2).copied(), f64::NAN),
            Self::ConstraintViolations => (Some(row.constraint_violations as f64), f64::INFINITY),
            Self::TickP50 => (row.tick_p50_us, f64::INFINITY),
            Self::TickP99 => (row.tick_p99_us, f64::INFINITY),
        };
        value.unwrap_or(nothing)
    }
}

/// When the robot or its world first changes in mid-run \[ns\].
pub(super) fn changes_at(truth: Option<&Truth>) -> Option<u64> {
    let truth = truth?;
    let times = truth
        .payload
        .iter()
        .map(|payload| payload.at_s)
        .chain(truth.push.iter().map(|push| push.from_s));
    let first = times
        .chain(truth.faults.iter().map(|fault| fault.at_s))
        .chain(truth.slippery.iter().map(|slippery| slippery.from_s))
        .map(|at_s| (at_s * 1e9) as u64)
        .filter(|&at| at > START_NANOS);
    first.min()
}

/// Mean over the last 5 s \[m\].
pub(super) fn at_end(distances: &[(u64, f64)]) -> Option<f64> {
    let (end, _) = distances.last()?;
    let last: Vec<f64> = distances
        .iter()
        .filter(|(at, _)| at + END_NANOS > *end)
        .map(|&(_, distance)| distance)
        .collect();
    finite(last.iter().sum::<f64>() / last.len() as f64)
}

/// Time from `change` until the RMSE to the end is at most 1.2 times that before `change` \[s\].
pub(super) fn recovery(distances: &[(u64, f64)], change: u64) -> Option<f64> {
    let before = distances.iter().filter(|(at, _)| (START_NANOS..change).contains(at));
    let (count, sum) = before
        .fold((0.0, 0.0), |(count, sum), (_, distance)| (count + 1.0, sum + distance * distance));
    let allowed = finite(BACK * BACK * sum / count)?;
    // From the end backwards: the mean square from each tick to the end.
    let mut back = None;
    let (mut count, mut sum) = (0.0, 0.0);
    for &(at, distance) in distances.iter().rev().take_while(|(at, _)| *at >= change) {
        (count, sum) = (count + 1.0, sum + distance * distance);
        if sum / count <= allowed {
            back = Some((at - change) as f64 * 1e-9);
        }
    }
    back
}

/// Position RMSE of each whole lap of `lap_s`; the first one begins at 3 s \[m\].
pub(super) fn laps(distances: &[(u64, f64)], lap_s: f64) -> Vec<f64> {
    let lap = (lap_s * 1e9) as u64;
    let end = distances.last().map_or(0, |&(at, _)| at);
    let begins = (0..).map(|number| START_NANOS + number * lap);
    begins
        .take_while(|begin| begin + lap <= end)
        .map(|begin| {
            let of_lap = distances.iter().filter(|(at, _)| (begin..begin + lap).contains(at));
            let (count, sum) = of_lap.fold((0.0, 0.0), |(count, sum), (_, distance)| {
                (count + 1.0, sum + distance * distance)
            });
            f64::sqrt(sum / count)
        })
        .collect()
}

/// The time from which the compensated delays stay within one period of the true one. Each delay
/// comes with its time \[s\].
pub(super) fn delay_found(made_up_for: &[(f64, f64)], truth: f64, period: f64) -> Option<f64> {
    let near = |delay: f64| (delay - truth).abs() <= period + 1e-9;
    made_up_for.iter().rev().take_while(|&&(_, delay)| near(delay)).last().map(|&(at, _)| at)
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An error of 1 cm, but of 5 cm from `change` to `back`.
    fn run(change: u64, back: u64) -> Vec<(u64, f64)> {
        let seconds = 1_000_000_000;
        (0..400)
            .map(|tick| tick * seconds / 10)
            .map(|at| (at, if (change..back).contains(&at) { 0.05 } else { 0.01 }))
            .collect()
    }

    #[test]
    fn recovery_lasts_from_the_change_until_the_error_is_as_before() {
        let seconds = 1_000_000_000;
        let recovered = |back| recovery(&run(15 * seconds, back), 15 * seconds);
        assert_eq!(recovered(15 * seconds), Some(0.0));
        // After two seconds with five times the error, a few ticks have little weight in the rest
        // of the run.
        assert!(
            recovered(17 * seconds).is_some_and(|after| (1.5..=2.0).contains(&after)),
            "{:?}",
            recovered(17 * seconds)
        );
        assert_eq!(recovered(100 * seconds), None);
        assert_eq!(recovery(&[], 15 * seconds), None);
    }

    #[test]
    fn a_delay_is_found_if_it_is_not_lost_again() {
        let found = |delays: &[f64]| {
            let at: Vec<(f64, f64)> = delays
                .iter()
                .zip(0_u32..)
                .map(|(&delay, tick)| (0.1 * f64::from(tick), delay))
                .collect();
            delay_found(&at, 0.25, 0.1)
        };
        assert_eq!(found(&[0.2, 0.0, 0.18, 0.35, 0.25]), Some(0.2));
        assert_eq!(found(&[0.2, 0.2, 0.0]), None);
    }

    #[test]
    fn the_end_is_the_last_five_seconds() {
        let seconds = 1_000_000_000;
        assert!(at_end(&run(0, 34 * seconds)).is_some_and(|mean| (mean - 0.01).abs() < 1e-12));
        assert!(at_end(&run(37 * seconds, 100 * seconds)).is_some_and(|mean| mean > 0.03));
        assert_eq!(at_end(&[(0, f64::NAN)]), None);
    }

    #[test]
    fn each_whole_lap_from_3_s_on_has_its_error() {
        let seconds = 1_000_000_000;
        let errors = laps(&run(13 * seconds, 23 * seconds), 10.0);
        assert_eq!(errors.len(), 3);
        for (error, is) in errors.iter().zip([0.01, 0.05, 0.01]) {
            assert!((error - is).abs() < 1e-12, "{errors:?}");
        }
        assert!(laps(&[], 10.0).is_empty());
    }

    #[test]
    fn only_a_change_in_mid_run_can_be_recovered_from() {
        let payload = |at_s| plant_sim::truth::Payload {
            mass_kg: 1.0,
            yaw_inertia_kg_m2: 0.0,
            offset_m: [0.0; 2],
            at_s,
            until_s: None,
        };
        let changes =
            |at_s| changes_at(Some(&Truth { payload: Some(payload(at_s)), ..Truth::default() }));
        assert_eq!((changes(0.0), changes(15.0)), (None, Some(15_000_000_000)));
        let slippery = plant_sim::truth::Slippery { grip_factor: 0.5, from_s: 15.0, until_s: None };
        let floor = Truth { slippery: vec![slippery], ..Truth::default() };
        assert_eq!(changes_at(Some(&floor)), Some(15_000_000_000));
    }
}
