//! Messages in memory and on the network, and the snapshot with which a learner begins.
//!
//! Bytes are decoded as received. Then they are decoded once more with valid version, kind and
//! checksum, so that they reach the message's own checks.

use super::{Fate, Verdict, as_file, either, promise, refused};
use controller::adopt::{self, Expected};
use learner::fit::FitSettings;
use learner::settings::KernelChoice;
use learner::store;
use model::gp::dictionary::{Dictionary, Observation, Selection};
use model::gp::hyperparameters::Hyperparameters;
use model::learned::{
    INPUTS, INPUTS_WITH_HEADING, INPUTS_WITH_HISTORY, INPUTS_WITH_PLACE, Layout, Moment,
};
use protocol::VERSION;
use protocol::frame::{self, DecodeError};
use protocol::message::{
    Command, Credit, Goal, Health, Message, ModelSnapshot, Obstacles, Plan, PlantState,
    ResidualSample, SnapshotHead, Truth,
};
use protocol::view::View;
use protocol::wire::{self, HEADER_BYTES};
use std::path::Path;

/// Largest number of points in a tested snapshot: all work on it grows with their square or cube.
const POINTS_MAX: usize = 40;
/// Largest residual that is trusted, on every axis.
const BOUND: f64 = 0.5;
/// Length of the checksum, with which a message in memory begins \[bytes\].
const CHECKSUM_BYTES: usize = 4;

/// A message in memory is refused, or encodes to the same bytes again.
pub(super) fn frame(bytes: &[u8]) -> Verdict {
    Ok(either(framed(bytes)?, framed(&sealed(bytes, kind(bytes.get(6))))?))
}

fn framed(bytes: &[u8]) -> Verdict {
    let fates = [
        shown(frame::decode::<PlantState>(bytes), bytes)?,
        shown(frame::decode::<Command>(bytes), bytes)?,
        shown(frame::decode::<ResidualSample>(bytes), bytes)?,
        shown(frame::decode::<Truth>(bytes), bytes)?,
        shown(frame::decode::<Plan>(bytes), bytes)?,
        shown(frame::decode::<Health>(bytes), bytes)?,
        shown(frame::decode::<ModelSnapshot>(bytes), bytes)?,
        shown(frame::decode::<Credit>(bytes), bytes)?,
        shown(frame::decode::<Goal>(bytes), bytes)?,
        shown(frame::decode::<Obstacles>(bytes), bytes)?,
    ];
    Ok(fates.into_iter().fold(Fate::Refused, either))
}

/// A decoded message can be shown, and encodes to `bytes` again.
fn shown<T: Message>(read: Result<T, DecodeError>, bytes: &[u8]) -> Verdict {
    if let Ok(message) = &read {
        let json = serde_json::to_string(&View(message))
            .map_err(|error| format!("a {} cannot be shown: {error}", T::NAME))?;
        let object: Result<serde_json::Map<String, serde_json::Value>, _> =
            serde_json::from_str(&json);
        object.map_err(|error| format!("the view of a {} is no JSON object: {error}", T::NAME))?;
    }
    written(read, bytes)
}

fn written<T: Message>(read: Result<T, DecodeError>, bytes: &[u8]) -> Verdict {
    let message = match read {
        Ok(message) => message,
        Err(error) => return refused(&error.to_string()),
    };
    let mut again = vec![0; message.byte_len()];
    frame::encode(&message, &mut again);
    promise(again == bytes, || {
        format!("a {} does not say the bytes again that it was read from", T::NAME)
    })?;
    Ok(Fate::Used)
}

/// A valid kind, chosen by some byte.
fn kind(byte: Option<&u8>) -> u16 {
    1 + u16::from(byte.copied().unwrap_or(0)) % 8
}

/// The same bytes with version, kind and checksum of a message in memory.
fn sealed(bytes: &[u8], kind: u16) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if let Some(place) = bytes.get_mut(CHECKSUM_BYTES..CHECKSUM_BYTES + 4) {
        let [v0, v1] = VERSION.to_ne_bytes();
        let [k0, k1] = kind.to_ne_bytes();
        place.copy_from_slice(&[v0, v1, k0, k1]);
    }
    if let Some((checksum, rest)) = bytes.split_at_mut_checked(CHECKSUM_BYTES) {
        checksum.copy_from_slice(&crc32c::crc32c(rest).to_ne_bytes());
    }
    bytes
}

/// A message on the network is refused, or encodes to bytes with the same meaning. These are not
/// longer, and encode to themselves.
pub(super) fn wire(bytes: &[u8]) -> Verdict {
    let as_it_came = wired(bytes)?;
    let body = bytes.get(HEADER_BYTES..).unwrap_or_default();
    let mut sealed = VERSION.to_le_bytes().to_vec();
    sealed.extend(kind(bytes.get(2)).to_le_bytes());
    sealed.extend(crc32c::crc32c(body).to_le_bytes());
    sealed.extend(body);
    Ok(either(as_it_came, wired(&sealed)?))
}

fn wired(bytes: &[u8]) -> Verdict {
    let fates = [
        settled::<PlantState>(bytes)?,
        settled::<Command>(bytes)?,
        settled::<ResidualSample>(bytes)?,
        settled::<Credit>(bytes)?,
        settled::<Truth>(bytes)?,
        settled::<Plan>(bytes)?,
        settled::<Health>(bytes)?,
        settled::<ModelSnapshot>(bytes)?,
        settled::<Goal>(bytes)?,
        settled::<Obstacles>(bytes)?,
    ];
    Ok(fates.into_iter().fold(Fate::Refused, either))
}

fn settled<T: Message>(bytes: &[u8]) -> Verdict {
    let message = match wire::decode::<T>(bytes) {
        Ok(message) => message,
        Err(error) => return refused(&error.to_string()),
    };
    let mut once = Vec::new();
    wire::encode(&message, &mut once);
    promise(once.len() <= bytes.len(), || {
        format!("a {} of {} bytes was read from {}", T::NAME, once.len(), bytes.len())
    })?;
    let read: T = wire::decode(&once)
        .map_err(|error| format!("a {} that was written is refused: {error}", T::NAME))?;
    let mut twice = Vec::new();
    wire::encode(&read, &mut twice);
    promise(once == twice, || format!("a {} that was written is read as another", T::NAME))?;
    Ok(Fate::Used)
}

/// A snapshot on disk is refused with the name of its file, or a learner can begin with it and a
/// controller can use it.
pub(super) fn snapshot_file(bytes: &[u8]) -> Verdict {
    let as_it_came = as_file(bytes, |file| resumed(bytes, file))?;
    let sealed = sealed(bytes, ModelSnapshot::KIND);
    Ok(either(as_it_came, as_file(&sealed, |file| resumed(&sealed, file))?))
}

fn resumed(bytes: &[u8], file: &Path) -> Verdict {
    let fingerprint =
        frame::decode::<ModelSnapshot>(bytes).map_or(0, |snapshot| snapshot.head.fingerprint);
    let snapshot = match store::load(file, fingerprint) {
        Ok(snapshot) => snapshot,
        Err(error) => {
            let text = error.to_string();
            promise(text.starts_with(&file.display().to_string()), || {
                format!("which file was meant? {text}")
            })?;
            return refused(&text);
        }
    };
    promise(store::load(file, !fingerprint).is_err(), || {
        "a snapshot for another robot is taken".into()
    })?;
    if snapshot.rows().len() > POINTS_MAX {
        return Ok(Fate::Refused);
    }
    begun_with::<INPUTS>(&snapshot)?;
    begun_with::<INPUTS_WITH_HEADING>(&snapshot)?;
    begun_with::<INPUTS_WITH_HISTORY>(&snapshot)?;
    begun_with::<INPUTS_WITH_PLACE>(&snapshot)?;
    adopted(&snapshot)
}

/// Result in a learner.
fn begun_with<const D: usize>(snapshot: &ModelSnapshot) -> Result<(), String> {
    let layout = layout_of(D);
    let kernel = KernelChoice::LinearPlusSquaredExponential;
    let scale = |i: usize| {
        snapshot.head.input_scale.get(i).copied().filter(|scale| scale.is_finite() && *scale > 0.0)
    };
    let input_scale = std::array::from_fn(|i| scale(i).unwrap_or(1.0));
    let fit_settings =
        FitSettings::<D> { layout, kernel, input_scale, bound: [BOUND; 3], evaluations_max: 2 };
    let mut dictionary = Dictionary::new(Selection {
        capacity: POINTS_MAX / 2,
        normalisation: fit_settings.normalisation(),
        kernel: Hyperparameters::new([1.0; D], 1.0, 0.01).with_linear(1.0),
        memory_samples: 100.0,
        noise_floor: [0.01; 3],
    });
    for hyperparameters in store::resume(snapshot, &fit_settings, &mut dictionary) {
        hyperparameters.check().map_err(|error| {
            format!("a learner would begin with impossible hyperparameters: {error}")
        })?;
    }
    dictionary.insert(Observation { input: [0.1; D], target: [0.01; 3] });
    let finite = |observation: &Observation<D>| {
        observation.input.iter().chain(&observation.target).all(|value| value.is_finite())
    };
    promise(dictionary.observations().all(|(observation, _)| finite(observation)), || {
        "what is no number was learnt".into()
    })
}

/// A layout with `inputs` inputs, if there is one.
fn layout_of(inputs: usize) -> Layout {
    match inputs {
        INPUTS_WITH_HEADING => Layout::VelocitySlipHeading,
        INPUTS_WITH_HISTORY => Layout::VelocitySlipHistory,
        INPUTS_WITH_PLACE => Layout::VelocitySlipPlace,
        _ => Layout::VelocitySlip,
    }
}

/// Result in a controller.
fn adopted(snapshot: &ModelSnapshot) -> Verdict {
    let SnapshotHead { fingerprint, inputs, .. } = snapshot.head;
    let layout = layout_of(inputs as usize);
    let mut candidate =
        match adopt::prepare(snapshot, &Expected { fingerprint, layout, bound: [BOUND; 3] }) {
            Ok(candidate) => candidate,
            Err(refusal) => return refused(&refusal.to_string()),
        };
    let (velocity, input, before) = ([1.0, 0.1, -0.2], [1.1, 0.0, 0.0], [0.9, 0.0, 0.1]);
    let moment = Moment { velocity, input, before, heading: 0.7, position: [2.0, -1.0] };
    let mean = candidate.learned.response(&moment).mean;
    candidate.learned.sample_variance(&moment, &mut candidate.scratch);
    // For numbers near the largest ones the mean may be NaN, which the controller checks in every
    // period.
    promise(mean.iter().all(|mean| mean.is_nan() || mean.abs() <= BOUND), || {
        format!("a model in use foretells {mean:?}")
    })?;
    Ok(Fate::Used)
}
