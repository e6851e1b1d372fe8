//! Errors on periods that a model was not trained on.
//!
//! ```text
//! training │ margin │ held out │ margin │ training │ margin │ held out │ …
//! ```
//! The periods are cut into blocks of time. Every fifth block is held out together, five times, so
//! that each is held out once. Neighbours of a held-out block do not train its model: neighbouring
//! samples are nearly the same. A prediction begins at a measured state and goes over the recorded
//! inputs, without a measurement in between. Observers begin before the block.

use crate::contender::{Contender, LeastSquares};
use crate::periods::{Passage, Period};
use crate::training::Training;
use controller::Settings;
use learner::fit::FailedFit;
use learner::held_out::HeldOut;
use learner::snapshot::moment;
use model::gp::posterior::VarianceScratch;
use model::learned::{Learned, Residual, Uncertain};
use model::{AXES, Velocity};
use std::ops::Range;

/// Number of trainings.
pub const FOLDS: usize = 5;

/// Longest block \[s\].
const BLOCK_S: f64 = 5.0;

/// Length of the long prediction \[periods\].
pub const STEPS: usize = 10;

/// Time between a held-out block and the samples that train its model \[s\].
pub const MARGIN_S: f64 = 1.0;

/// Time for observers to settle before the block \[s\].
const WARM_UP_S: f64 = 3.0;

/// Names of the compared models. The second is the one to beat, the last the one that is judged.
pub const NAMES: [&str; 6] = [
    "main model",
    "main model + observer",
    "least squares",
    "least squares + observer",
    "learned",
    "learned + observer",
];

/// RMS errors of one model: one step ahead, and [`STEPS`] steps ahead, per axis
/// \[m/s, m/s, rad/s\].
pub type Errors = [Velocity; 2];

/// What the held-out blocks show.
#[derive(Debug, Clone)]
pub struct Findings {
    /// Of each model of [`NAMES`].
    pub errors: [Errors; NAMES.len()],
    /// Length of a block \[s\].
    pub block_s: f64,
    /// Number of held-out periods.
    pub periods: usize,
    /// Noise of new samples about the learned model.
    pub held_out: HeldOut,
}

/// Sum of squares with its number.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    squares: Velocity,
    count: f64,
}

impl Sum {
    fn add(&mut self, measured: &Velocity, predicted: &Velocity) {
        for axis in 0..AXES {
            self.squares[axis] += (measured[axis] - predicted[axis]).powi(2);
        }
        self.count += 1.0;
    }

    fn rms(&self) -> Velocity {
        self.squares.map(|squares| (squares / self.count).sqrt())
    }
}

/// Blocks of periods, counted over all passages. Block b belongs to fold b modulo [`FOLDS`].
#[derive(Debug, Clone, Copy)]
struct Blocks {
    /// Number of periods.
    all: usize,
    length: usize,
    margin: usize,
}

impl Blocks {
    fn new(all: usize, period_s: f64) -> Self {
        let periods = |time_s: f64| (time_s / period_s).ceil() as usize;
        let length = periods(BLOCK_S).min(all.div_ceil(FOLDS)).max(1);
        Self { all, length, margin: periods(MARGIN_S).max(STEPS) }
    }

    /// The held-out blocks of a fold.
    fn of(self, fold: usize) -> impl Iterator<Item = Range<usize>> {
        let blocks = (fold..self.all.div_ceil(self.length)).step_by(FOLDS);
        blocks.map(move |block| block * self.length..self.all.min((block + 1) * self.length))
    }

    /// Whether the period `at` trains the model of a fold.
    fn trains(self, at: usize, fold: usize) -> bool {
        let near = at.saturating_sub(self.margin) / self.length..=(at + self.margin) / self.length;
        near.into_iter().all(|block| block % FOLDS != fold)
    }
}

/// Trains and judges the models, once per fold.
///
/// # Errors
/// [`FailedFit`].
pub fn cross_validate<const D: usize>(
    passages: &[Passage],
    settings: &Settings,
    training: &Training<'_, D>,
) -> Result<Findings, FailedFit> {
    let period_s = settings.run.period_nanos as f64 * 1e-9;
    let warm_up = (WARM_UP_S / period_s).ceil() as usize;
    let blocks = Blocks::new(passages.iter().map(Vec::len).sum(), period_s);
    let mut sums = [[Sum::default(); 2]; NAMES.len()];
    let mut held_out = HeldOut::default();
    for fold in 0..FOLDS {
        let others = || {
            let numbered = passages.iter().flatten().enumerate();
            numbered.filter(move |(at, _)| blocks.trains(*at, fold)).map(|(_, period)| period)
        };
        let learned = training.fit(others())?.learned;
        let fitted = LeastSquares::fit(settings, others());
        let fragments: Vec<_> =
            blocks.of(fold).flat_map(|block| fragments(passages, &block)).collect();
        for (passage, judged) in &fragments {
            push(&mut held_out, &learned, &passage[judged.clone()]);
        }
        let contenders = contenders(settings, &learned, &fitted);
        for (mut contender, sums) in contenders.into_iter().zip(&mut sums) {
            for (passage, judged) in &fragments {
                judge(&mut contender, passage, judged, warm_up, sums);
            }
        }
    }
    let errors = sums.map(|sums| sums.map(|sum| sum.rms()));
    Ok(Findings { errors, block_s: blocks.length as f64 * period_s, periods: blocks.all, held_out })
}

/// The compared models, in the order of [`NAMES`].
fn contenders<const D: usize>(
    settings: &Settings,
    learned: &Learned<D>,
    fitted: &LeastSquares,
) -> [Contender; NAMES.len()] {
    let model = |index: usize| -> Option<Box<dyn Uncertain + Send>> {
        match index / 2 {
            0 => None,
            1 => Some(Box::new(fitted.clone())),
            _ => Some(Box::new(learned.clone())),
        }
    };
    std::array::from_fn(|index| Contender::new(settings, model(index), index % 2 == 1))
}

/// The parts of each passage in `block`, which counts the periods of all passages.
fn fragments<'p>(
    passages: &'p [Passage],
    block: &Range<usize>,
) -> Vec<(&'p [Period], Range<usize>)> {
    let mut begin = 0;
    let mut fragments = Vec::new();
    for passage in passages {
        let end = begin + passage.len();
        let (from, to) = (block.start.max(begin), block.end.min(end));
        if from < to {
            fragments.push((passage.as_slice(), from - begin..to - begin));
        }
        begin = end;
    }
    fragments
}

/// Errors of `contender` over all of `passages`.
pub fn errors(contender: &mut Contender, passages: &[Passage]) -> Errors {
    let mut sums = [Sum::default(); 2];
    for passage in passages {
        judge(contender, passage, &(0..passage.len()), 0, &mut sums);
    }
    sums.map(|sum| sum.rms())
}

/// Adds the errors of `contender` in the periods `judged` of `passage`.
fn judge(
    contender: &mut Contender,
    passage: &[Period],
    judged: &Range<usize>,
    warm_up: usize,
    sums: &mut [Sum; 2],
) {
    contender.reset();
    for at in judged.start.saturating_sub(warm_up)..judged.end {
        if judged.contains(&at) {
            let ahead = &passage[at..passage.len().min(at + STEPS)];
            let ends = contender.predict(ahead).zip(ahead).enumerate();
            for (step, (predicted, period)) in ends {
                if step == 0 {
                    sums[0].add(&period.after, &predicted);
                }
                if step + 1 == STEPS {
                    sums[1].add(&period.after, &predicted);
                }
            }
        }
        contender.observe(&passage[at]);
    }
}

/// Adds the errors of `learned` on samples that it was not trained on.
fn push<const D: usize>(held_out: &mut HeldOut, learned: &Learned<D>, periods: &[Period]) {
    let mut scratch = VarianceScratch::new(learned.posterior.samples());
    for Period { sample, .. } in periods {
        let (at, told) = (moment(sample), &learned.sample_variance);
        let mean = learned.mean(&at);
        let error = std::array::from_fn(|axis| sample.residual[axis] - mean[axis]);
        held_out.push(&error, &learned.variance(&at, &mut scratch), told);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_period_is_held_out_once_and_trains_no_model_of_its_neighbours() {
        for (all, period_s) in [(100, 0.1), (1234, 0.1), (700, 0.02)] {
            let blocks = Blocks::new(all, period_s);
            let mut times = vec![0; all];
            for fold in 0..FOLDS {
                let held_out: Vec<usize> = blocks.of(fold).flatten().collect();
                for &at in &held_out {
                    times[at] += 1;
                }
                let training: Vec<usize> = (0..all).filter(|&at| blocks.trains(at, fold)).collect();
                assert!(training.len() * 5 > all, "{} of {all}", training.len());
                for at in &training {
                    assert!(held_out.iter().all(|other| other.abs_diff(*at) > blocks.margin));
                }
            }
            assert!(times.iter().all(|&times| times == 1));
        }
    }
}
