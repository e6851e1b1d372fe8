//! The bounded data set of the learner: it keeps what informs, forgets what is out of date, and admits no outlier.
//!
//! | here              | in the equations                                      | size    |
//! |-------------------|-------------------------------------------------------|---------|
//! | `inverse`         | P = C⁻¹, C = K + σₙ² diag(s), of one selection kernel | `n` × `n` |
//! | `noise_scale`     | s = 1 + age / τ + doubt: noise that grows with age    | `n`     |
//!
//! **Who gives way.** 1/Pᵢᵢ is the variance of sample i foretold by all others, noise included, so it tells ½ ln(1/(Pᵢᵢ sᵢ σₙ²)) that they do not.
//! When the set is full, the one that tells least gives way: of twins the older, of a long steady stretch most, of an excursion nobody.
//!
//! **What is out of date.** Noise that grows like age is what a function that drifts by a random walk gives: the new outweighs the old where
//! both speak, and the old is still heard where nothing new was seen. When the world has changed, as `surprise` judges, all
//! that was known before is put into doubt at once.
//!
//! Age is counted in samples: the same samples give the same set, to the last bit.
//!
//! Reference: Csató & Opper, *Sparse on-line Gaussian processes*, Neural Computation 14, 2002; the leave-one-out variance is eq. 5.12 of
//! Rasmussen & Williams 2006.

use faer::Mat;

use crate::gp::hyperparameters::Hyperparameters;
use crate::gp::inverse::Inverse;
use crate::gp::normalisation::Normalisation;
use crate::gp::surprise::{Surprise, Verdict, WINDOW};

/// s of a sample never grows beyond this by age alone: far from all others it is still worth having.
const AGED_MAX: f64 = 50.0;
/// What a change of the world adds to s of all that was seen before it.
const DOUBT: f64 = 100.0;

/// One observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation<const D: usize> {
    /// Where it was made, not normalised.
    pub input: [f64; D],
    /// What was seen there, per output.
    pub target: [f64; 3],
}

/// How a dictionary chooses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selection<const D: usize> {
    /// Most observations that it keeps.
    pub capacity: usize,
    /// How inputs are scaled.
    pub normalisation: Normalisation<D>,
    /// Kernel and noise by which information is measured; only their ratio counts.
    pub kernel: Hyperparameters<D>,
    /// τ: samples after which an observation counts half.
    pub memory_samples: f64,
    /// Innovations that are never surprising, per output, in output units.
    pub noise_floor: [f64; 3],
}

/// What became of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It is in.
    Admitted,
    /// It says exactly what the last one said, or what is no number.
    Refused,
    /// It is surprising, and waits for its successors.
    Held,
    /// It confirms those on hold: they are in, and all before them is in doubt.
    Changed,
}

/// The observations that are kept, oldest first.
#[derive(Debug, Clone)]
pub struct Dictionary<const D: usize> {
    selection: Selection<D>,
    entries: Vec<Entry<D>>,
    inverse: Inverse,
    surprise: Surprise,
    /// Surprising observations that wait, oldest first.
    held: Vec<(u64, Observation<D>)>,
    last: Option<Observation<D>>,
    /// Samples ever judged.
    count: u64,
    /// Changes of the inverse since it was worked out anew.
    changes: usize,
    covariances: Vec<f64>,
    solved: Vec<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Entry<const D: usize> {
    observation: Observation<D>,
    /// Normalised.
    input: [f64; D],
    /// Value of the count when it was made.
    made: u64,
    doubt: f64,
    /// s that the inverse holds.
    held_scale: f64,
}

impl<const D: usize> Dictionary<D> {
    /// An empty one. Takes the memory for all that it will ever keep: O(n²).
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

    /// How many observations are kept.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether nothing is kept.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The observations and the s of each, oldest first.
    pub fn observations(&self) -> impl ExactSizeIterator<Item = (&Observation<D>, f64)> {
        self.entries.iter().map(|entry| (&entry.observation, self.noise_scale(entry)))
    }

    /// Judges an observation, and takes it in if it is to be believed. O(n²), O(n³) once in n; does not allocate then.
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

    /// The world has changed with the sample after `last`: what is older is in doubt, what is younger is not.
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

    /// Puts back an observation that was kept before, with the s that it had then. One that is not finite is left out.
    pub fn restore(&mut self, observation: Observation<D>, noise_scale: f64) {
        let numbers = observation.input.iter().chain(&observation.target).chain([&noise_scale]);
        if numbers.into_iter().all(|value| value.is_finite()) {
            let unexplained = self.look_at(&observation);
            self.admit(observation, self.count, (noise_scale - 1.0).max(0.0), unexplained);
        }
    }

    /// Lets go of everything that was put back. O(n³) in what is left.
    pub fn forget_restored(&mut self) {
        self.entries.retain(|entry| entry.made > 0);
        self.work_out_anew();
    }

    /// z of each output: the innovation of who was looked at, relative to what the uncertainty of the function at its place lets expect.
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

    /// P c of a sample goes to `solved`; gives what the others do not foretell of the function's variance at its place.
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

    /// Takes in a sample that was just looked at.
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

    /// The one with the largest Pᵢᵢ sᵢ tells least.
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

    /// s: 1 when it was made.
    fn noise_scale(&self, entry: &Entry<D>) -> f64 {
        let age = (self.count - entry.made) as f64;
        1.0 + (age / self.selection.memory_samples).min(AGED_MAX) + entry.doubt.min(DOUBT)
    }

    /// The inverse with the present s, free of the rounding of many steps.
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
        // Noise on the diagonal keeps it positive definite; if that ever fails, the maintained one serves on.
        let _ = self.inverse.recompute(&covariance);
        self.doubt_the_wild();
    }

    /// Early samples got in when nothing was known. What all others foretell of sample i differs from it by αᵢ/Pᵢᵢ, α = P y.
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
