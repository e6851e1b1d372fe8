//! learner → controller: one complete learned model.

use super::define::message;
use super::field::{Allowed, Field, Shape, Wire};
use super::{Fields, Message, Stamp};
use crate::frame::DecodeError;
use crate::wire::{self, HEADER_BYTES};
use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};

/// Most inputs that a learned model can have.
pub const INPUTS_MAX: usize = 12;

/// Most data points that a snapshot can hold. Bounds what a receiver allocates for one message.
const POINTS_MAX: usize = 16_384;

/// Numbers of a data point beside its inputs: 3 targets, the noise scale, 3 weights.
const ROW_REST: usize = 7;

message! {
    /// All fields of a snapshot but its data points.
    SnapshotHead of ModelSnapshot {
        /// Counts the snapshots of one robot, from 1, across restarts of the learner.
        version: u64,
        /// Fingerprint of robot parameters, period and input layout. The residual of another main
        /// model is wrong.
        fingerprint: u64,
        /// In lock step: tick at which it takes effect. 0: as soon as it is ready.
        effective_tick: u64,
        /// Epoch of the plant that the model was last learnt from.
        plant_epoch: u64,
        /// Data points n.
        points: u32 = size(POINTS_MAX),
        /// Inputs D of the Gaussian processes.
        inputs: u32 = size(INPUTS_MAX),
        /// Samples on which the scores below are computed, all newer than the training samples.
        score_samples: u32,
        /// Always zero; not sent over the network.
        reserved: u32 = unused,
        /// Mean of each input (eq. 36), in the input's unit.
        input_mean: [f64; INPUTS_MAX] = leading(inputs),
        /// Scale of each input (eq. 36), in the input's unit.
        input_scale: [f64; INPUTS_MAX] = leading(inputs),
        /// ℓ, per velocity axis and normalised input.
        length_scale: [[f64; INPUTS_MAX]; 3] = leading(inputs),
        /// σ², per velocity axis \[(m/s)², (m/s)², (rad/s)²\].
        signal_variance: [f64; 3],
        /// λ² of the offset and of each slope over the normalised inputs, per velocity axis
        /// \[(m/s)², (m/s)², (rad/s)²\]; 0: no linear part.
        linear_variance: [f64; 3],
        /// π² of the place part over the last four inputs, per velocity axis \[(m/s)², (m/s)²,
        /// (rad/s)²\]; 0: no place part.
        place_variance: [f64; 3],
        /// σₙ², per velocity axis \[(m/s)², (m/s)², (rad/s)²\].
        noise_variance: [f64; 3],
        /// Variance of a new sample beyond that of the function, per velocity axis, from held-out
        /// errors \[(m/s)², (m/s)², (rad/s)²\].
        sample_variance: [f64; 3],
        /// Log marginal likelihood, per velocity axis.
        log_likelihood: [f64; 3],
        /// Diagonal added beyond σₙ² to make the factorisation possible, per velocity axis.
        jitter: [f64; 3],
        /// RMS one-step error with this model on the score samples \[m/s, m/s, rad/s\].
        score_learned: [f64; 3],
        /// RMS one-step error of the main model alone on the same samples \[m/s, m/s, rad/s\].
        score_main: [f64; 3],
    }
}

/// One data point of a snapshot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SnapshotRow<'a> {
    /// Normalised inputs, D of them.
    pub input: &'a [f64],
    /// Residual per velocity axis \[m/s, m/s, rad/s\].
    pub target: &'a [f64],
    /// Noise variance of this point over σₙ²: greater for old points.
    pub noise_scale: f64,
    /// α per velocity axis.
    pub weight: &'a [f64],
}

/// Data and hyperparameters of three Gaussian processes, without any factor. The receiver makes its
/// own factor, and compares its α.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelSnapshot {
    /// All fields but the data points.
    pub head: SnapshotHead,
    /// n rows of D inputs, 3 targets, the noise scale and 3 weights.
    values: Vec<f64>,
}

impl ModelSnapshot {
    /// A snapshot without data points; `head.points` is set to 0.
    pub fn new(mut head: SnapshotHead) -> Self {
        head.points = 0;
        Self { head, values: Vec::new() }
    }

    /// Appends a data point whose noise variance is σₙ². `input` must have `head.inputs` entries,
    /// normalised.
    ///
    /// # Errors
    /// [`DecodeError::Length`] if it has another length, or [`DecodeError::Value`] if the snapshot
    /// is full.
    pub fn push(
        &mut self,
        input: &[f64],
        target: [f64; 3],
        weight: [f64; 3],
    ) -> Result<(), DecodeError> {
        self.push_with_noise(input, target, weight, 1.0)
    }

    /// The same with a noise variance of σₙ² times `noise_scale`.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn push_with_noise(
        &mut self,
        input: &[f64],
        target: [f64; 3],
        weight: [f64; 3],
        noise_scale: f64,
    ) -> Result<(), DecodeError> {
        if input.len() != self.head.inputs as usize {
            return Err(DecodeError::Length {
                message: Self::NAME,
                expected: self.head.inputs as usize,
                got: input.len(),
            });
        }
        if self.head.points as usize >= POINTS_MAX {
            return Err(DecodeError::Value {
                message: Self::NAME,
                field: "points",
                value: u64::from(self.head.points) + 1,
            });
        }
        self.values.extend_from_slice(input);
        self.values.extend_from_slice(&target);
        self.values.push(noise_scale);
        self.values.extend_from_slice(&weight);
        self.head.points += 1;
        Ok(())
    }

    /// The data points, in the order in which they were learnt.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = SnapshotRow<'_>> {
        let inputs = self.head.inputs as usize;
        self.values.chunks_exact(inputs + ROW_REST).map(move |row| {
            let (input, rest) = row.split_at(inputs);
            let (target, rest) = rest.split_at(3);
            let (noise_scale, weight) = rest.split_at(1);
            SnapshotRow {
                input,
                target,
                noise_scale: noise_scale.first().copied().unwrap_or(f64::NAN),
                weight,
            }
        })
    }
}

/// Name of the data points among the numbers of a snapshot.
const POINTS: &str = "points";

/// The inputs of the data points in JSON.
const INPUTS: Field = of_points("inputs", " Normalised inputs of each data point.");

/// The targets of the data points in JSON.
const TARGETS: Field = of_points("targets", r" Residual of each data point \[m/s, m/s, rad/s\].");

const fn of_points(name: &'static str, about: &'static str) -> Field {
    Field {
        name,
        about,
        wire: Wire::Nothing,
        allowed: Allowed::Any,
        shape: Some(Shape::Rows),
        offset: size_of::<SnapshotHead>(),
    }
}

/// One part of every data point of a snapshot.
struct Points<'a> {
    snapshot: &'a ModelSnapshot,
    part: for<'r> fn(SnapshotRow<'r>) -> &'r [f64],
}

impl Serialize for Points<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.snapshot.rows().map(self.part))
    }
}

impl Message for ModelSnapshot {
    const NAME: &'static str = "ModelSnapshot";
    const ABOUT: &'static str = SnapshotHead::ABOUT;
    const KIND: u16 = 8;
    const BYTES_MAX: usize = size_of::<SnapshotHead>() + POINTS_MAX * (INPUTS_MAX + ROW_REST) * 8;

    fn fields() -> Vec<Field> {
        [SnapshotHead::FIELDS, &[INPUTS, TARGETS]].concat()
    }

    fn numbers() -> Vec<&'static str> {
        let head = SnapshotHead::FIELDS.iter().filter(|field| field.wire.is_real());
        head.map(|field| field.name).chain([POINTS]).collect()
    }

    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64])) {
        self.head.visit_numbers(visit);
        visit(POINTS, &mut self.values);
    }

    fn stamp(&self) -> &Stamp {
        &self.head.stamp
    }

    fn stamp_mut(&mut self) -> &mut Stamp {
        &mut self.head.stamp
    }

    fn byte_len(&self) -> usize {
        size_of::<SnapshotHead>() + self.values.len() * 8
    }

    fn write(&self, out: &mut [u8]) {
        let (head, values) = out.split_at_mut(size_of::<SnapshotHead>());
        head.copy_from_slice(bytemuck::bytes_of(&self.head));
        values.copy_from_slice(bytemuck::cast_slice(&self.values));
    }

    fn read(bytes: &[u8]) -> Result<Self, DecodeError> {
        let head_len = size_of::<SnapshotHead>();
        let too_short =
            || DecodeError::Length { message: Self::NAME, expected: head_len, got: bytes.len() };
        let (head, values) = bytes.split_at_checked(head_len).ok_or_else(too_short)?;
        let head: SnapshotHead = bytemuck::try_pod_read_unaligned(head).map_err(|_| too_short())?;
        let expected = head.value_bytes()?;
        if values.len() != expected {
            return Err(DecodeError::Length {
                message: Self::NAME,
                expected: head_len + expected,
                got: bytes.len(),
            });
        }
        let values = values.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
        Ok(Self { head, values })
    }

    fn show<M: SerializeMap>(&self, map: &mut M) -> Result<(), M::Error> {
        self.head.show(map)?;
        map.serialize_entry(INPUTS.name, &Points { snapshot: self, part: |row| row.input })?;
        map.serialize_entry(TARGETS.name, &Points { snapshot: self, part: |row| row.target })
    }

    fn write_wire(&self, out: &mut Vec<u8>) {
        out.reserve(size_of::<SnapshotHead>() + self.values.len() * 8);
        wire::write_postcard(&self.head, out);
        write_reals(&self.values, out);
    }

    fn read_wire(body: &[u8]) -> Result<Self, DecodeError> {
        let mut values = body;
        let head = SnapshotHead::receive(&mut values)?;
        let expected = head.value_bytes()?;
        if values.len() != expected {
            let head_bytes = HEADER_BYTES + body.len() - values.len();
            return Err(DecodeError::Length {
                message: <Self as Message>::NAME,
                expected: head_bytes + expected,
                got: head_bytes + values.len(),
            });
        }
        Ok(Self { head, values: read_reals(values) })
    }
}

impl SnapshotHead {
    /// Length of the data points, by the counts in the head \[bytes\].
    fn value_bytes(&self) -> Result<usize, DecodeError> {
        let bad = |field, value: u32| DecodeError::Value {
            message: ModelSnapshot::NAME,
            field,
            value: u64::from(value),
        };
        if !(1..=INPUTS_MAX).contains(&(self.inputs as usize)) {
            return Err(bad("inputs", self.inputs));
        }
        if self.points as usize > POINTS_MAX {
            return Err(bad("points", self.points));
        }
        Ok(self.points as usize * (self.inputs as usize + ROW_REST) * 8)
    }
}

fn write_reals(reals: &[f64], out: &mut Vec<u8>) {
    if cfg!(target_endian = "little") {
        out.extend_from_slice(bytemuck::cast_slice(reals));
    } else {
        out.extend(reals.iter().flat_map(|real| real.to_le_bytes()));
    }
}

fn read_reals(bytes: &[u8]) -> Vec<f64> {
    let mut reals = vec![0.0; bytes.len() / 8];
    if cfg!(target_endian = "little") {
        bytemuck::cast_slice_mut::<f64, u8>(&mut reals).copy_from_slice(bytes);
    } else {
        for (real, bytes) in reals.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *real = f64::from_le_bytes(*bytes);
        }
    }
    reals
}
