//! learner → controller: one complete learned model.

use super::{Message, Stamp};
use crate::frame::DecodeError;
use crate::wire::HEADER_BYTES;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Most inputs that a learned model can have.
pub const INPUTS_MAX: usize = 12;

/// Most data points that a snapshot can hold. Bounds what a receiver allocates for one message.
const POINTS_MAX: usize = 16_384;

/// Numbers of a data point beside its inputs: 3 targets, the noise scale, 3 weights.
const ROW_REST: usize = 7;

/// All fields of a snapshot but its data points.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct SnapshotHead {
    /// Writer and time; `tick` is the last one that the model has learnt from.
    pub stamp: Stamp,
    /// Counts the snapshots of one robot, from 1, across restarts of the learner.
    pub version: u64,
    /// Fingerprint of robot parameters, period and input layout. The residual of another main model
    /// is wrong.
    pub fingerprint: u64,
    /// In lock step: tick at which it takes effect. 0: as soon as it is ready.
    pub effective_tick: u64,
    /// Epoch of the plant that the model was last learnt from.
    pub plant_epoch: u64,
    /// Data points n.
    pub points: u32,
    /// Inputs D of the Gaussian processes.
    pub inputs: u32,
    /// Samples on which the scores below are computed, all newer than the training samples.
    pub score_samples: u32,
    /// Always zero; not sent over the network.
    #[serde(skip)]
    pub reserved: u32,
    /// Mean of each input (eq. 36), in the input's unit.
    pub input_mean: [f64; INPUTS_MAX],
    /// Scale of each input (eq. 36), in the input's unit.
    pub input_scale: [f64; INPUTS_MAX],
    /// ℓ, per velocity axis and normalised input.
    pub length_scale: [[f64; INPUTS_MAX]; 3],
    /// σ², per velocity axis \[(m/s)², (m/s)², (rad/s)²\].
    pub signal_variance: [f64; 3],
    /// λ² of the offset and of each slope over the normalised inputs, per velocity axis
    /// \[(m/s)², (m/s)², (rad/s)²\]; 0: no linear part.
    pub linear_variance: [f64; 3],
    /// σₙ², per velocity axis \[(m/s)², (m/s)², (rad/s)²\].
    pub noise_variance: [f64; 3],
    /// Variance of a new sample beyond that of the function, per velocity axis, from held-out
    /// errors \[(m/s)², (m/s)², (rad/s)²\].
    pub sample_variance: [f64; 3],
    /// Log marginal likelihood, per velocity axis.
    pub log_likelihood: [f64; 3],
    /// Diagonal added beyond σₙ² to make the factorisation possible, per velocity axis.
    pub jitter: [f64; 3],
    /// RMS one-step error with this model on the score samples \[m/s, m/s, rad/s\].
    pub score_learned: [f64; 3],
    /// RMS one-step error of the main model alone on the same samples \[m/s, m/s, rad/s\].
    pub score_main: [f64; 3],
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

impl Message for ModelSnapshot {
    const NAME: &'static str = "ModelSnapshot";
    const KIND: u16 = 8;
    const BYTES_MAX: usize = size_of::<SnapshotHead>() + POINTS_MAX * (INPUTS_MAX + ROW_REST) * 8;

    const NUMBERS: &'static [&'static str] = &[
        "input_mean",
        "input_scale",
        "length_scale",
        "signal_variance",
        "linear_variance",
        "noise_variance",
        "sample_variance",
        "log_likelihood",
        "jitter",
        "score_learned",
        "score_main",
        "points",
    ];

    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64])) {
        let head = &mut self.head;
        visit("input_mean", &mut head.input_mean);
        visit("input_scale", &mut head.input_scale);
        visit("length_scale", head.length_scale.as_flattened_mut());
        visit("signal_variance", &mut head.signal_variance);
        visit("linear_variance", &mut head.linear_variance);
        visit("noise_variance", &mut head.noise_variance);
        visit("sample_variance", &mut head.sample_variance);
        visit("log_likelihood", &mut head.log_likelihood);
        visit("jitter", &mut head.jitter);
        visit("score_learned", &mut head.score_learned);
        visit("score_main", &mut head.score_main);
        visit("points", &mut self.values);
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

    fn write_wire(&self, out: &mut Vec<u8>) {
        let mut head = self.head;
        out.reserve(HEAD_WIRE_BYTES + self.values.len() * 8);
        head.cross(&mut |number| match number {
            Number::Count(count) => out.extend_from_slice(&count.to_le_bytes()),
            Number::Long(long) => out.extend_from_slice(&long.to_le_bytes()),
            Number::Reals(reals) => write_reals(reals, out),
        });
        write_reals(&self.values, out);
    }

    fn read_wire(body: &[u8]) -> Result<Self, DecodeError> {
        let length = |expected| DecodeError::Length {
            message: Self::NAME,
            expected: HEADER_BYTES + expected,
            got: HEADER_BYTES + body.len(),
        };
        let (mut rest, values) =
            body.split_at_checked(HEAD_WIRE_BYTES).ok_or_else(|| length(HEAD_WIRE_BYTES))?;
        let mut head = SnapshotHead::zeroed();
        head.cross(&mut |number| match number {
            Number::Count(count) => *count = u32::from_le_bytes(taken(&mut rest)),
            Number::Long(long) => *long = u64::from_le_bytes(taken(&mut rest)),
            Number::Reals(reals) => reals.fill_with(|| f64::from_le_bytes(taken(&mut rest))),
        });
        let expected = head.value_bytes()?;
        if values.len() != expected {
            return Err(length(HEAD_WIRE_BYTES + expected));
        }
        Ok(Self { head, values: read_reals(values) })
    }
}

/// Length of the head on the network: all its numbers but version, kind and checksum of the stamp,
/// and the padding \[bytes\].
const HEAD_WIRE_BYTES: usize = size_of::<SnapshotHead>() - 8 - size_of::<u32>();

/// One piece of a head.
enum Number<'a> {
    Count(&'a mut u32),
    Long(&'a mut u64),
    Reals(&'a mut [f64]),
}

impl SnapshotHead {
    /// Shows `visit` every number that crosses the network, in its order there.
    fn cross(&mut self, visit: &mut dyn FnMut(Number<'_>)) {
        let stamp = &mut self.stamp;
        for long in [
            &mut stamp.writer,
            &mut stamp.epoch,
            &mut stamp.sequence,
            &mut stamp.tick,
            &mut stamp.sent_nanos,
        ] {
            visit(Number::Long(long));
        }
        for long in [
            &mut self.version,
            &mut self.fingerprint,
            &mut self.effective_tick,
            &mut self.plant_epoch,
        ] {
            visit(Number::Long(long));
        }
        for count in [&mut self.points, &mut self.inputs, &mut self.score_samples] {
            visit(Number::Count(count));
        }
        visit(Number::Reals(&mut self.input_mean));
        visit(Number::Reals(&mut self.input_scale));
        visit(Number::Reals(self.length_scale.as_flattened_mut()));
        let per_axis = [
            &mut self.signal_variance,
            &mut self.linear_variance,
            &mut self.noise_variance,
            &mut self.sample_variance,
            &mut self.log_likelihood,
            &mut self.jitter,
            &mut self.score_learned,
            &mut self.score_main,
        ];
        for reals in per_axis {
            visit(Number::Reals(reals));
        }
    }

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

/// The next `N` bytes of `rest`, which has enough of them.
fn taken<const N: usize>(rest: &mut &[u8]) -> [u8; N] {
    rest.split_off(..N).and_then(|bytes| bytes.try_into().ok()).unwrap_or([0; N])
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
