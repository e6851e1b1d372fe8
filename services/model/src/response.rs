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
//! K = P φ / (μ/q + φᵀ P φ)   w ← w + K e   P ← (P − K φᵀ P)/μ   φ = (v, u_δ, 1),  e = v⁺ − wᵀ φ
//! q = (s₀/s)², at most 1     s: largest difference of the velocities of body and wheels
//! ```
//! with a forgetting factor μ. During standstill, forgetting would let P grow without end, so it
//! stops at the initial P. When the errors have grown for a while, the robot or its world has
//! changed. Then P grows at once, so that the samples before the change count little.
//!
//! The force of a wheel that slides hardly depends on its input. So a sample counts with the weight
//! q: it counts less, the more the velocity of the body differs from that of the wheels, at the
//! begin or the end of the period.
//!
//! The δ with the smallest errors is selected. A soft speed loop shows in A and B, a dead time in
//! δ. Each has its own parameter, so the estimator does not confuse them. Noise of the velocity can
//! hide a dead time for long. So measured wheels propose one too (`wheels`), which is selected
//! where it does not predict the velocity worse.
//!
//! Many drives change their set points by no more than a fixed rate. Such a ramp is not linear, and
//! looks like a slow response or a dead time. It is identified from the wheels too (`ramp`). From
//! then on u is what a drive with this ramp makes of the commands, and plans keep to the rate.
//!
//! Reference: Åström, Wittenmark, *Adaptive Control*, 2nd ed., section 2.2.

mod follower;
mod hypothesis;
mod least_squares;
mod ramp;
mod wheels;

use crate::delay::{Delay, Sent};
use crate::learned::{Moment, Residual, Response};
use crate::main_model::MainModel;
use crate::{AXES, Velocity};
use follower::FOLLOWING_S;
use hypothesis::{FoundHypothesis, Hypotheses, Hypothesis, Period, better};
use least_squares::Change;
use ramp::Ramps;
use robot::Wheels;
use serde::{Deserialize, Serialize};
use wheels::ByWheels;

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

/// s₀: slip from which on a sample counts less \[m/s\].
const SLIDES_MPS: f64 = 0.12;

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

/// Identified response of a drive. A later drive of the same robot can begin with it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoundResponse {
    believed: usize,
    taken: u32,
    /// Rate of the drive's ramp, if it has one \[m/s²\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    ramp_mps2: Option<f64>,
    hypotheses: Vec<FoundHypothesis>,
}

impl FoundResponse {
    /// Whether an estimator of `hypotheses` can begin with it: it has the same dead times, and is
    /// finite.
    fn is_usable(&self, hypotheses: &Hypotheses) -> bool {
        let is_finite = |of: &FoundHypothesis| {
            let fits = of.fits.iter().flat_map(|fit| {
                fit.weights.as_flattened().iter().chain(fit.covariance.as_flattened())
            });
            fits.chain(&of.costs).all(|value| value.is_finite())
        };
        let delays = self.hypotheses.iter().map(|of| of.delay);
        delays.eq(hypotheses.iter().map(|of| of.delay.periods()))
            && self.ramp_mps2.is_none_or(|rate| rate.is_finite() && rate > 0.0)
            && self.believed < hypotheses.len()
            && self.hypotheses.iter().all(is_finite)
    }
}

/// Identifies δ, A, B and c. Does not allocate.
#[derive(Debug, Clone)]
pub struct ResponseEstimator {
    main: MainModel,
    hypotheses: Hypotheses,
    /// Index of the selected hypothesis.
    believed: usize,
    by_wheels: ByWheels,
    ramps: Ramps,
    forgetting: f64,
    /// e^{−T/τ} of a response that follows the wheels.
    kept: f64,
    changes: [Change; AXES],
    /// Converts a yaw rate to a speed \[–, –, m\].
    scale: Velocity,
    /// Velocity at the end of the last period.
    before: Option<Velocity>,
    /// The same of the wheels.
    wheels_before: Option<Velocity>,
    /// Number of periods used.
    taken: u32,
}

impl ResponseEstimator {
    /// Begins with `main` and no dead time, for a robot with these wheels.
    pub fn new(main: &MainModel, wheels: &Wheels) -> Self {
        Self {
            main: *main,
            hypotheses: Hypotheses::new(main),
            believed: 0,
            by_wheels: ByWheels::new(main),
            ramps: Ramps::new(main, wheels),
            forgetting: (-main.period / MEMORY_S).exp(),
            kept: (-main.period / FOLLOWING_S).exp(),
            changes: [Change::default(); AXES],
            scale: [1.0, 1.0, wheels.lever_m()],
            before: None,
            wheels_before: None,
            taken: 0,
        }
    }

    /// Begins with the compared dead time that is nearest to this one \[s\].
    #[must_use]
    pub fn with_dead_time(mut self, dead_time_s: f64) -> Self {
        self.believe(self.nearest(dead_time_s));
        self
    }

    /// Begins with the compared dead time that is nearest to one that the driver reports \[s\].
    /// Without effect for 0, which is no report, for one that cannot be, and where an earlier run
    /// has identified the response.
    pub fn begin_at_dead_time(&mut self, reported_s: f64) {
        if self.taken == 0 && reported_s > 0.0 && reported_s.is_finite() {
            self.believe(self.nearest(reported_s));
        }
    }

    /// Index of the dead time nearest to this one \[s\].
    fn nearest(&self, dead_time_s: f64) -> usize {
        let periods = dead_time_s / self.main.period;
        let apart = |index: &usize| (self.hypotheses[*index].delay.periods() - periods).abs();
        (0..self.hypotheses.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0)
    }

    /// The response identified so far. Allocates.
    pub fn found(&self) -> FoundResponse {
        let Self { believed, taken, hypotheses, .. } = self;
        let ramp_mps2 = self.ramps.rate();
        let hypotheses = hypotheses.iter().map(Hypothesis::found).collect();
        FoundResponse { believed: *believed, taken: *taken, ramp_mps2, hypotheses }
    }

    /// Continues from a response that was `found` by an estimator of the same main model. Returns
    /// false, and changes nothing, if it has other dead times or is not finite.
    pub fn begin_with(&mut self, found: &FoundResponse) -> bool {
        let is_usable = found.is_usable(&self.hypotheses);
        if is_usable {
            for (hypothesis, found) in self.hypotheses.iter_mut().zip(&found.hypotheses) {
                hypothesis.begin_with(found);
            }
            (self.taken, self.before) = (found.taken, None);
            self.ramps.select(found.ramp_mps2);
            self.believe(found.believed);
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

    /// Largest rate at which the drive changes the rim speeds of its set points, if it ramps its
    /// command \[m/s²\].
    pub fn ramp_mps2(&self) -> Option<f64> {
        self.ramps.rate()
    }

    /// Whether the measured wheels follow the commands. Those that do not, as encoders that stand
    /// still, say nothing.
    pub fn wheels_follow(&self) -> bool {
        self.wheels_before.is_some() && self.by_wheels.follow_commands()
    }

    /// The inputs that acted without dead time, for these commands: a drive with a ramp follows
    /// them late.
    pub fn ramped<'a>(&'a self, commands: &'a Sent) -> &'a Sent {
        self.ramps.sent().unwrap_or(commands)
    }

    /// Updates the estimate with the period that has just ended with velocity `after`. Its command
    /// is the newest of `commands`. `wheels` is the velocity that the wheels' speeds give, if they
    /// are measured \[m/s, m/s, rad/s\]. Ignores numbers that are not finite.
    pub fn update(&mut self, commands: &Sent, after: &Velocity, wheels: Option<&Velocity>) {
        let is_finite = |numbers: &Velocity| numbers.iter().all(|value| value.is_finite());
        let wheels = wheels.filter(|wheels| is_finite(wheels));
        let wheels_before = std::mem::replace(&mut self.wheels_before, wheels.copied());
        if !is_finite(after) || !is_finite(&commands.last()) {
            (self.before, self.wheels_before) = (None, None);
            return;
        }
        self.ramps.push(&commands.last());
        let Some(before) = self.before.replace(*after) else {
            self.follow(wheels);
            return;
        };
        let sent = *self.ramped(commands);
        self.taken = self.taken.saturating_add(1);
        let mut period = self.period(before, *after);
        period.weight = self.weight([(&before, wheels_before.as_ref()), (after, wheels)]);
        let mut believed_errors = [0.0; AXES];
        for (index, hypothesis) in self.hypotheses.iter_mut().enumerate() {
            let frame = hypothesis.frame();
            let errors = hypothesis.update(&period, &sent.acted(hypothesis.delay).input);
            if index == self.believed {
                believed_errors = errors[frame];
            }
        }
        self.forget_contradicted(&believed_errors);
        self.select();
        match (wheels_before, wheels) {
            (Some(before), Some(after)) => {
                let period = self.period(before, *after);
                let proposed = self.by_wheels.update(&period, &sent);
                self.consider(proposed);
                if self.ramps.update(&period, self.by_wheels.errors()) {
                    self.begin_anew();
                }
            }
            (None, Some(wheels)) => self.follow(Some(wheels)),
            (_, None) => {}
        }
    }

    fn period(&self, before: Velocity, after: Velocity) -> Period {
        Period {
            before,
            after,
            turning: turning(&self.main, &before).mean,
            forgetting: self.forgetting,
            scale: self.scale,
            kept: self.kept,
            weight: 1.0,
        }
    }

    /// q of a period, from the velocities of body and wheels at both of its ends. It is 1 if the
    /// wheels are not measured, or do not follow the commands.
    fn weight(&self, ends: [(&Velocity, Option<&Velocity>); 2]) -> f64 {
        if !self.by_wheels.follow_commands() {
            return 1.0;
        }
        let measured = ends.into_iter().filter_map(|(body, wheels)| Some((body, wheels?)));
        let slips = measured.flat_map(|(body, wheels)| {
            (0..AXES).map(|axis| self.scale[axis] * (wheels[axis] - body[axis]).abs())
        });
        (SLIDES_MPS / slips.fold(SLIDES_MPS, f64::max)).powi(2)
    }

    /// The wheels begin here.
    fn follow(&mut self, wheels: Option<&Velocity>) {
        if let Some(wheels) = wheels {
            self.by_wheels.resume(wheels);
            self.ramps.resume(wheels);
        }
    }

    /// Begins with the main model, because the inputs that acted were other ones than believed.
    fn begin_anew(&mut self) {
        self.hypotheses = Hypotheses::new(&self.main);
        (self.changes, self.taken) = ([Change::default(); AXES], 0);
        self.believe(self.nearest(self.ramps.delay().periods() * self.main.period));
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

    /// Selects this dead time, also as the one of the wheels.
    fn believe(&mut self, index: usize) {
        (self.believed, self.wheels_before) = (index, None);
        self.by_wheels.begin_with(&self.hypotheses, index);
    }

    /// Selects the dead time that predicts the velocity best, if it is convincingly better.
    fn select(&mut self) {
        let hypotheses = &self.hypotheses;
        let usable = |index: usize| hypotheses[index].believable();
        let cost = |index: usize| hypotheses[index].cost();
        let best = better(hypotheses.len(), self.believed, usable, cost);
        if self.taken >= PERIODS_LEAST {
            self.believed = best.unwrap_or(self.believed);
        }
    }

    /// Selects a dead time that the wheels propose, if it predicts the velocity no worse.
    fn consider(&mut self, proposed: Option<usize>) {
        let no_worse = |index: &usize| {
            let other = &self.hypotheses[*index];
            other.believable() && other.cost() <= self.hypotheses[self.believed].cost()
        };
        if let Some(index) = proposed.filter(no_worse) {
            self.believed = index;
        }
    }

    /// A period is missing: the next one begins with `velocity`, after `command` has acted for
    /// long, and `wheels` as in [`update`](Self::update).
    pub fn resume(&mut self, command: &Velocity, velocity: &Velocity, wheels: Option<&Velocity>) {
        (self.before, self.wheels_before) = (Some(*velocity), wheels.copied());
        self.settle(command);
        self.follow(wheels);
    }

    /// `command` has acted for long.
    pub fn settle(&mut self, command: &Velocity) {
        self.ramps.settle(command);
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
