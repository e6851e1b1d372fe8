//! The ways to explain the residual, side by side, and the one that is used on each axis.

use crate::adopt::Candidate;
use crate::trust::{Trust, Way};
use model::explanation::{Explanation, Sample};
use model::learned::{Residual, Response};
use model::least_squares::LeastSquares;
use model::observer::Observer;
use model::{AXES, Velocity};

/// Periods that are gone through again when another learned model comes.
const RECENT: usize = 100;

/// Of them, the last ones, which it is judged by.
const JUDGED: usize = 10;

/// What is open to a controller from the start. A learned model opens its own way when it comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Adaptation {
    /// Main model and observer.
    None,
    /// Also a linear part, alone and beside the learned model.
    Linear,
    /// The linear part and nothing else, whether it does good or harm.
    LinearAlone,
}

/// Explanations, records, and the learned model that is in use. Does not allocate after set-up.
#[derive(Debug)]
pub struct Ways {
    active: Option<Box<Candidate>>,
    /// In the order of [`Way::ALL`].
    explanations: [Explanation; 3],
    trust: Trust,
    start: Trust,
    recent: Vec<Sample>,
    /// Samples ever taken in; the last ones are kept, in a ring.
    taken: usize,
}

impl Ways {
    /// Ways that know nothing yet. `linear` and `observer` are as fresh.
    pub fn new(adaptation: Adaptation, linear: LeastSquares, observer: Observer) -> Self {
        let beside = (adaptation == Adaptation::Linear).then(|| linear.clone());
        let open: &[Way] = match adaptation {
            Adaptation::None => &[Way::Plain],
            Adaptation::Linear => &[Way::Plain, Way::Linear],
            Adaptation::LinearAlone => &[Way::Linear],
        };
        let start = Trust::new(open);
        Self {
            active: None,
            explanations: [
                Explanation::new(None, observer.clone()),
                Explanation::new(Some(linear), observer.clone()),
                Explanation::new(beside, observer),
            ],
            trust: start.clone(),
            start,
            recent: vec![Sample::default(); RECENT],
            taken: 0,
        }
    }

    /// Version of the learned model in use; 0 is none.
    pub fn version(&self) -> u64 {
        self.active.as_ref().map_or(0, |active| active.version)
    }

    /// The learned model in use.
    pub fn active_mut(&mut self) -> Option<&mut Candidate> {
        self.active.as_deref_mut()
    }

    /// The way that is used on each axis.
    pub fn chosen(&self) -> [Way; AXES] {
        self.trust.chosen()
    }

    /// d, per axis \[m/s, m/s, rad/s\].
    pub fn disturbance(&self) -> Velocity {
        self.per_axis(Explanation::disturbance)
    }

    /// Last one-step error, per axis \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.per_axis(Explanation::innovation)
    }

    /// Takes in one period. `known` is what a model says that is better than all of these, in their place.
    pub fn update(&mut self, sample: &Sample, known: Option<Velocity>) {
        let learned = self.active.as_ref().map_or([0.0; AXES], |active| active.learned.mean(&sample.velocity, &sample.input));
        let opinions = [known.unwrap_or_default(), [0.0; AXES], learned];
        for (explanation, opinion) in self.explanations.iter_mut().zip(&opinions) {
            explanation.update(sample, opinion);
        }
        self.trust.update(&self.explanations.each_ref().map(Explanation::error));
        let place = self.taken % RECENT;
        if let Some(slot) = self.recent.get_mut(place) {
            *slot = *sample;
        }
        self.taken += 1;
    }

    /// Puts a learned model in use, as if it had always been there, and gives back the one before, for somebody else to free.
    pub fn adopt(&mut self, candidate: Box<Candidate>) -> Option<Box<Candidate>> {
        let [_, _, beside] = &mut self.explanations;
        beside.reset();
        let kept = self.taken.min(RECENT);
        let mut errors = [[0.0; AXES]; JUDGED];
        for age in (0..kept).rev() {
            let Some(sample) = self.recent.get((self.taken - 1 - age) % RECENT) else { continue };
            beside.update(sample, &candidate.learned.mean(&sample.velocity, &sample.input));
            if let Some(slot) = errors.get_mut(age) {
                *slot = beside.error();
            }
        }
        let judged = kept.min(JUDGED);
        self.trust.judge((0..judged).map(|back| errors[judged - 1 - back]));
        self.active.replace(candidate)
    }

    /// Forgets all but the learned model.
    pub fn reset(&mut self) {
        self.explanations.iter_mut().for_each(Explanation::reset);
        self.trust = self.start.clone();
        self.taken = 0;
        if self.active.is_some() {
            self.trust.judge([].into_iter());
        }
    }

    fn per_axis(&self, of: impl Fn(&Explanation) -> Velocity) -> Velocity {
        let chosen = self.trust.chosen();
        std::array::from_fn(|axis| of(&self.explanations[chosen[axis] as usize])[axis])
    }
}

impl Residual for Ways {
    fn mean(&self, velocity: &Velocity, input: &Velocity) -> Velocity {
        self.response(velocity, input).mean
    }

    fn response(&self, velocity: &Velocity, input: &Velocity) -> Response {
        let chosen = self.trust.chosen();
        let mut response = Response::NONE;
        let mut add = |way: Way, part: &Response| {
            for axis in (0..AXES).filter(|&axis| chosen[axis] == way) {
                response.mean[axis] += part.mean[axis];
                for column in 0..AXES {
                    response.by_velocity[axis][column] += part.by_velocity[axis][column];
                    response.by_input[axis][column] += part.by_input[axis][column];
                }
            }
        };
        for way in [Way::Linear, Way::Learned] {
            if chosen.contains(&way)
                && let Some(linear) = self.explanations[way as usize].linear()
            {
                add(way, &linear.response(velocity, input));
            }
        }
        if chosen.contains(&Way::Learned)
            && let Some(active) = &self.active
        {
            add(Way::Learned, &active.learned.response(velocity, input));
        }
        response
    }
}
