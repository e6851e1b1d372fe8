//! The response of this robot to its commands, identified while it drives: dead time, and per axis
//! a time constant, a gain and an offset.
//!
//! ```text
//! v⁺ = A v + B u_δ + c + t(v)        u_δ: the acting input, for a dead time of δ
//! t = φ T (ω v_y, −ω v_x, 0) or 0    φ = (1 − A_f)/(−ln A_f), A_f of the main model
//! ```
//! t is the turning frame: in a frame that turns, a body of constant world velocity changes its
//! body velocity. t has no unknown parameter. Wheels with an integral part in their speed loop hold
//! the body velocity, and then there is no t. So A, B and c are identified with t and without it. t
//! is used while it explains past samples better.
//!
//! A, B and c come from recursive least squares on velocity and command alone. It begins with the
//! values of the main model, and runs for several δ in parallel:
//!
//! ```text
//! K = P φ / (μ + φᵀ P φ)   w ← w + K e   P ← (P − K φᵀ P)/μ     φ = (v, u_δ, 1),  e = v⁺ − wᵀ φ
//! ```
//! with a forgetting factor μ. During standstill, forgetting would let P grow without end, so it
//! stops at the initial P. When the errors have grown for a while, the robot or its world has
//! changed. Then P grows at once, so that the samples before the change count little.
//!
//! The δ with the smallest errors is selected. A soft speed loop shows in A and B, a dead time in
//! δ. Each has its own parameter, so the estimator does not confuse them.
//!
//! Reference: Åström, Wittenmark, *Adaptive Control*, 2nd ed., section 2.2.

use crate::delay::{Delay, Sent};
use crate::learned::{Moment, Residual, Response};
use crate::main_model::MainModel;
use crate::{AXES, Velocity};
use serde::{Deserialize, Serialize};

/// Dead times that are compared \[periods\].
const DEAD_TIMES: [f64; 14] =
    [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0];

/// Time constant with which samples and errors are forgotten \[s\].
const MEMORY_S: f64 = 10.0;

/// Another dead time is selected when its cost is below this share of the present one's cost. The
/// turning frame is selected when its cost is below this share of the cost without it.
const CONVINCING: f64 = 0.8;

/// Smallest difference of the costs that distinguishes dead times \[(m/s)²\].
const EVIDENCE: f64 = 1e-3;

/// Periods before the first selection. Three unknowns per axis fit a few samples with any dead
/// time.
const PERIODS_LEAST: u32 = 10;

/// Variance of A, B and c at the start, as a multiple of the variance of a sample.
const PRIOR: [f64; 3] = [100.0, 100.0, 0.01];

/// Time over which the errors of an axis are averaged to detect a change \[s\].
const RECENT_S: f64 = 1.0;

/// A change is detected when the recent mean square of the errors exceeds the lasting one by this
/// many of its standard deviations.
const ALARM: f64 = 10.0;

/// Added to P after a change, as a share of its initial value.
const REOPENED: f64 = 0.01;

/// Largest trace of P.
const TRACE_MAX: f64 = 300.0;

/// Largest A that is used: a robot that never responds cannot be controlled with it.
const DECAY_MAX: f64 = 0.995;

/// Smallest B that is used.
const GAIN_MIN: f64 = 0.005;

/// Without the turning frame, and with it.
const FRAMES: usize = 2;

/// v⁺ = A v + B u + c of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstOrder {
    /// A \[–\].
    pub decay: f64,
    /// B \[–\].
    pub gain: f64,
    /// c \[m/s or rad/s\].
    pub offset: f64,
}

impl FirstOrder {
    fn believable(&self) -> bool {
        self.decay.abs() < DECAY_MAX && self.gain > GAIN_MIN
    }
}

/// Recursive least squares of one axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Fit {
    /// A, B, c: without t, and with it.
    weights: [[f64; 3]; FRAMES],
    /// P.
    covariance: [[f64; 3]; 3],
}

impl Fit {
    fn new(decay: f64, gain: f64) -> Self {
        let covariance = std::array::from_fn(|row| {
            std::array::from_fn(|column| if row == column { PRIOR[row] } else { 0.0 })
        });
        Self { weights: [[decay, gain, 0.0]; FRAMES], covariance }
    }

    /// Updates the weights with a sample; returns the errors of the previous weights.
    fn update(
        &mut self,
        features: &[f64; 3],
        targets: &[f64; FRAMES],
        forgetting: f64,
    ) -> [f64; FRAMES] {
        let direction = self.covariance.map(|row| dot(&row, features));
        let scale = forgetting + dot(features, &direction);
        let mut errors = *targets;
        for (error, weights) in errors.iter_mut().zip(&mut self.weights) {
            *error -= dot(weights, features);
            for (weight, along) in weights.iter_mut().zip(direction) {
                *weight += along / scale * *error;
            }
        }
        for (row, along) in self.covariance.iter_mut().zip(direction) {
            for (value, across) in row.iter_mut().zip(direction) {
                *value -= along * across / scale;
            }
        }
        let trace: f64 = (0..3).map(|i| self.covariance[i][i]).sum();
        if trace < TRACE_MAX * forgetting {
            self.covariance = self.covariance.map(|row| row.map(|value| value / forgetting));
        }
        errors
    }

    /// Trusts the samples so far less.
    fn reopen(&mut self) {
        for (index, prior) in PRIOR.iter().enumerate() {
            self.covariance[index][index] += REOPENED * prior;
        }
    }

    fn first_order(&self, frame: usize) -> FirstOrder {
        let [decay, gain, offset] = self.weights[frame];
        FirstOrder { decay, gain, offset }
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Detects that the robot or its world has changed: the errors of an axis have grown for a while.
///
/// The mean of n squared errors of a normal distribution varies by √(2/n) of its value.
#[derive(Debug, Clone, Copy, Default)]
struct Change {
    /// Mean square of the errors over [`RECENT_S`] and over [`MEMORY_S`] \[(m/s)²\].
    recent: f64,
    lasting: f64,
    /// Number of periods so far.
    periods: u32,
}

impl Change {
    /// Whether the error of a period, of length `period_s`, reveals a change.
    fn detects(&mut self, error: f64, period_s: f64) -> bool {
        self.periods = self.periods.saturating_add(1);
        let periods = f64::from(self.periods);
        let share = |memory_s: f64| (period_s / memory_s).max(1.0 / periods).min(1.0);
        let squared = error * error;
        self.recent += share(RECENT_S) * (squared - self.recent);
        let count = (2.0 * RECENT_S / period_s).max(1.0);
        let usual = self.lasting * (1.0 + ALARM * (2.0 / count).sqrt());
        let detected = periods * period_s > 2.0 * RECENT_S && self.recent > usual;
        self.lasting += share(MEMORY_S) * (squared - self.lasting);
        if detected {
            // The next change is one from here.
            self.lasting = self.recent;
        }
        detected
    }
}

/// One hypothesis of the dead time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Hypothesis {
    delay: Delay,
    fits: [Fit; AXES],
    /// Sum of the squared errors with forgetting: without t, and with it \[(m/s)²\].
    costs: [f64; FRAMES],
}

impl Hypothesis {
    /// Whether t is used.
    fn turns(&self) -> bool {
        self.costs[1] < CONVINCING * self.costs[0]
    }

    fn frame(&self) -> usize {
        usize::from(self.turns())
    }

    fn cost(&self) -> f64 {
        self.costs[self.frame()]
    }

    fn believable(&self) -> bool {
        let frame = self.frame();
        self.cost().is_finite() && self.fits.iter().all(|fit| fit.first_order(frame).believable())
    }
}

/// Identified response of a drive. A later drive of the same robot can begin with it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoundResponse {
    believed: usize,
    taken: u32,
    hypotheses: Vec<Hypothesis>,
}

impl FoundResponse {
    /// Whether an estimator can begin with it: it has the same dead times, and is finite.
    fn is_usable(&self) -> bool {
        let is_finite = |of: &Hypothesis| {
            let fits = of.fits.iter().flat_map(|fit| {
                fit.weights.as_flattened().iter().chain(fit.covariance.as_flattened())
            });
            fits.chain(&of.costs).all(|value| value.is_finite())
        };
        let delays = self.hypotheses.iter().map(|of| of.delay.periods());
        delays.eq(DEAD_TIMES)
            && self.believed < DEAD_TIMES.len()
            && self.hypotheses.iter().all(is_finite)
    }
}

/// Identifies δ, A, B and c. Does not allocate.
#[derive(Debug, Clone)]
pub struct ResponseEstimator {
    main: MainModel,
    hypotheses: [Hypothesis; DEAD_TIMES.len()],
    /// Index of the selected hypothesis.
    believed: usize,
    forgetting: f64,
    changes: [Change; AXES],
    /// Converts a yaw rate to a speed \[–, –, m\].
    scale: Velocity,
    /// Velocity at the end of the last period.
    before: Option<Velocity>,
    /// Number of periods used.
    taken: u32,
}

impl ResponseEstimator {
    /// Begins with `main` and no dead time, for a robot whose wheels are `lever_m` from its centre.
    pub fn new(main: &MainModel, lever_m: f64) -> Self {
        let hypothesis = |periods| Hypothesis {
            delay: Delay::of_periods(periods),
            fits: std::array::from_fn(|axis| Fit::new(main.decay[axis], main.gain[axis])),
            costs: [0.0; FRAMES],
        };
        Self {
            main: *main,
            hypotheses: DEAD_TIMES.map(hypothesis),
            believed: 0,
            forgetting: (-main.period / MEMORY_S).exp(),
            changes: [Change::default(); AXES],
            scale: [1.0, 1.0, lever_m],
            before: None,
            taken: 0,
        }
    }

    /// Begins with the compared dead time that is nearest to this one \[s\].
    #[must_use]
    pub fn with_dead_time(mut self, dead_time_s: f64) -> Self {
        self.believed = self.nearest(dead_time_s);
        self
    }

    /// Begins with the compared dead time that is nearest to one that the driver reports \[s\].
    /// Without effect for 0, which is no report, for one that cannot be, and where an earlier run
    /// has identified the response.
    pub fn begin_at_dead_time(&mut self, reported_s: f64) {
        if self.taken == 0 && reported_s > 0.0 && reported_s.is_finite() {
            self.believed = self.nearest(reported_s);
        }
    }

    /// Index of the dead time nearest to this one \[s\].
    fn nearest(&self, dead_time_s: f64) -> usize {
        let periods = dead_time_s / self.main.period;
        let apart = |index: &usize| (DEAD_TIMES[*index] - periods).abs();
        (0..DEAD_TIMES.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0)
    }

    /// The response identified so far. Allocates.
    pub fn found(&self) -> FoundResponse {
        let Self { believed, taken, hypotheses, .. } = self;
        FoundResponse { believed: *believed, taken: *taken, hypotheses: hypotheses.to_vec() }
    }

    /// Continues from a response that was `found` by an estimator of the same main model. Returns
    /// false, and changes nothing, if it has other dead times or is not finite.
    pub fn begin_with(&mut self, found: &FoundResponse) -> bool {
        let is_usable = found.is_usable();
        if is_usable {
            self.hypotheses.copy_from_slice(&found.hypotheses);
            (self.believed, self.taken, self.before) = (found.believed, found.taken, None);
        }
        is_usable
    }

    /// δ.
    pub fn delay(&self) -> Delay {
        self.hypotheses[self.believed].delay
    }

    /// A, B and c for the selected δ.
    pub fn response(&self) -> FirstOrderResponse {
        let believed = &self.hypotheses[self.believed];
        let axes = if believed.believable() {
            let frame = believed.frame();
            believed.fits.map(|fit| fit.first_order(frame))
        } else {
            std::array::from_fn(|axis| FirstOrder {
                decay: self.main.decay[axis],
                gain: self.main.gain[axis],
                offset: 0.0,
            })
        };
        FirstOrderResponse { main: self.main, axes, turns: believed.turns() }
    }

    /// Updates the estimate with the period that has just ended with velocity `after`. Its command
    /// is the newest of `sent`. Ignores numbers that are not finite.
    pub fn update(&mut self, sent: &Sent, after: &Velocity) {
        let known = after.iter().chain(&sent.last()).all(|value| value.is_finite());
        if !known {
            self.before = None;
            return;
        }
        let Some(before) = self.before.replace(*after) else { return };
        self.taken = self.taken.saturating_add(1);
        let turning = turning(&self.main, &before).mean;
        let mut believed_errors = [0.0; AXES];
        for (index, hypothesis) in self.hypotheses.iter_mut().enumerate() {
            let acted = sent.acted(hypothesis.delay);
            let frame = hypothesis.frame();
            let mut squared = [0.0; FRAMES];
            for axis in 0..AXES {
                let features = [before[axis], acted[axis], 1.0];
                let fit = &mut hypothesis.fits[axis];
                let targets = [after[axis], after[axis] - turning[axis]];
                let errors = fit.update(&features, &targets, self.forgetting);
                if index == self.believed {
                    believed_errors[axis] = errors[frame];
                }
                for (squared, error) in squared.iter_mut().zip(errors) {
                    *squared += (self.scale[axis] * error).powi(2);
                }
            }
            for (cost, squared) in hypothesis.costs.iter_mut().zip(squared) {
                *cost = self.forgetting * *cost + squared;
            }
        }
        self.forget_contradicted(&believed_errors);
        self.believe();
    }

    /// Reopens the fits of the axes on which the robot or its world has changed. `errors` are those
    /// of the selected dead time \[m/s, m/s, rad/s\].
    fn forget_contradicted(&mut self, errors: &Velocity) {
        for axis in 0..AXES {
            if self.changes[axis].detects(errors[axis], self.main.period) {
                self.hypotheses.iter_mut().for_each(|hypothesis| hypothesis.fits[axis].reopen());
            }
        }
    }

    fn believe(&mut self) {
        let best = (0..DEAD_TIMES.len())
            .filter(|&i| self.hypotheses[i].believable())
            .min_by(|&a, &b| self.hypotheses[a].cost().total_cmp(&self.hypotheses[b].cost()));
        let Some(best) = best else { return };
        let (present, least) =
            (self.hypotheses[self.believed].cost(), self.hypotheses[best].cost());
        let convinces = least < CONVINCING * present && present - least > EVIDENCE;
        if convinces && self.taken >= PERIODS_LEAST {
            self.believed = best;
        }
    }

    /// A period is missing: the next one begins with `velocity`.
    pub fn resume(&mut self, velocity: &Velocity) {
        self.before = Some(*velocity);
    }
}

/// The response as a residual of the main model: g = (A − A_f) v + (B − B_f) u + c + t(v).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstOrderResponse {
    main: MainModel,
    /// A, B and c per axis.
    pub axes: [FirstOrder; AXES],
    /// Whether t is part of it.
    pub turns: bool,
}

/// t(v), with its slopes.
fn turning(main: &MainModel, velocity: &Velocity) -> Response {
    let [forward, left, rate] = *velocity;
    let time = |axis: usize| {
        let decay = main.decay[axis];
        main.period * (1.0 - decay) / -decay.ln()
    };
    let (along, across) = (time(0), time(1));
    let mut turning = Response::NONE;
    turning.mean = [along * rate * left, -across * rate * forward, 0.0];
    turning.by_velocity[0] = [0.0, along * rate, along * left];
    turning.by_velocity[1] = [-across * rate, 0.0, -across * forward];
    turning
}

impl Residual for FirstOrderResponse {
    fn mean(&self, at: &Moment) -> Velocity {
        self.response(at).mean
    }

    fn response(&self, at: &Moment) -> Response {
        let mut response =
            if self.turns { turning(&self.main, &at.velocity) } else { Response::NONE };
        for axis in 0..AXES {
            let FirstOrder { decay, gain, offset } = self.axes[axis];
            let by_velocity = decay - self.main.decay[axis];
            let by_input = gain - self.main.gain[axis];
            response.mean[axis] +=
                by_velocity * at.velocity[axis] + by_input * at.input[axis] + offset;
            response.by_velocity[axis][axis] += by_velocity;
            response.by_input[axis][axis] = by_input;
        }
        response
    }
}

#[cfg(test)]
mod tests;
