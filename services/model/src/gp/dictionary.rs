//! The bounded data set of the learner: it keeps informative samples, forgets outdated ones, and
//! rejects outliers.
//!
//! | here          | in the equations                                      | size      |
//! |---------------|-------------------------------------------------------|-----------|
//! | `inverse`     | P = C⁻¹, C = K + σₙ² diag(s), of one selection kernel | `n` × `n` |
//! | `noise_scale` | s = 1 + age / τ + doubt: noise that grows with age    | `n`       |
//!
//! **Which sample is dropped.** 1/Pᵢᵢ is the variance of sample i predicted from all others, noise
//! included. So sample i adds the information ½ ln(1/(Pᵢᵢ sᵢ σₙ²)). When the set is full, the
//! sample with the least information is dropped. Of two samples with the same input it is the older
//! one. Of a long steady stretch most samples go, of an excursion none.
//!
//! **Which sample is outdated.** Noise that grows linearly with age is that of a function that
//! drifts as a random walk. Where old and new samples overlap, the new ones dominate; elsewhere the
//! old ones still count. When `surprise` detects a change of the world, all older samples get a
//! large noise at once.
//!
//! Age is counted in samples: the same samples give the same set, to the last bit.
//!
//! Reference: Csató & Opper, *Sparse on-line Gaussian processes*, Neural Computation 14, 2002; the
//! leave-one-out variance is eq. 5.12 of Rasmussen & Williams 2006.

use faer::Mat;

use crate::gp::hyperparameters::Hyperparameters;
use crate::gp::inverse::Inverse;
use crate::gp::normalisation::Normalisation;
use crate::gp::surprise::{Surprise, Verdict, WINDOW};

/// Largest s of a sample by age alone. A sample far from all others is still useful then.
const AGED_MAX: f64 = 50.0;
/// Added to s of all older samples when the world changes.
const DOUBT: f64 = 100.0;

/// One observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation<const D: usize> {
    /// Input of the observation, not normalised.
    pub input: [f64; D],
    /// Observed value of each output.
    pub target: [f64; 3],
}

/// Selection of the samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selection<const D: usize> {
    /// Largest number of observations.
    pub capacity: usize,
    /// Scales of the inputs.
    pub normalisation: Normalisation<D>,
    /// Kernel and noise that measure the information; only their ratio counts.
    pub kernel: Hyperparameters<D>,
    /// τ: number of samples after which an observation has half its weight.
    pub memory_samples: f64,
    /// Innovations that are never surprising, per output, in output units.
    pub noise_floor: [f64; 3],
}

/// Outcome of an insertion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The sample is in the set.
    Admitted,
    /// The sample equals the last one to the bit, or is not finite.
    Refused,
    /// The sample is surprising, and is held back until later ones confirm it.
    Held,
    /// The sample confirms those held back: they are in the set, and all older ones are doubted.
    Changed,
}

/// The observations in the set, oldest first.
#[derive(Debug, Clone)]
pub struct Dictionary<const D: usize> {
    selection: Selection<D>,
    entries: Vec<Entry<D>>,
    inverse: Inverse,
    surprise: Surprise,
    /// Surprising observations held back, oldest first.
    held: Vec<(u64, Observation<D>)>,
    last: Option<Observation<D>>,
    /// Number of samples judged so far.
    count: u64,
    /// Updates of the inverse since it was last recomputed.
    changes: usize,
    covariances: Vec<f64>,
    solved: Vec<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Entry<const D: usize> {
    observation: Observation<D>,
    /// Normalised.
    input: [f64; D],
    /// Value of `count` when it was made.
    made: u64,
    doubt: f64,
    /// s in the inverse.
    held_scale: f64,
}

impl<const D: usize> Dictionary<D> {
    /// An empty set. Allocates the memory for its whole capacity: O(n²).
    pub fn new(selection: Selection<D>) -> Self {
        let capacity = selection.capacity.max(1);
        Self {
            selection: Selection { capacity, ..selection },
            entries: Vec::with_capacity(capacity + 1),
            inverse: Inverse::new(capacity + 1),
            surprise: Surprise::new(selection.noise_floor),
            held: Vec::with_capacity(WINDOW as usize + 1),
            last: None,
            count: 0,
            changes: 0,
            covariances: vec![0.0; capacity + 1],
            solved: vec![0.0; capacity + 1],
        }
    }

    /// Number of observations in the set.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether the set is empty.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The observations and the s of each, oldest first.
    pub fn observations(&self) -> impl ExactSizeIterator<Item = (&Observation<D>, f64)> {
        self.entries.iter().map(|entry| (&entry.observation, self.noise_scale(entry)))
    }

    /// Judges an observation, and inserts it if it is credible. O(n²), O(n³) once in n insertions;
    /// does not allocate when full.
    pub fn insert(&mut self, observation: Observation<D>) -> Outcome {
        let finite =
            observation.input.iter().chain(&observation.target).all(|value| value.is_finite());
        if !finite || self.last == Some(observation) {
            return Outcome::Refused;
        }
        self.last = Some(observation);
        self.count += 1;
        let unexplained = self.look_at(&observation);
        let deviations = self.deviations(&observation, unexplained);
        match self.surprise.judge(&deviations) {
            Verdict::Admit(doubt) => {
                self.admit(observation, self.count, doubt, unexplained);
                Outcome::Admitted
            }
            Verdict::Hold => {
                self.hold(observation);
                Outcome::Held
            }
            Verdict::Changed(samples) => {
                self.hold(observation);
                self.change(self.count - u64::from(samples).min(self.count));
                Outcome::Changed
            }
        }
    }

    /// The world changed with the sample after `last`. Older samples are doubted, newer ones not.
    fn change(&mut self, last: u64) {
        for entry in &mut self.entries {
            entry.doubt = if entry.made > last { 0.0 } else { entry.doubt + DOUBT };
        }
        self.work_out_anew();
        for place in 0..self.held.len() {
            let (made, observation) = self.held[place];
            if made > last {
                let unexplained = self.look_at(&observation);
                self.admit(observation, made, 0.0, unexplained);
            }
        }
        self.held.clear();
    }

    /// Puts back an observation of an earlier set, with its s of then. Skips one that is not
    /// finite.
    pub fn restore(&mut self, observation: Observation<D>, noise_scale: f64) {
        let numbers = observation.input.iter().chain(&observation.target).chain([&noise_scale]);
        if numbers.into_iter().all(|value| value.is_finite()) {
            let unexplained = self.look_at(&observation);
            self.admit(observation, self.count, (noise_scale - 1.0).max(0.0), unexplained);
        }
    }

    /// Drops all observations that were put back. O(n³) in the number that is left.
    pub fn forget_restored(&mut self) {
        self.entries.retain(|entry| entry.made > 0);
        self.work_out_anew();
    }

    /// Drops all observations that were inserted, and keeps those that were put back. O(n³) in the
    /// number that is left.
    pub fn forget_inserted(&mut self) {
        self.entries.retain(|entry| entry.made == 0);
        self.held.clear();
        self.work_out_anew();
    }

    /// z of each output: the innovation of the observation that was looked at, relative to the
    /// uncertainty of the function there.
    fn deviations(&self, observation: &Observation<D>, unexplained: f64) -> [f64; 3] {
        let noise_variance = self.selection.kernel.noise_variance;
        let expected = ((unexplained + noise_variance) / noise_variance).sqrt();
        std::array::from_fn(|output| {
            let foretold: f64 = self
                .entries
                .iter()
                .zip(&self.solved)
                .map(|(entry, share)| share * entry.observation.target[output])
                .sum();
            (observation.target[output] - foretold) / expected
        })
    }

    /// Writes P c of a sample to `solved`. Returns the variance of the function there that the
    /// other samples do not explain.
    fn look_at(&mut self, observation: &Observation<D>) -> f64 {
        let input = self.selection.normalisation.apply(&observation.input);
        let kernel = &self.selection.kernel.kernel;
        let size = self.entries.len();
        for (covariance, entry) in self.covariances.iter_mut().zip(&self.entries) {
            *covariance = kernel.value(&entry.input, &input);
        }
        self.inverse.solve(&self.covariances[..size], &mut self.solved[..size]);
        let explained: f64 =
            self.covariances[..size].iter().zip(&self.solved[..size]).map(|(a, b)| a * b).sum();
        (kernel.prior(&input) - explained).max(0.0)
    }

    /// Inserts a sample that was just looked at.
    fn admit(&mut self, observation: Observation<D>, made: u64, doubt: f64, unexplained: f64) {
        let input = self.selection.normalisation.apply(&observation.input);
        let mut entry = Entry { observation, input, made, doubt, held_scale: 1.0 };
        entry.held_scale = self.noise_scale(&entry);
        let left = unexplained + self.selection.kernel.noise_variance * entry.held_scale;
        self.inverse.insert(&self.solved[..self.entries.len()], left);
        self.entries.push(entry);
        if self.entries.len() > self.selection.capacity {
            self.forget_one();
        }
        self.changes += 1;
        if self.changes >= self.selection.capacity {
            self.work_out_anew();
        }
    }

    /// Drops the sample with the largest Pᵢᵢ sᵢ, which has the least information.
    fn forget_one(&mut self) {
        let told = self
            .inverse
            .diagonal()
            .zip(&self.entries)
            .map(|(precision, entry)| precision * self.noise_scale(entry));
        let least = told.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((place, _)) = least {
            self.inverse.remove(place);
            self.entries.remove(place);
        }
    }

    /// s: 1 when the sample was made.
    fn noise_scale(&self, entry: &Entry<D>) -> f64 {
        let age = (self.count - entry.made) as f64;
        1.0 + (age / self.selection.memory_samples).min(AGED_MAX) + entry.doubt.min(DOUBT)
    }

    /// Recomputes the inverse with the present s, without the rounding of many updates.
    fn work_out_anew(&mut self) {
        self.changes = 0;
        for place in 0..self.entries.len() {
            self.entries[place].held_scale = self.noise_scale(&self.entries[place]);
        }
        let Hyperparameters { kernel, noise_variance } = &self.selection.kernel;
        let covariance = Mat::from_fn(self.entries.len(), self.entries.len(), |i, j| {
            let (a, b) = (&self.entries[i], &self.entries[j]);
            kernel.value(&a.input, &b.input)
                + if i == j { noise_variance * a.held_scale } else { 0.0 }
        });
        // Noise on the diagonal keeps it positive definite. If that ever fails, the updated inverse
        // stays.
        let _ = self.inverse.recompute(&covariance);
        self.doubt_the_wild();
    }

    /// Doubts early samples that were inserted before the noise was known. The prediction of sample
    /// i from all others differs from it by αᵢ/Pᵢᵢ, α = P y.
    fn doubt_the_wild(&mut self) {
        let noise = self.selection.kernel.noise_variance.sqrt();
        let mut deviations = vec![[0.0; 3]; self.entries.len()];
        for output in 0..3 {
            for (covariance, entry) in self.covariances.iter_mut().zip(&self.entries) {
                *covariance = entry.observation.target[output];
            }
            let size = self.entries.len();
            self.inverse.solve(&self.covariances[..size], &mut self.solved[..size]);
            for ((deviation, weight), precision) in
                deviations.iter_mut().zip(&self.solved).zip(self.inverse.diagonal())
            {
                deviation[output] = weight * noise / precision.sqrt();
            }
        }
        for (entry, deviation) in self.entries.iter_mut().zip(&deviations) {
            if self.surprise.is_wild(deviation) {
                entry.doubt = DOUBT;
            }
        }
    }

    fn hold(&mut self, observation: Observation<D>) {
        self.held.retain(|&(made, _)| made + u64::from(WINDOW) > self.count);
        self.held.push((self.count, observation));
    }
}

#[cfg(test)]
mod tests;
