//! The reference problem driven by the controller's own optimiser, and its results.

use super::problem::{self, Processes};
use controller::mpc::{Formulation, Mpc};
use controller::settings::{Linearise, MpcSettings};
use model::State;
use model::learned::Residual;
use model::predict::Belief;
use serde::Serialize;
use std::error::Error;
use std::time::{Duration, Instant};

const PERIODS: usize = 320;
/// Number of periods that are driven, but not timed.
const WARM_UP: usize = 20;

/// One closed loop: medians and tails of its times over the periods after the warm-up, tracking
/// over all.
#[derive(Debug, Serialize)]
pub(crate) struct Figures {
    /// Points of each Gaussian process.
    #[serde(rename = "M")]
    pub(crate) points: usize,
    /// Horizon, all of it free.
    #[serde(rename = "N")]
    pub(crate) horizon: usize,
    /// Point about which it is linearised.
    pub(crate) linearise: Linearise,
    /// Number of timed periods.
    pub(crate) steps: usize,
    /// All of one period: the work before the state arrives, and after.
    pub(crate) step_p50_us: f64,
    pub(crate) step_p99_us: f64,
    /// Part of it: mean and Jacobian of the Gaussian processes.
    pub(crate) gp_p50_us: f64,
    /// Part of it: prediction and linearisation, with the Gaussian processes.
    pub(crate) linearise_p50_us: f64,
    /// Part of it: the quadratic program, written and solved.
    pub(crate) qp_p50_us: f64,
    /// From the state to the command.
    pub(crate) feedback_p50_us: f64,
    pub(crate) feedback_p99_us: f64,
    /// Largest number of iterations of the quadratic program's method in one period.
    pub(crate) iterations_most: u32,
    /// Root mean square of the distance from the reference \[m\].
    pub(crate) rms_pos_err: f64,
    /// Sum of |u| over axes and periods.
    pub(crate) usum: f64,
}

/// Drives the problem with this number of data points and this horizon. Peers linearise about the
/// expected state.
pub(crate) fn drive(
    points: usize,
    horizon: usize,
    linearise: Linearise,
) -> Result<Figures, Box<dyn Error>> {
    let (main, processes) = (problem::main_model(), Processes::new(points)?);
    let learned = (points > 0).then_some(&processes as &dyn Residual);
    let belief = Belief { learned, ..Belief::of(&main) };
    let settings = MpcSettings { linearise, ..problem::settings(horizon) };
    let mut mpc = Mpc::formulated(Formulation::Plain, &settings, &problem::inputs(), &main)?;
    let reference = problem::reference(PERIODS + horizon + 2);
    let first = reference.first().ok_or("a reference has points")?;
    let mut state = State { pose: first.pose, velocity: first.velocity, ..State::default() };
    let (mut input, mut squares, mut usum, mut iterations_most) = ([0.0; 3], 0.0, 0.0, 0);
    let mut times: [Vec<Duration>; 5] = std::array::from_fn(|_| Vec::with_capacity(PERIODS));
    mpc.begin_on(&reference);
    for (period, points) in reference.windows(horizon + 1).enumerate().take(PERIODS) {
        problem::kick(period, &mut state);
        let begin = Instant::now();
        mpc.prepare(points, &belief);
        mpc.expect(&input, points, &belief);
        let comes = Instant::now();
        let solved = mpc.iterate(&state, &input, points, &belief);
        let end = Instant::now();
        if !solved.outcome.usable() {
            return Err(format!("period {period}: {:?}", solved.outcome).into());
        }
        iterations_most = iterations_most.max(solved.outcome.iterations);
        let linearised =
            Duration::from_nanos(solved.ahead.linearise_nanos + solved.since.linearise_nanos);
        let solve = Duration::from_nanos(solved.ahead.solve_nanos + solved.since.solve_nanos);
        for (times, time) in times.iter_mut().zip([
            end - begin,
            processes.take_time(),
            linearised,
            solve,
            end - comes,
        ]) {
            times.push(time);
        }
        let planned = mpc.stages().first().ok_or("a plan has stages")?.input;
        input = std::array::from_fn(|axis| {
            planned[axis].clamp(-problem::LARGEST_INPUT[axis], problem::LARGEST_INPUT[axis])
        });
        usum += input.iter().map(|value| value.abs()).sum::<f64>();
        squares += (state.pose[0] - points[0].pose[0]).powi(2)
            + (state.pose[1] - points[0].pose[1]).powi(2);
        state = problem::plant(&state, &input);
    }
    let [step, gp, linearised, qp, feedback] = times.each_ref().map(|times| Times::new(times));
    Ok(Figures {
        points,
        horizon,
        linearise,
        steps: PERIODS - WARM_UP,
        step_p50_us: step.percentile(0.5),
        step_p99_us: step.percentile(0.99),
        gp_p50_us: gp.percentile(0.5),
        linearise_p50_us: linearised.percentile(0.5),
        qp_p50_us: qp.percentile(0.5),
        feedback_p50_us: feedback.percentile(0.5),
        feedback_p99_us: feedback.percentile(0.99),
        iterations_most,
        rms_pos_err: (squares / PERIODS as f64).sqrt(),
        usum,
    })
}

/// Sorted times after the warm-up.
struct Times(Vec<f64>);

impl Times {
    fn new(times: &[Duration]) -> Self {
        let mut micros: Vec<f64> =
            times.iter().skip(WARM_UP).map(|time| 1e6 * time.as_secs_f64()).collect();
        micros.sort_by(f64::total_cmp);
        Self(micros)
    }

    /// Between the two nearest, in proportion \[µs\].
    fn percentile(&self, share: f64) -> f64 {
        let place = share * (self.0.len() - 1) as f64;
        let (below, above) = (self.0[place.floor() as usize], self.0[place.ceil() as usize]);
        below + (above - below) * place.fract()
    }
}
