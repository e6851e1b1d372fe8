//! For any bytes, decoding either gives the message that was sent or returns the reason.

use bytemuck::Zeroable;
use proptest::collection::vec;
use proptest::prelude::{any, prop_assert, prop_assert_eq, prop_oneof, proptest};
use proptest::strategy::{Just, Strategy};
use protocol::frame::{self, DecodeError};
use protocol::message::{
    Command, Credit, ERROR_TEXT_MAX, Exposure, FallbackLevel, GateState, Goal, GoalKind, GoalPhase,
    HORIZON_MAX, Health, INPUTS_MAX, Message, ModelSnapshot, OBSTACLES_MAX, ObstacleSource,
    Obstacles, Participant, Phase, Plan, PlantState, Reason, ResidualSample, SnapshotHead,
    SolverStatus, Stamp, TAIL_MAX, Truth, WHEELS_MAX,
};
use protocol::{VERSION, message};

/// Bytes of a whole message of type `T`, stamped and sealed.
fn sealed<T: Message>(mut message: T) -> (T, Vec<u8>) {
    message.stamp_mut().version = VERSION;
    message.stamp_mut().kind = T::KIND;
    let mut bytes = vec![0; message.byte_len()];
    frame::encode(&message, &mut bytes);
    if let Ok(stamp) = frame::peek(&bytes) {
        *message.stamp_mut() = stamp;
    }
    (message, bytes)
}

/// The message `T` decoded from `bytes`, encoded again: as bytes, NaN is equal to itself.
fn reread<T: Message>(bytes: &[u8]) -> Result<Vec<u8>, DecodeError> {
    let message = frame::decode::<T>(bytes)?;
    let mut again = vec![0; message.byte_len()];
    frame::encode(&message, &mut again);
    Ok(again)
}

/// Decodes `bytes` as each kind of message.
fn as_every_message(bytes: &[u8]) -> [Result<Vec<u8>, DecodeError>; 10] {
    [
        reread::<PlantState>(bytes),
        reread::<Command>(bytes),
        reread::<ResidualSample>(bytes),
        reread::<Credit>(bytes),
        reread::<Truth>(bytes),
        reread::<Plan>(bytes),
        reread::<Health>(bytes),
        reread::<ModelSnapshot>(bytes),
        reread::<Goal>(bytes),
        reread::<Obstacles>(bytes),
    ]
}

/// A fixed message from arbitrary bytes, made valid by `repair`.
fn fixed<T: message::Fixed>(repair: impl Fn(&mut T, u32)) -> impl Strategy<Value = Vec<u8>> {
    (vec(any::<u8>(), size_of::<T>()), any::<u32>()).prop_map(move |(bytes, choice)| {
        let mut message: T = bytemuck::pod_read_unaligned(&bytes);
        repair(&mut message, choice);
        sealed(message).1
    })
}

fn pick<T: Copy>(all: &[T], choice: u32) -> T {
    all[choice as usize % all.len()]
}

fn snapshots() -> impl Strategy<Value = Vec<u8>> {
    (1..=INPUTS_MAX, 0..40_usize, any::<f64>()).prop_map(|(inputs, points, value)| {
        let mut snapshot =
            ModelSnapshot::new(SnapshotHead { inputs: inputs as u32, ..SnapshotHead::zeroed() });
        for _ in 0..points {
            snapshot.push(&vec![value; inputs], [value; 3], [1.0, value, 3.0]).unwrap_or_default();
        }
        sealed(snapshot).1
    })
}

/// The bytes of any valid message.
fn messages() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        fixed::<PlantState>(|state, choice| {
            state.fallback_level = pick(FallbackLevel::ALL, choice).code();
            state.reason = pick(Reason::ALL, choice).code();
            state.wheels = choice % (WHEELS_MAX as u32 + 1);
            state.gate = pick(GateState::ALL, choice).code();
            state.stop = pick(Reason::ALL, choice).code();
            (state.wheel_speed_valid, state.current_valid) = (choice % 2, choice / 2 % 2);
            state.estop = choice / 4 % 2;
        }),
        fixed::<Command>(|command, choice| {
            command.tail_len = choice % (TAIL_MAX as u32 + 1);
            command.fallback_level = pick(FallbackLevel::ALL, choice).code();
            command.stop = pick(Reason::STOP_REQUESTS, choice);
            command.reserved = 0;
        }),
        fixed::<ResidualSample>(|sample, choice| sample.usable = choice % 2),
        fixed::<Credit>(|credit, choice| {
            credit.participant = pick(Participant::ALL, choice).code();
        }),
        fixed::<Goal>(|goal, choice| {
            goal.kind = pick(GoalKind::ALL, choice).code();
            goal.phase = pick(GoalPhase::ALL, choice).code();
        }),
        fixed::<Obstacles>(|list, choice| {
            list.source = pick(ObstacleSource::ALL, choice).code();
            list.count = choice % (OBSTACLES_MAX as u32 + 1);
        }),
        fixed::<Truth>(|truth, choice| {
            truth.fallback_level = pick(FallbackLevel::ALL, choice).code();
            truth.reason = pick(Reason::ALL, choice).code();
            truth.wheels = choice % (WHEELS_MAX as u32 + 1);
        }),
        fixed::<Plan>(|plan, choice| {
            plan.horizon = choice % (HORIZON_MAX as u32 + 1);
            plan.status = pick(SolverStatus::ALL, choice).code();
            plan.fallback_level = pick(FallbackLevel::ALL, choice).code();
            plan.learned_axes = choice % 8;
        }),
        fixed::<Health>(|health, choice| {
            health.participant = pick(Participant::ALL, choice).code();
            health.phase = pick(Phase::ALL, choice).code();
            health.exposure = pick(Exposure::ALL, choice).code();
            health.error_len = choice % (ERROR_TEXT_MAX as u32 + 1);
        }),
        snapshots(),
    ]
}

/// Bytes behind a valid stamp, so that they reach the message's own checks.
fn lies() -> impl Strategy<Value = Vec<u8>> {
    let kind = prop_oneof![1_u16..=8, Just(99)];
    (kind, vec(any::<u8>(), 0..1200)).prop_map(|(kind, body)| {
        let mut bytes =
            bytemuck::bytes_of(&Stamp { version: VERSION, kind, ..Stamp::default() }).to_vec();
        bytes.extend(body);
        let checksum = crc32c::crc32c(&bytes[4..]);
        bytes[..4].copy_from_slice(&checksum.to_ne_bytes());
        bytes
    })
}

proptest! {
    #[test]
    fn every_message_comes_back_as_it_was(bytes in messages()) {
        let read: Vec<_> = as_every_message(&bytes).into_iter().flatten().collect();
        prop_assert_eq!(read, [bytes]);
    }

    #[test]
    fn random_bytes_are_no_message(bytes in vec(any::<u8>(), 0..2000)) {
        prop_assert!(as_every_message(&bytes).iter().all(Result::is_err));
    }

    #[test]
    fn bytes_with_a_valid_checksum_are_a_message_or_refused(bytes in lies()) {
        for read in as_every_message(&bytes).into_iter().flatten() {
            prop_assert_eq!(&read, &bytes);
        }
    }

    #[test]
    fn a_flipped_bit_is_noticed(
        bytes in messages(),
        place in any::<proptest::sample::Index>(),
        bit in 0..8_u32,
    ) {
        let mut bytes = bytes;
        let place = place.index(bytes.len());
        bytes[place] ^= 1 << bit;
        prop_assert!(as_every_message(&bytes).iter().all(Result::is_err));
    }

    #[test]
    fn a_message_cut_short_or_drawn_out_is_noticed(
        bytes in messages(),
        length in any::<proptest::sample::Index>(),
        more in 1..64_usize,
    ) {
        let cut = bytes.get(..length.index(bytes.len())).unwrap_or_default();
        prop_assert!(as_every_message(cut).iter().all(Result::is_err));
        let mut drawn_out = bytes;
        drawn_out.resize(drawn_out.len() + more, 0);
        prop_assert!(as_every_message(&drawn_out).iter().all(Result::is_err));
    }
}
