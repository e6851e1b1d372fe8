//! The bytes in `vectors/` are those of the network encoding: test vectors for implementations in
//! other languages.
//!
//! `cargo test --workspace --test vectors -- --ignored` writes them anew, and the seeds of the
//! fuzzer that are made of them. A difference is a change of the protocol.

use bytemuck::Zeroable;
use protocol::message::{
    Command, Credit, Exposure, FallbackLevel, GateState, HORIZON_MAX, Health, INPUTS_MAX, Message,
    ModelSnapshot, Participant, Phase, Plan, PlantState, Reason, ResidualSample, SnapshotHead,
    SolverStatus, Stamp, TAIL_MAX, Truth, WHEELS_MAX,
};
use protocol::{VERSION, frame, wire};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

type Outcome = Result<(), Box<dyn Error>>;

#[derive(Serialize, Deserialize)]
struct File<T> {
    message: String,
    kind: u16,
    version: u16,
    vectors: Vec<Vector<T>>,
}

#[derive(Serialize, Deserialize)]
struct Vector<T> {
    name: String,
    fields: T,
    bytes: String,
}

/// Inputs, targets, noise scale, weights.
type Row = (Vec<f64>, [f64; 3], f64, [f64; 3]);

/// A snapshot in its JSON form.
#[derive(Serialize, Deserialize, Clone)]
struct Snapshot {
    head: SnapshotHead,
    rows: Vec<Row>,
}

/// A message whose fields can be written in JSON.
trait Said: Message + PartialEq + std::fmt::Debug {
    type Fields: Serialize + DeserializeOwned;

    fn fields(&self) -> Self::Fields;

    fn of(fields: Self::Fields) -> Self;

    /// Examples, each with a name.
    fn examples() -> Vec<(&'static str, Self)>;
}

macro_rules! said_as_it_is {
    ($($message:ident: $examples:expr,)+) => {
        $(impl Said for $message {
            type Fields = Self;

            fn fields(&self) -> Self {
                *self
            }

            fn of(fields: Self) -> Self {
                fields
            }

            fn examples() -> Vec<(&'static str, Self)> {
                $examples
            }
        })+
    };
}

fn typical() -> Stamp {
    Stamp {
        writer: 0x1234_5678_9abc_def0,
        epoch: 3,
        sequence: 1041,
        tick: 1040,
        sent_nanos: 52_000_123_456_789,
        ..Stamp::default()
    }
}

fn extreme() -> Stamp {
    Stamp {
        writer: u64::MAX,
        epoch: u64::MAX,
        sequence: u64::MAX,
        tick: u64::MAX,
        sent_nanos: u64::MAX,
        ..Stamp::default()
    }
}

const EDGES: [f64; 3] = [f64::MAX, f64::MIN_POSITIVE, -0.0];

said_as_it_is! {
    PlantState: vec![
        ("typical", PlantState {
            stamp: typical(),
            pose: [1.25, -0.5, 3.0],
            velocity: [0.8, 0.1, -0.2],
            wheel_speed: [10.0, 11.0, 10.5, 9.75, 0.0, 0.0, 0.0, 0.0],
            current: [1.5, 1.25, 1.0, 0.75, 0.0, 0.0, 0.0, 0.0],
            input: [0.85, 0.1, -0.25],
            input_delay_s: 0.02,
            controller_epoch: 2,
            accepted_epoch: 2,
            accepted_tick: 1039,
            refused: 1,
            fallback_level: FallbackLevel::FreshPlan.code(),
            reason: Reason::None.code(),
            wheels: 4,
            wheel_speed_valid: 1,
            current_valid: 1,
            gate: GateState::Driving.code(),
            ..PlantState::zeroed()
        }),
        ("before the first command", PlantState {
            stamp: Stamp {
                writer: 7,
                epoch: 1,
                sequence: 1,
                tick: 0,
                sent_nanos: 1,
                ..Stamp::default()
            },
            fallback_level: FallbackLevel::Waiting.code(),
            reason: Reason::NoCommandYet.code(),
            wheels: 4,
            gate: GateState::Armed.code(),
            ..PlantState::zeroed()
        }),
        ("extreme", PlantState {
            stamp: extreme(),
            pose: EDGES,
            refused: u64::MAX,
            fallback_level: FallbackLevel::LatchedStop.code(),
            reason: Reason::Recovering.code(),
            wheels: WHEELS_MAX as u32,
            wheel_speed: [f64::MIN; WHEELS_MAX],
            wheel_speed_valid: 1,
            estop: 1,
            gate: GateState::Stopped.code(),
            stop: Reason::EmergencyStop.code(),
            ..PlantState::zeroed()
        }),
    ],
    Command: vec![
        ("typical", Command {
            stamp: typical(),
            plant_epoch: 1,
            model_version: 12,
            input: [0.5, -0.25, 0.125],
            tail: [[0.5, -0.25, 0.0], [0.25, 0.0, 0.0], [0.0; 3], [0.0; 3]],
            tail_len: 3,
            fallback_level: FallbackLevel::FreshPlan.code(),
            ..Command::zeroed()
        }),
        ("without a tail", Command {
            stamp: typical(),
            fallback_level: FallbackLevel::Brake.code(),
            ..Command::zeroed()
        }),
        ("extreme", Command {
            stamp: extreme(),
            plant_epoch: u64::MAX,
            model_version: u64::MAX,
            input: EDGES,
            tail: [EDGES; TAIL_MAX],
            tail_len: TAIL_MAX as u32,
            fallback_level: FallbackLevel::LatchedStop.code(),
            stop: Reason::HeadingError.code(),
            ..Command::zeroed()
        }),
    ],
    ResidualSample: vec![
        ("typical", ResidualSample {
            stamp: typical(),
            plant_epoch: 1,
            fingerprint: 0xfeed_beef,
            pose: [1.0, 2.0, 0.5],
            velocity: [0.75, 0.0, 0.25],
            input: [1.0, 0.0, 0.25],
            input_before: [0.875, 0.0, 0.5],
            residual: [-0.03125, 0.0, 0.015_625],
            usable: 1,
            reserved: 0,
        }),
        ("extreme", ResidualSample {
            stamp: extreme(),
            fingerprint: u64::MAX,
            residual: EDGES,
            ..ResidualSample::zeroed()
        }),
    ],
    Credit: vec![
        ("typical", Credit {
            stamp: typical(),
            through_tick: 1064,
            participant: Participant::Recorder.code(),
            reserved: 0,
        }),
        ("extreme", Credit {
            stamp: extreme(),
            through_tick: u64::MAX,
            participant: Participant::Gateway.code(),
            reserved: 0,
        }),
    ],
    Truth: vec![
        ("typical", Truth {
            stamp: typical(),
            pose: [1.25, -0.5, 3.0],
            velocity: [0.8, 0.1, -0.2],
            force: [4.0, 0.0, 0.5],
            wheel_command: [10.0, 11.0, 10.5, 9.75],
            wheel_peak: [10.0, 11.25, 10.5, 9.75],
            acting_epoch: 2,
            acting_writer: 0x1234_5678_9abc_def0,
            acting_tick: 1039,
            acting_age_nanos: 150_000_000,
            takeovers: 1,
            takeovers_back: 0,
            fallback_level: FallbackLevel::StoredTail.code(),
            reason: Reason::Missing.code(),
        }),
        ("extreme", Truth {
            stamp: extreme(),
            force: EDGES,
            acting_tick: u64::MAX,
            ..Truth::zeroed()
        }),
    ],
    Plan: vec![
        ("typical", {
            let mut plan = Plan {
                stamp: typical(),
                plant_epoch: 1,
                model_version: 12,
                horizon: 2,
                status: SolverStatus::Solved.code(),
                iterations: 9,
                fallback_level: FallbackLevel::FreshPlan.code(),
                learned_axes: 5,
                delay_micros: 20_000,
                tick_nanos: 1_250_000,
                linearise_nanos: 250_000,
                solve_nanos: 750_000,
                disturbance: [0.5, 0.25, 0.125],
                innovation: [0.0625, 0.0, 0.0],
                residual: [-0.03125, 0.0, 0.0],
                ..Plan::zeroed()
            };
            plan.predicted[0] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
            plan.predicted[2] = [1.5; 6];
            plan.reference[1] = [-1.0; 6];
            plan.variance[2] = [0.01; 3];
            plan.input[1] = [0.5, 0.25, 0.0];
            plan
        }),
        ("without a horizon", Plan { stamp: typical(), ..Plan::zeroed() }),
        ("extreme", Plan {
            stamp: extreme(),
            horizon: HORIZON_MAX as u32,
            iterations: u32::MAX,
            solve_nanos: u64::MAX,
            disturbance: EDGES,
            input: [EDGES; HORIZON_MAX],
            ..Plan::zeroed()
        }),
    ],
    Health: vec![
        ("typical", {
            let mut health = Health {
                stamp: typical(),
                participant: Participant::Controller.code(),
                phase: Phase::Degraded.code(),
                pid: 4711,
                exposure: Exposure::Driven.code(),
                heartbeat: 1040,
                deadlines_met: 1038,
                deadlines_missed: 2,
                model_version: 12,
                learned_axes: 5,
                models_left: 3,
                snapshots: 12,
                snapshots_refused: 1,
                sent: [0, 1040, 1040, 0, 1040, 104, 0, 0],
                received: [1041, 0, 0, 13, 0, 0, 0, 0],
                dropped: [0, 2, 0, 0, 0, 0, 0, 0],
                ..Health::zeroed()
            };
            health.set_last_error("snapshot 9 refused: α differs");
            health
        }),
        ("extreme", {
            let mut health = Health {
                stamp: extreme(),
                pid: u32::MAX,
                lost: [u64::MAX; 8],
                ..Health::zeroed()
            };
            health.set_last_error(&"x".repeat(120));
            health
        }),
    ],
}

impl Said for ModelSnapshot {
    type Fields = Snapshot;

    fn fields(&self) -> Snapshot {
        let rows = self.rows().map(|row| {
            let axes = |values: &[f64]| [values[0], values[1], values[2]];
            (row.input.to_vec(), axes(row.target), row.noise_scale, axes(row.weight))
        });
        Snapshot { head: self.head, rows: rows.collect() }
    }

    fn of(fields: Snapshot) -> Self {
        let mut snapshot = Self::new(fields.head);
        for (input, target, noise_scale, weight) in fields.rows {
            snapshot.push_with_noise(&input, target, weight, noise_scale).unwrap_or_default();
        }
        snapshot
    }

    fn examples() -> Vec<(&'static str, Self)> {
        let mut head = SnapshotHead {
            stamp: typical(),
            version: 12,
            fingerprint: 0xfeed_beef,
            effective_tick: 1060,
            plant_epoch: 1,
            inputs: 2,
            score_samples: 40,
            signal_variance: [1.0, 2.0, 3.0],
            linear_variance: [0.5, 0.25, 0.0],
            noise_variance: [0.01; 3],
            sample_variance: [0.02; 3],
            score_learned: [0.125; 3],
            score_main: [0.25; 3],
            ..SnapshotHead::zeroed()
        };
        head.input_scale = [1.0; INPUTS_MAX];
        head.length_scale[0][1] = 0.5;
        head.length_scale[2][0] = 1.5;
        let rows = vec![
            (vec![1.0, -1.0], [0.1, 0.2, 0.3], 1.0, [4.0, 5.0, 6.0]),
            (vec![0.5, 0.25], EDGES, 2.5, [7.0, 8.0, 9.0]),
        ];
        let empty = Snapshot {
            head: SnapshotHead {
                stamp: extreme(),
                inputs: INPUTS_MAX as u32,
                ..SnapshotHead::zeroed()
            },
            rows: Vec::new(),
        };
        vec![("typical", Self::of(Snapshot { head, rows })), ("without points", Self::of(empty))]
    }
}

fn path<T: Message>() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("vectors").join(format!("{}.json", T::NAME))
}

/// The message as a sink leaves it, and its bytes in hexadecimal.
fn encoded<T: Said>(mut message: T) -> (T, String) {
    (message.stamp_mut().version, message.stamp_mut().kind) = (VERSION, T::KIND);
    let mut bytes = Vec::new();
    message.stamp_mut().checksum = wire::encode(&message, &mut bytes);
    let mut hex = String::new();
    for byte in bytes {
        // Writing to a string does not fail.
        let _ = write!(hex, "{byte:02x}");
    }
    (message, hex)
}

fn bytes_of(hex: &str) -> Result<Vec<u8>, Box<dyn Error>> {
    let pairs = hex
        .as_bytes()
        .chunks(2)
        .map(|pair| Ok(u8::from_str_radix(std::str::from_utf8(pair)?, 16)?));
    pairs.collect()
}

fn holds<T: Said>() -> Outcome {
    let file: File<T::Fields> = serde_json::from_str(&fs::read_to_string(path::<T>())?)?;
    assert_eq!((file.message.as_str(), file.kind, file.version), (T::NAME, T::KIND, VERSION));
    assert_eq!(file.vectors.len(), T::examples().len());
    for vector in file.vectors {
        let (message, bytes) = encoded(T::of(vector.fields));
        assert_eq!(bytes, vector.bytes, "{} {}", T::NAME, vector.name);
        assert_eq!(
            wire::decode::<T>(&bytes_of(&vector.bytes)?)?,
            message,
            "{} {}",
            T::NAME,
            vector.name
        );
    }
    Ok(())
}

fn written<T: Said>() -> Outcome {
    let vector = |(name, message): (&str, T)| {
        let (message, bytes) = encoded(message);
        Vector { name: name.to_owned(), fields: message.fields(), bytes }
    };
    let vectors: Vec<Vector<T::Fields>> = T::examples().into_iter().map(vector).collect();
    for (vector, (_, message)) in vectors.iter().zip(T::examples()) {
        seeds(&vector.name, &encoded(message).0, &bytes_of(&vector.bytes)?)?;
    }
    let file = File { message: T::NAME.to_owned(), kind: T::KIND, version: VERSION, vectors };
    fs::write(path::<T>(), serde_json::to_string_pretty(&file)? + "\n")?;
    Ok(())
}

/// Writes the seeds of the fuzzer that are made of this vector, where there are such seeds.
fn seeds<T: Message>(name: &str, message: &T, wire: &[u8]) -> Outcome {
    let mut framed = vec![0; message.byte_len()];
    frame::encode(message, &mut framed);
    let corpus = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz/corpus");
    for (decoder, bytes) in [("frame", framed.as_slice()), ("wire", wire)] {
        let seed = corpus.join(decoder).join(format!("{}-{name}", T::NAME.to_lowercase()));
        if seed.exists() {
            fs::write(seed, bytes)?;
        }
    }
    Ok(())
}

macro_rules! for_every_message {
    ($act:ident) => {
        $act::<PlantState>()?;
        $act::<Command>()?;
        $act::<ResidualSample>()?;
        $act::<Credit>()?;
        $act::<Truth>()?;
        $act::<Plan>()?;
        $act::<Health>()?;
        $act::<ModelSnapshot>()?;
    };
}

#[test]
fn every_message_has_the_bytes_that_are_written_down() -> Outcome {
    for_every_message!(holds);
    Ok(())
}

#[test]
#[ignore = "writes the vectors, see above"]
fn write_vectors() -> Outcome {
    for_every_message!(written);
    Ok(())
}

#[test]
fn the_wire_document_is_of_this_version() {
    let (page, version) = (include_str!("../WIRE.md"), VERSION);
    for said in [format!("u16: {version}."), format!("It describes protocol version {version}.")] {
        assert!(page.contains(&said), "{said}");
    }
}
