//! No harm: several explanations of the residual run side by side. On each axis, the one that
//! predicts best is used.
//!
//! An explanation is a model with a disturbance observer. The observer is plain with a gain ℓ, or a
//! Kalman filter with a ratio q ([`model::observer`]):
//!
//! ```text
//! left = g − ĝ(v, u)      plain: innovation = left − d      d ← d + ℓ innovation
//! ```
//! | model ĝ    | what it is                                                                  |
//! |------------|-----------------------------------------------------------------------------|
//! | `Main`     | 0: the main model alone, or the oracle's model                              |
//! | `Response` | the first-order response that is identified while driving                   |
//! | `Physics`  | that, friction, drag and the turning frame, by least squares                |
//! | `Learned`  | the Gaussian processes of the newest snapshot                               |
//! | `LastGood` | those of the last proven snapshot that was in use at the next one's arrival |
//!
//! So an abandoned snapshot is replaced by the one before it, if that predicts clearly better than
//! the main model: the weight of its score is three.
//!
//! A plan holds d constant over its horizon, and a command acts only after the dead time. So an
//! explanation is judged by the d of a few periods ago, and by the lasting part of its error:
//!
//! ```text
//! e_k = left_k − d_{k−1−lead}      low-passed over 0.15 s      score: its mean square over 1 s
//! ```
//! Noise of a measured velocity enters two residuals with opposite signs, so that the low pass
//! removes most of it. All errors are evaluated before the model can have learned from the sample.

mod judge;
mod prediction;

use crate::adopt::Candidate;
use crate::settings::{Identify, Observers};
use model::delay::DELAY_MAX;
use model::learned::{Moment, Residual};
use model::main_model::MainModel;
use model::observer::{Observer, ObserverGain};
use model::physics::{FoundPhysics, Physics};
use model::response::FirstOrderResponse;
use model::{AXES, Velocity};

/// ℓ of the plain observers, in shares of the largest one; 0 is no observer.
const GAINS: [f64; 7] = [0.0, 1.0, 0.5, 0.25, 0.12, 0.06, 0.03];

/// q of the Kalman filters.
const RATIOS: [f64; 5] = [1.0, 1e-1, 1e-2, 1e-3, 1e-4];

/// Number of observers of each model.
const OBSERVERS: usize = GAINS.len() + RATIOS.len();

/// Number of explanations on each axis.
const COUNT: usize = Model::ALL.len() * OBSERVERS;

/// Number of stored periods.
const KEPT: usize = 24;

/// Time constant of the low pass on errors \[s\].
const LASTING_S: f64 = 0.15;

/// Time from a state to the first effect of a plan's later inputs, in addition to the dead time
/// \[s\].
const LEAD_S: f64 = 0.04;

/// Largest lead in periods.
const LEAD_MAX: usize = KEPT - 1 - DELAY_MAX;

/// A model of a part of the residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// No explanation: the main model alone.
    Main,
    /// The identified first-order response.
    Response,
    /// Physical effects that the main model omits, with weights that are identified while driving.
    Physics,
    /// The learned model.
    Learned,
    /// The previous learned model, which was in use.
    LastGood,
}

impl Model {
    const ALL: [Self; 5] =
        [Self::Main, Self::Response, Self::Physics, Self::Learned, Self::LastGood];

    /// Its first explanation.
    const fn first(self) -> usize {
        self as usize * OBSERVERS
    }

    /// Whether it comes from a learner.
    pub const fn is_learned(self) -> bool {
        matches!(self, Self::Learned | Self::LastGood)
    }
}

/// The available explanations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Largest ℓ; with 0 there are no observers.
    pub observer_gain: f64,
    /// The available observers.
    pub observers: Observers,
    /// Identified parameters, which are explanations too.
    pub identify: Identify,
    /// Whether a learned model is used from the first one on, to measure the cost.
    pub blind: bool,
}

impl Choice {
    fn has_physics(&self) -> bool {
        self.identify == Identify::Physics
    }
}

/// One axis: observer, error and score of every explanation.
#[derive(Debug, Clone, Copy)]
struct Axis {
    observer: [Observer; COUNT],
    lasting: [f64; COUNT],
    score: [f64; COUNT],
    chosen: usize,
    innovation: f64,
    /// Mean square of the innovation.
    spread: f64,
}

impl Axis {
    fn new(chosen: usize) -> Self {
        Self {
            observer: [Observer::default(); COUNT],
            lasting: [0.0; COUNT],
            score: [0.0; COUNT],
            chosen,
            innovation: 0.0,
            spread: 0.0,
        }
    }
}

/// One past period.
#[derive(Debug, Clone, Copy)]
struct Past {
    at: Moment,
    /// ĝ of the learned model.
    learned: Velocity,
    /// d after it, per axis and explanation.
    disturbance: [[f64; COUNT]; AXES],
}

impl Default for Past {
    fn default() -> Self {
        let disturbance = [[0.0; COUNT]; AXES];
        Self { at: Moment::default(), learned: [0.0; AXES], disturbance }
    }
}

/// All explanations, and the one in use on each axis. Does not allocate after set-up.
#[derive(Debug)]
pub struct Explanations {
    /// The newest learned model.
    active: Option<Box<Candidate>>,
    /// The last model before it that was in use when its successor arrived.
    last_good: Option<Box<Candidate>>,
    response: FirstOrderResponse,
    physics: Physics,
    /// Weights of the physical effects at the start of a run.
    first_physics: Physics,
    choice: Choice,
    /// Number of observers in use, beside each model the first ones.
    observers: usize,
    /// Gain of every observer, per axis.
    gains: [[ObserverGain; OBSERVERS]; AXES],
    /// A of the main model.
    decay: Velocity,
    /// Largest |d| that physics allows \[m/s, m/s, rad/s\].
    bound: Velocity,
    axes: [Axis; AXES],
    /// The last periods, in a ring.
    past: Box<[Past]>,
    /// Number of processed periods.
    taken: usize,
    /// Number of these with a learned model.
    with_learned: usize,
    /// Number of these with the newest one.
    with_newest: usize,
    /// Number of times that a learned model was abandoned, over all axes.
    left: u64,
    period: f64,
}

const fn model(explanation: usize) -> Model {
    Model::ALL[explanation / OBSERVERS]
}

/// Index of its observer; the first is none.
const fn observer(explanation: usize) -> usize {
    explanation % OBSERVERS
}

/// The gains of all observers of an axis with A = `decay`, whose largest ℓ is `largest`.
fn gains(largest: f64, decay: f64) -> [ObserverGain; OBSERVERS] {
    std::array::from_fn(|index| match GAINS.get(index) {
        Some(share) => ObserverGain::plain(largest * share),
        None => ObserverGain::kalman(decay, RATIOS[index - GAINS.len()]),
    })
}

impl Explanations {
    /// The explanations of `choice`, without measurements yet.
    pub fn new(
        choice: Choice,
        main: &MainModel,
        bound: Velocity,
        response: FirstOrderResponse,
        physics: Physics,
    ) -> Self {
        Self {
            first_physics: physics.clone(),
            physics,
            active: None,
            last_good: None,
            response,
            choice,
            observers: match choice.observers {
                Observers::Gains => GAINS.len(),
                Observers::Kalman => OBSERVERS,
            },
            gains: main.decay.map(|decay| gains(choice.observer_gain, decay)),
            decay: main.decay,
            bound,
            axes: [Axis::new(first(&choice)); AXES],
            past: vec![Past::default(); KEPT].into_boxed_slice(),
            taken: 0,
            with_learned: 0,
            with_newest: 0,
            left: 0,
            period: main.period,
        }
    }

    /// Version of the learned model: of the last good one if that alone is used, else of the
    /// newest; 0 is none.
    pub fn version(&self) -> u64 {
        let models = self.models();
        let is_back = models.contains(&Model::LastGood) && !models.contains(&Model::Learned);
        let learned = if is_back { &self.last_good } else { &self.active };
        learned.as_ref().map_or(0, |learned| learned.version)
    }

    /// The model in use, per axis.
    pub fn models(&self) -> [Model; AXES] {
        self.axes.map(|axis| model(axis.chosen))
    }

    /// Number of times that a learned model was abandoned, over all axes.
    pub fn left(&self) -> u64 {
        self.left
    }

    /// d, per axis \[m/s, m/s, rad/s\].
    pub fn disturbance(&self) -> Velocity {
        self.axes.map(|axis| axis.observer[axis.chosen].disturbance)
    }

    /// Last one-step error of the explanation in use, per axis \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.axes.map(|axis| axis.innovation)
    }

    /// Updates scores and disturbances with one period, whose residual is `residual`. `known` is
    /// the oracle's prediction of the residual, or zero. `response` is the newest identified
    /// response. `under_way` is the dead time in whole periods.
    pub fn update(
        &mut self,
        at: &Moment,
        residual: &Velocity,
        known: &Velocity,
        response: FirstOrderResponse,
        under_way: usize,
    ) {
        let mean = |of: &Option<Box<Candidate>>| {
            of.as_ref().map_or([0.0; AXES], |learned| learned.learned.mean(at))
        };
        let (learned, last_good) = (mean(&self.active), mean(&self.last_good));
        let identified = self.response.mean(at);
        let physical = if self.choice.has_physics() {
            let mean = self.physics.mean(at);
            self.physics.update(at, residual);
            mean
        } else {
            [0.0; AXES]
        };
        self.response = response;
        self.taken += 1;
        self.with_learned += usize::from(self.active.is_some());
        self.with_newest += usize::from(self.active.is_some());
        let lead = under_way + ((LEAD_S / self.period).round() as usize).clamp(1, LEAD_MAX);
        let judged =
            (self.taken > lead + 1).then(|| self.past[(self.taken - 1 - lead) % KEPT].disturbance);
        for axis in 0..AXES {
            let predictions =
                [known[axis], identified[axis], physical[axis], learned[axis], last_good[axis]];
            let left = predictions.map(|predicted| residual[axis] - predicted);
            if let Some(before) = &judged {
                self.judge(axis, &left, &before[axis], lead);
            }
            self.correct(axis, &left);
        }
        let disturbance = self.axes.map(|axis| axis.observer.map(|of| of.disturbance));
        self.past[self.taken % KEPT] = Past { at: *at, learned, disturbance };
    }

    /// Adopts a learned model. Its disturbance estimates start from the mean residual that it
    /// leaves in the last periods. If the previous model was in use for long, it becomes the last
    /// good one. Returns the model that is no longer needed, for another thread to free.
    pub fn adopt(&mut self, candidate: Box<Candidate>) -> Option<Box<Candidate>> {
        let recent = ((LASTING_S / self.period).round() as usize).clamp(1, KEPT).min(self.taken);
        let mut shift = [0.0; AXES];
        for age in 0..recent {
            let slot = (self.taken - age) % KEPT;
            let now = candidate.learned.mean(&self.past[slot].at);
            for axis in 0..AXES {
                let change = self.past[slot].learned[axis] - now[axis];
                shift[axis] += if change.is_finite() { change / recent as f64 } else { 0.0 };
            }
        }
        let models = self.models();
        let is_proven = self.is_long(self.with_newest);
        let was_good =
            is_proven && models.contains(&Model::Learned) && !models.contains(&Model::LastGood);
        self.with_newest = 0;
        if was_good {
            self.keep_learned();
        }
        for (record, shift) in self.axes.iter_mut().zip(shift) {
            for (explanation, estimate) in record.observer.iter_mut().enumerate() {
                if model(explanation) == Model::Learned && observer(explanation) > 0 {
                    estimate.disturbance += shift;
                }
            }
        }
        let mut before = self.active.replace(candidate);
        if was_good {
            std::mem::swap(&mut self.last_good, &mut before);
        }
        if self.choice.blind {
            (0..AXES).for_each(|axis| self.choose(axis));
        }
        before
    }

    /// Moves the record of the newest learned model to the last good one.
    fn keep_learned(&mut self) {
        let (from, to) = (Model::Learned.first(), Model::LastGood.first());
        let kept = from..from + OBSERVERS;
        let keep = |of: &mut [f64; COUNT]| of.copy_within(kept.clone(), to);
        for axis in &mut self.axes {
            axis.observer.copy_within(kept.clone(), to);
            [&mut axis.lasting, &mut axis.score].into_iter().for_each(keep);
        }
        self.past.iter_mut().flat_map(|past| &mut past.disturbance).for_each(keep);
    }

    /// Identified physical effects, if they are an explanation.
    pub fn found_physics(&self) -> Option<FoundPhysics> {
        self.choice.has_physics().then(|| self.physics.found())
    }

    /// Starts, now and after each reset, from the result of an earlier run. Returns false if that
    /// is impossible.
    pub fn begin_with(&mut self, found: &FoundPhysics) -> bool {
        let is_usable = self.first_physics.begin_with(found);
        self.physics.clone_from(&self.first_physics);
        is_usable
    }

    /// Processes a missing period: the next one begins with a measured velocity that is not
    /// compared.
    pub fn resume(&mut self) {
        self.axes.iter_mut().flat_map(|axis| &mut axis.observer).for_each(Observer::resume);
    }

    /// Drops everything except the learned models.
    pub fn reset(&mut self, response: FirstOrderResponse) {
        self.response = response;
        self.physics.clone_from(&self.first_physics);
        self.axes = [Axis::new(first(&self.choice)); AXES];
        self.past.fill(Past::default());
        (self.taken, self.with_learned, self.with_newest) = (0, 0, 0);
        if self.choice.blind {
            (0..AXES).for_each(|axis| self.choose(axis));
        }
    }
}

/// The main model, with the fastest observer if there is one.
fn first(choice: &Choice) -> usize {
    usize::from(choice.observer_gain > 0.0)
}

#[cfg(test)]
mod tests;
