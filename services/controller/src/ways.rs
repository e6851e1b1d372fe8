//! The ways to explain the residual, side by side, and the one that is used on each axis.

use crate::adopt::Candidate;
use crate::trust::{Trust, Way};
use model::explanation::{Explanation, Sample};
use model::learned::{Moment, Residual, Response};
use model::observer::Observer;
use model::{AXES, Velocity};

/// Periods that are gone through again when another learned model comes, to find its d and to judge it.
const RECENT: usize = 12;

/// Explanations, records, and the learned model that is in use. Does not allocate after set-up.
#[derive(Debug)]
pub struct Ways {
    active: Option<Box<Candidate>>,
    plain: Explanation,
    learned: Explanation,
    trust: Trust,
    recent: [Sample; RECENT],
    /// Samples ever taken in; the last ones are kept, in a ring.
    taken: usize,
}

impl Ways {
    /// Ways that know nothing yet, with an observer that is as fresh.
    pub fn new(observer: Observer, trust: Trust) -> Self {
        Self {
            active: None,
            plain: Explanation::new(observer.clone()),
            learned: Explanation::new(observer),
            trust,
            recent: [Sample::default(); RECENT],
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

    /// How often a learned model was left, over all axes.
    pub fn left(&self) -> u64 {
        self.trust.left()
    }

    /// d, per axis \[m/s, m/s, rad/s\].
    pub fn disturbance(&self) -> Velocity {
        self.per_axis(self.plain.disturbance(), self.learned.disturbance())
    }

    /// Last one-step error, per axis \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.per_axis(self.plain.innovation(), self.learned.innovation())
    }

    /// Variance of the residual of one period, per axis: what the learned model says where it is used, elsewhere what the observer has missed of
    /// late. O(n²) \[(m/s)², (m/s)², (rad/s)²\].
    pub fn step_variance(&mut self, at: &Moment) -> Velocity {
        let (chosen, plain) = (self.trust.chosen(), self.plain.spread());
        let Some(active) = self.active.as_mut().filter(|_| chosen.contains(&Way::Learned)) else { return plain };
        let learned = active.learned.sample_variance(at, &mut active.scratch);
        std::array::from_fn(|axis| if chosen[axis] == Way::Learned { learned[axis] } else { plain[axis] })
    }

    /// Takes in one period. `known` is what somebody says of it in the place of the main model alone.
    pub fn update(&mut self, sample: &Sample, known: Velocity) {
        let learned = self.active.as_ref().map_or([0.0; AXES], |active| active.learned.mean(&sample.at));
        self.plain.update(sample, &known);
        self.learned.update(sample, &learned);
        self.trust.update(&self.plain.error(), &self.learned.error());
        let place = self.taken % RECENT;
        if let Some(slot) = self.recent.get_mut(place) {
            *slot = *sample;
        }
        self.taken += 1;
    }

    /// Puts a learned model in use, as if it had always been there, and gives back the one before, for somebody else to free.
    pub fn adopt(&mut self, candidate: Box<Candidate>) -> Option<Box<Candidate>> {
        self.learned.reset();
        let kept = self.taken.min(RECENT);
        let mut errors = [[0.0; AXES]; RECENT];
        for (slot, age) in errors.iter_mut().zip((0..kept).rev()) {
            let Some(sample) = self.recent.get((self.taken - 1 - age) % RECENT) else { continue };
            self.learned.update(sample, &candidate.learned.mean(&sample.at));
            *slot = self.learned.error();
        }
        self.trust.judge(errors.get(..kept).unwrap_or(&[]));
        self.active.replace(candidate)
    }

    /// Forgets all but the learned model.
    pub fn reset(&mut self) {
        self.plain.reset();
        self.learned.reset();
        self.trust.reset();
        self.taken = 0;
        if self.active.is_some() {
            self.trust.judge(&[]);
        }
    }

    fn per_axis(&self, plain: Velocity, learned: Velocity) -> Velocity {
        let chosen = self.trust.chosen();
        std::array::from_fn(|axis| if chosen[axis] == Way::Learned { learned[axis] } else { plain[axis] })
    }
}

impl Residual for Ways {
    fn mean(&self, at: &Moment) -> Velocity {
        self.response(at).mean
    }

    fn response(&self, at: &Moment) -> Response {
        let chosen = self.trust.chosen();
        let mut response = Response::NONE;
        if let Some(active) = self.active.as_ref().filter(|_| chosen.contains(&Way::Learned)) {
            let learned = active.learned.response(at);
            for axis in (0..AXES).filter(|&axis| chosen[axis] == Way::Learned) {
                response.mean[axis] = learned.mean[axis];
                response.by_velocity[axis] = learned.by_velocity[axis];
                response.by_input[axis] = learned.by_input[axis];
                response.by_before[axis] = learned.by_before[axis];
            }
        }
        response
    }
}
