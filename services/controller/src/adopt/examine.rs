//! snapshot → candidate: complete, newest, finite, possible, and with the weights that follow from
//! its data; or refused.

use super::{Candidate, Expected, Refusal};
use model::AXES;
use model::gp::hyperparameters::Hyperparameters;
use model::gp::normalisation::Normalisation;
use model::gp::posterior::{Posterior, VarianceScratch};
use model::learned::{
    INPUTS, INPUTS_WITH_HEADING, INPUTS_WITH_HISTORY, INPUTS_WITH_PLACE, Learned,
};
use protocol::message::{ModelSnapshot, SnapshotHead};
use std::ops::RangeInclusive;

/// Largest relative difference between the received α and the α computed here.
const WEIGHT_TOLERANCE: f64 = 1e-5;

/// Largest number of points of a model.
pub(super) const POINTS_MAX: usize = 2_000;

/// Possible length scales over normalised inputs: from noise to almost straight.
const LENGTH_SCALE: RangeInclusive<f64> = 1e-2..=1e4;
/// Possible standard deviations of function and noise, in multiples of the largest residual that
/// physics allows.
const DEVIATION: RangeInclusive<f64> = 1e-7..=10.0;
/// Possible scale of an input, and, with either sign, its possible centre, in its unit.
const INPUT: RangeInclusive<f64> = 1e-6..=1e6;

/// Examines one snapshot after the other.
#[derive(Debug)]
pub struct Examiner {
    expected: Expected,
    /// Learner's epoch and version of the newest good snapshot.
    newest: Option<(u64, u64)>,
}

impl Examiner {
    /// An examiner that has not received a snapshot yet.
    pub fn new(expected: Expected) -> Self {
        Self { expected, newest: None }
    }

    /// Checks that a snapshot is complete, belongs to this controller, and is no older than the
    /// last good one. Computes its posterior again from its data. The same version may come again.
    /// A learner of a later epoch may restart its count.
    ///
    /// # Errors
    /// [`Refusal`] if it does not belong to this controller, is stale, or is damaged. The last good
    /// one stays the newest.
    pub fn examine(&mut self, snapshot: &ModelSnapshot) -> Result<Candidate, Refusal> {
        let head = &snapshot.head;
        let (version, epoch) = (head.version, head.stamp.epoch);
        if let Some((newest_epoch, newest)) = self.newest
            && (epoch, version) < (newest_epoch, newest)
        {
            return Err(Refusal::Stale { version, epoch, newest, newest_epoch });
        }
        let candidate = prepare(snapshot, &self.expected)?;
        self.newest = Some((epoch, version));
        Ok(candidate)
    }
}

/// Checks that a snapshot is complete and belongs to this controller, and computes its posterior
/// from its data.
///
/// # Errors
/// [`Refusal`] if it does not belong to this controller, or is damaged.
pub fn prepare(snapshot: &ModelSnapshot, expected: &Expected) -> Result<Candidate, Refusal> {
    let head = &snapshot.head;
    let version = head.version;
    if head.fingerprint != expected.fingerprint {
        return Err(Refusal::Fingerprint {
            version,
            expected: expected.fingerprint,
            got: head.fingerprint,
        });
    }
    if head.inputs as usize != expected.layout.dimension() {
        return Err(Refusal::Inputs {
            version,
            expected: expected.layout.dimension(),
            got: head.inputs,
        });
    }
    if head.points as usize > POINTS_MAX {
        return Err(Refusal::Points { version, got: head.points });
    }
    let got = snapshot.rows().len();
    if head.points as usize != got {
        return Err(Refusal::Size { version, promised: head.points, got });
    }
    check_finite(snapshot)?;
    check_hyperparameters(head, expected)?;
    match expected.layout.dimension() {
        INPUTS_WITH_HEADING => refactored::<INPUTS_WITH_HEADING>(snapshot, expected),
        INPUTS_WITH_HISTORY => refactored::<INPUTS_WITH_HISTORY>(snapshot, expected),
        INPUTS_WITH_PLACE => refactored::<INPUTS_WITH_PLACE>(snapshot, expected),
        _ => refactored::<INPUTS>(snapshot, expected),
    }
}

/// Computes the posterior of a snapshot over D inputs.
fn refactored<const D: usize>(
    snapshot: &ModelSnapshot,
    expected: &Expected,
) -> Result<Candidate, Refusal> {
    let (head, version) = (&snapshot.head, snapshot.head.version);
    let normalisation = normalisation::<D>(head).ok_or(Refusal::Normalisation { version })?;
    let hyperparameters = std::array::from_fn(|axis| {
        Hyperparameters::new(
            first(&head.length_scale[axis]),
            head.signal_variance[axis],
            head.noise_variance[axis],
        )
        .with_linear(head.linear_variance[axis])
        .with_place(head.place_variance[axis])
    });
    let count = snapshot.rows().len();
    let (mut inputs, mut targets, mut noise_scale) =
        (Vec::with_capacity(count), Vec::with_capacity(count), Vec::with_capacity(count));
    for row in snapshot.rows() {
        inputs.push(first(row.input));
        targets.push(first(row.target));
        noise_scale.push(row.noise_scale);
    }
    let posterior = Posterior::with_noise_scale(&inputs, &targets, &noise_scale, &hyperparameters)
        .map_err(|source| Refusal::Posterior { version, source })?;
    if let Some((axis, jitter)) =
        posterior.jitter().into_iter().enumerate().find(|&(_, jitter)| jitter > 0.0)
    {
        return Err(Refusal::Indefinite { version, axis, jitter });
    }
    let difference = weight_difference(snapshot, &posterior);
    if difference > WEIGHT_TOLERANCE {
        return Err(Refusal::Weights { version, difference });
    }
    let scratch = VarianceScratch::new(inputs.len());
    let sample_variance = head.sample_variance;
    let learned = Box::new(Learned {
        layout: expected.layout,
        normalisation,
        posterior,
        bound: expected.bound,
        sample_variance,
    });
    Ok(Candidate {
        version,
        plant_epoch: head.plant_epoch,
        effective_tick: head.effective_tick,
        learned,
        scratch,
    })
}

fn normalisation<const D: usize>(head: &SnapshotHead) -> Option<Normalisation<D>> {
    let normalisation =
        Normalisation { mean: first(&head.input_mean), scale: first(&head.input_scale) };
    let mut means = normalisation.mean.iter();
    let possible = means.all(|mean| mean.abs() <= *INPUT.end())
        && normalisation.scale.iter().all(|scale| INPUT.contains(scale));
    possible.then_some(normalisation)
}

/// Checks every number of a snapshot, used or not.
fn check_finite(snapshot: &ModelSnapshot) -> Result<(), Refusal> {
    let head = &snapshot.head;
    let of_head: [(&'static str, &[f64]); 12] = [
        ("input_mean", &head.input_mean),
        ("input_scale", &head.input_scale),
        ("length_scale", head.length_scale.as_flattened()),
        ("signal_variance", &head.signal_variance),
        ("linear_variance", &head.linear_variance),
        ("place_variance", &head.place_variance),
        ("noise_variance", &head.noise_variance),
        ("sample_variance", &head.sample_variance),
        ("log_likelihood", &head.log_likelihood),
        ("jitter", &head.jitter),
        ("score_learned", &head.score_learned),
        ("score_main", &head.score_main),
    ];
    let of_rows = snapshot
        .rows()
        .flat_map(|row| [("input", row.input), ("target", row.target), ("weight", row.weight)]);
    for (field, values) in of_head.into_iter().chain(of_rows) {
        if !values.iter().all(|value| value.is_finite()) {
            return Err(Refusal::NotFinite { version: head.version, field });
        }
    }
    let noise_scales = snapshot.rows().all(|row| row.noise_scale.is_finite());
    if noise_scales {
        Ok(())
    } else {
        Err(Refusal::NotFinite { version: head.version, field: "noise_scale" })
    }
}

/// Checks that the hyperparameters are possible for a residual of this robot.
fn check_hyperparameters(head: &SnapshotHead, expected: &Expected) -> Result<(), Refusal> {
    let version = head.version;
    let within = |axis: usize, name: &'static str, value: f64, (least, most): (f64, f64)| {
        if (least..=most).contains(&value) {
            Ok(())
        } else {
            Err(Refusal::Hyperparameter { version, axis, name, value, least, most })
        }
    };
    for (axis, bound) in expected.bound.into_iter().enumerate() {
        let (least, most) =
            ((DEVIATION.start() * bound).powi(2), (DEVIATION.end() * bound).powi(2));
        for &length_scale in head.length_scale[axis].iter().take(expected.layout.dimension()) {
            within(
                axis,
                "length_scale",
                length_scale,
                (*LENGTH_SCALE.start(), *LENGTH_SCALE.end()),
            )?;
        }
        within(axis, "signal_variance", head.signal_variance[axis], (least, most))?;
        within(axis, "noise_variance", head.noise_variance[axis], (least, most))?;
        within(axis, "linear_variance", head.linear_variance[axis], (0.0, most))?;
        let place = if expected.layout.has_place() { (least, most) } else { (0.0, 0.0) };
        within(axis, "place_variance", head.place_variance[axis], place)?;
        within(axis, "sample_variance", head.sample_variance[axis], (0.0, most))?;
    }
    Ok(())
}

/// Largest difference between the received weights and those computed here, relative to the largest
/// of its axis.
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

/// The first entries of a slice. Missing entries are NaN, which every check refuses.
pub(super) fn first<const K: usize>(values: &[f64]) -> [f64; K] {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(f64::NAN))
}
