//! Model snapshots in: checked and prepared on a thread of their own, handed over through preallocated slots.
//!
//! ```text
//!                    ready ─────▶
//!   attendant thread              control thread       nothing is freed, locked or waited for on the right
//!                    ◀───── returned, events
//! ```
//! The attendant also writes the control thread's events to the log.

use crossbeam_queue::ArrayQueue;
use model::gp::hyperparameters::Hyperparameters;
use model::gp::normalisation::Normalisation;
use model::gp::posterior::{Posterior, PosteriorError, VarianceScratch};
use model::learned::{INPUTS, INPUTS_WITH_HISTORY, Layout, Learned, Uncertain};
use model::{AXES, Velocity};
use protocol::message::{ModelSnapshot, Reason, Rung, SnapshotHead};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Largest relative difference between the α that came and the α worked out here.
const WEIGHT_TOLERANCE: f64 = 1e-5;

/// Most points of a model.
const POINTS_MAX: usize = 2_000;

/// What this controller can use.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// Fingerprint of its main model and layout.
    pub fingerprint: u64,
    /// Layout of the inputs.
    pub layout: Layout,
    /// Largest |g| that physics allows, per period \[m/s, m/s, rad/s\].
    pub bound: Velocity,
}

/// Why a snapshot is not used.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// It was learnt for another robot, period or layout.
    #[error("snapshot {version} has fingerprint {got:#018x}, this controller {expected:#018x}: another robot, period or input layout")]
    Fingerprint {
        /// Of the snapshot.
        version: u64,
        /// Ours.
        expected: u64,
        /// Its own.
        got: u64,
    },
    /// Another number of inputs.
    #[error("snapshot {version} has {got} inputs, this controller {expected}")]
    Inputs {
        /// Of the snapshot.
        version: u64,
        /// How many this controller's have.
        expected: usize,
        /// How many it has.
        got: u32,
    },
    /// More points than can be factorised and asked in a period.
    #[error("snapshot {version} has {got} points, this controller takes {POINTS_MAX} at most")]
    Points {
        /// Of the snapshot.
        version: u64,
        /// How many it has.
        got: u32,
    },
    /// A scale of its normalisation is not a positive number.
    #[error("snapshot {version} has an impossible normalisation")]
    Normalisation {
        /// Of the snapshot.
        version: u64,
    },
    /// What its samples are off is no variance.
    #[error("snapshot {version} has an impossible variance of a sample")]
    SampleVariance {
        /// Of the snapshot.
        version: u64,
    },
    /// Its data give no posterior.
    #[error("snapshot {version}: {source}")]
    Posterior {
        /// Of the snapshot.
        version: u64,
        /// What is wrong with them.
        source: PosteriorError,
    },
    /// Its α is not what its data give.
    #[error("snapshot {version}: its weights differ from those of its data by {difference:.1e} of the largest")]
    Weights {
        /// Of the snapshot.
        version: u64,
        /// Largest relative difference.
        difference: f64,
    },
}

/// A snapshot ready for use.
#[derive(Debug)]
pub struct Candidate {
    /// Version of the snapshot.
    pub version: u64,
    /// Epoch of the plant that it was learnt from.
    pub plant_epoch: u64,
    /// In lock step: tick at which it takes effect.
    pub effective_tick: u64,
    /// The model.
    pub learned: Box<dyn Uncertain + Send>,
    /// For its variance.
    pub scratch: VarianceScratch,
}

/// What comes to the control thread.
#[derive(Debug)]
pub enum Arrival {
    /// A model to use.
    Candidate(Box<Candidate>),
    /// There will be none for this tick.
    Refused {
        /// Tick at which it would have taken effect.
        effective_tick: u64,
    },
}

/// Something that the control thread wants written down.
#[derive(Debug, Clone, Copy)]
pub enum Event {
    /// First state of a plant epoch.
    Plant {
        /// The plant's epoch.
        epoch: u64,
        /// The controller's own.
        controller_epoch: u64,
    },
    /// Another model is in use.
    Adopted {
        /// Its version.
        version: u64,
        /// From this tick on.
        tick: u64,
    },
    /// Another rung than the one before.
    Rung {
        /// At this tick.
        tick: u64,
        /// The rung.
        rung: Rung,
        /// Why.
        reason: Reason,
    },
    /// A period was over before its answer was ready, or its state was never seen.
    Late {
        /// The tick.
        tick: u64,
        /// Time that the answer took \[ns\].
        nanos: u64,
    },
}

/// The slots between the two threads.
pub struct Handover {
    /// To the control thread.
    pub ready: ArrayQueue<Arrival>,
    /// Models that are no longer in use, to be freed.
    pub returned: ArrayQueue<Box<Candidate>>,
    /// To the log; when it is full the newest are dropped and counted.
    pub events: ArrayQueue<Event>,
    /// Events that were dropped.
    pub events_dropped: AtomicU64,
    /// Snapshots refused.
    pub refused: AtomicU64,
    /// The attendant has ended.
    pub attendant_gone: AtomicBool,
    /// Snapshots received, lost and malformed on the way, as the attendant's source counted them.
    pub snapshots: [AtomicU64; 3],
}

impl Default for Handover {
    fn default() -> Self {
        Self {
            ready: ArrayQueue::new(4),
            returned: ArrayQueue::new(8),
            events: ArrayQueue::new(256),
            events_dropped: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            attendant_gone: AtomicBool::new(false),
            snapshots: Default::default(),
        }
    }
}

impl Handover {
    /// Notes an event. Does not allocate, lock or wait.
    pub fn note(&self, event: Event) {
        if self.events.push(event).is_err() {
            self.events_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Checks that a snapshot is whole and belongs here, and makes its posterior anew from its data.
///
/// # Errors
/// [`Refusal`] if it does not belong to this controller, or is damaged.
pub fn prepare(snapshot: &ModelSnapshot, expected: &Expected) -> Result<Candidate, Refusal> {
    let head = &snapshot.head;
    let version = head.version;
    if head.fingerprint != expected.fingerprint {
        return Err(Refusal::Fingerprint { version, expected: expected.fingerprint, got: head.fingerprint });
    }
    if head.inputs as usize != expected.layout.dimension() {
        return Err(Refusal::Inputs { version, expected: expected.layout.dimension(), got: head.inputs });
    }
    if head.points as usize > POINTS_MAX {
        return Err(Refusal::Points { version, got: head.points });
    }
    match expected.layout.dimension() {
        INPUTS_WITH_HISTORY => refactored::<INPUTS_WITH_HISTORY>(snapshot, expected),
        _ => refactored::<INPUTS>(snapshot, expected),
    }
}

/// Makes the posterior of a snapshot over D inputs.
fn refactored<const D: usize>(snapshot: &ModelSnapshot, expected: &Expected) -> Result<Candidate, Refusal> {
    let (head, version) = (&snapshot.head, snapshot.head.version);
    let normalisation = normalisation::<D>(head).ok_or(Refusal::Normalisation { version })?;
    let hyperparameters = std::array::from_fn(|axis| {
        Hyperparameters::new(first(&head.length_scale[axis]), head.signal_variance[axis], head.noise_variance[axis])
            .with_linear(head.linear_variance[axis])
    });
    let count = snapshot.rows().len();
    let (mut inputs, mut targets, mut noise_scale) = (Vec::with_capacity(count), Vec::with_capacity(count), Vec::with_capacity(count));
    for row in snapshot.rows() {
        inputs.push(first(row.input));
        targets.push(first(row.target));
        noise_scale.push(row.noise_scale);
    }
    let posterior = Posterior::with_noise_scale(&inputs, &targets, &noise_scale, &hyperparameters)
        .map_err(|source| Refusal::Posterior { version, source })?;
    let difference = weight_difference(snapshot, &posterior);
    if difference > WEIGHT_TOLERANCE {
        return Err(Refusal::Weights { version, difference });
    }
    let scratch = VarianceScratch::new(inputs.len());
    let sample_variance = head.sample_variance;
    if !sample_variance.iter().all(|variance| variance.is_finite() && *variance >= 0.0) {
        return Err(Refusal::SampleVariance { version });
    }
    let learned = Box::new(Learned { layout: expected.layout, normalisation, posterior, bound: expected.bound, sample_variance });
    Ok(Candidate { version, plant_epoch: head.plant_epoch, effective_tick: head.effective_tick, learned, scratch })
}

fn normalisation<const D: usize>(head: &SnapshotHead) -> Option<Normalisation<D>> {
    let normalisation = Normalisation { mean: first(&head.input_mean), scale: first(&head.input_scale) };
    let possible =
        normalisation.mean.iter().all(|mean| mean.is_finite()) && normalisation.scale.iter().all(|&scale| scale.is_finite() && scale > 0.0);
    possible.then_some(normalisation)
}

/// Largest difference between the weights sent and those worked out, relative to the largest of its axis.
fn weight_difference<const D: usize>(snapshot: &ModelSnapshot, posterior: &Posterior<D>) -> f64 {
    let mut worst = 0.0;
    let ours = posterior.weights();
    for axis in 0..AXES {
        let theirs = || snapshot.rows().map(|row| first::<AXES>(row.weight)[axis]);
        let largest = theirs().map(f64::abs).fold(f64::MIN_POSITIVE, f64::max);
        for (a, b) in theirs().zip(ours[axis]) {
            let difference = (a - b).abs() / largest;
            worst = if difference.is_nan() { f64::INFINITY } else { f64::max(worst, difference) };
        }
    }
    worst
}

/// The first entries of a slice; missing ones are NaN, which nothing accepts.
fn first<const K: usize>(values: &[f64]) -> [f64; K] {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(f64::NAN))
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::frame::DecodeError;

    const EXPECTED: Expected = Expected { fingerprint: 42, layout: Layout::VelocitySlip, bound: [0.5; 3] };

    /// A snapshot of a few points, as a learner would make it.
    fn snapshot() -> Result<ModelSnapshot, Box<dyn std::error::Error>> {
        let mut head: SnapshotHead = bytemuck::Zeroable::zeroed();
        (head.version, head.fingerprint, head.inputs, head.score_samples) = (3, 42, INPUTS as u32, 2);
        head.input_scale = [1.0; protocol::message::INPUTS_MAX];
        head.length_scale = [[1.0; protocol::message::INPUTS_MAX]; 3];
        (head.signal_variance, head.noise_variance, head.linear_variance) = ([0.01; 3], [1e-4; 3], [0.02, 0.02, 0.0]);
        let inputs: Vec<[f64; INPUTS]> = (0..8).map(|i| std::array::from_fn(|j| ((i * INPUTS + j) as f64).sin())).collect();
        let targets: Vec<[f64; AXES]> = inputs.iter().map(|input| [0.1 * input[0], 0.1 * input[1], 0.0]).collect();
        let plain = Hyperparameters::new([1.0; INPUTS], 0.01, 1e-4);
        let hyperparameters = [plain.with_linear(0.02), plain.with_linear(0.02), plain];
        let posterior = Posterior::new(&inputs, &targets, &hyperparameters)?;
        let mut snapshot = ModelSnapshot::new(head);
        for (i, (input, target)) in inputs.iter().zip(&targets).enumerate() {
            snapshot.push(input, *target, posterior.weights().map(|weights| weights[i]))?;
        }
        Ok(snapshot)
    }

    #[test]
    fn a_snapshot_of_another_robot_is_refused_with_both_fingerprints() -> Result<(), Box<dyn std::error::Error>> {
        let mut foreign = snapshot()?;
        foreign.head.fingerprint = 7;
        assert_eq!(prepare(&foreign, &EXPECTED).err(), Some(Refusal::Fingerprint { version: 3, expected: 42, got: 7 }));
        Ok(())
    }

    #[test]
    fn weights_that_are_not_those_of_the_data_are_refused() -> Result<(), Box<dyn std::error::Error>> {
        let honest = snapshot()?;
        let mut forged = ModelSnapshot::new(honest.head);
        for row in honest.rows() {
            forged.push(row.input, first(row.target), first::<3>(row.weight).map(|weight| 1.01 * weight))?;
        }
        assert!(matches!(prepare(&forged, &EXPECTED), Err(Refusal::Weights { .. })));
        let mut aged = ModelSnapshot::new(honest.head);
        for row in honest.rows() {
            aged.push_with_noise(row.input, first(row.target), first(row.weight), 4.0)?;
        }
        assert!(matches!(prepare(&aged, &EXPECTED), Err(Refusal::Weights { .. })), "the noise of its data is not what its weights are for");
        Ok(())
    }

    #[test]
    fn numbers_that_are_none_and_scales_that_cannot_be_are_refused() -> Result<(), Box<dyn std::error::Error>> {
        let honest = snapshot()?;
        let with = |change: &dyn Fn(&mut SnapshotHead)| {
            let mut bad = honest.clone();
            change(&mut bad.head);
            prepare(&bad, &EXPECTED)
        };
        assert!(matches!(with(&|head| head.input_scale[2] = 0.0), Err(Refusal::Normalisation { .. })));
        assert!(matches!(with(&|head| head.sample_variance[1] = -1.0), Err(Refusal::SampleVariance { .. })));
        assert!(matches!(with(&|head| head.input_mean[2] = f64::NAN), Err(Refusal::Normalisation { .. })));
        assert!(matches!(with(&|head| head.length_scale[1][0] = f64::NAN), Err(Refusal::Posterior { .. })));
        assert!(matches!(with(&|head| head.signal_variance[0] = -1.0), Err(Refusal::Posterior { .. })));
        assert!(matches!(with(&|head| head.linear_variance[1] = -1.0), Err(Refusal::Posterior { .. })));
        let mut poisoned = ModelSnapshot::new(honest.head);
        poisoned.push(&[f64::NAN; INPUTS], [0.0; 3], [0.0; 3])?;
        assert!(prepare(&poisoned, &EXPECTED).is_err());
        Ok(())
    }

    #[test]
    fn another_number_of_inputs_never_fits_a_snapshot() -> Result<(), Box<dyn std::error::Error>> {
        let mut narrow = snapshot()?;
        assert!(matches!(narrow.push(&[0.0; 2], [0.0; 3], [0.0; 3]), Err(DecodeError::Length { .. })));
        Ok(())
    }
}
