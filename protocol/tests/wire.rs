//! For any bytes from the network, decoding either gives the message that was sent or returns the
//! reason.

use bytemuck::Zeroable;
use proptest::collection::vec;
use proptest::prelude::{any, prop_assert, prop_assert_eq, prop_oneof, proptest};
use proptest::strategy::{Just, Strategy};
use protocol::frame::DecodeError;
use protocol::message::{
    Command, Credit, ERROR_TEXT_MAX, Exposure, FallbackLevel, GateState, Goal, GoalKind, GoalPhase,
    HORIZON_MAX, Health, INPUTS_MAX, Message, ModelSnapshot, OBSTACLES_MAX, ObstacleSource,
    Obstacles, Participant, Phase, Plan, PlantState, Reason, ResidualSample, SnapshotHead,
    SolverStatus, TAIL_MAX, Truth, WHEELS_MAX,
};
use protocol::{VERSION, message, wire};

/// Bytes of a whole message of type `T`.
fn encoded<T: Message>(mut message: T) -> Vec<u8> {
    (message.stamp_mut().version, message.stamp_mut().kind) = (VERSION, T::KIND);
    let mut bytes = Vec::new();
    wire::encode(&message, &mut bytes);
    bytes
}

/// The message `T` decoded from `bytes`, encoded again: as bytes, NaN is equal to itself.
fn reread<T: Message>(bytes: &[u8]) -> Result<Vec<u8>, DecodeError> {
    Ok(encoded(wire::decode::<T>(bytes)?))
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
        encoded(message)
    })
}

fn pick<T: Copy>(all: &[T], choice: u32) -> T {
    all[choice as usize % all.len()]
}

fn snapshots() -> impl Strategy<Value = Vec<u8>> {
    (1..=INPUTS_MAX, 0..40_usize, any::<u64>()).prop_map(|(inputs, points, bits)| {
        let value = f64::from_bits(bits);
        let mut snapshot = ModelSnapshot::new(SnapshotHead {
            inputs: inputs as u32,
            jitter: [value; 3],
            ..SnapshotHead::zeroed()
        });
        for _ in 0..points {
            snapshot.push(&vec![value; inputs], [value; 3], [1.0, value, 3.0]).unwrap_or_default();
        }
        encoded(snapshot)
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
            (truth.wheels, truth.reserved) = (choice % (WHEELS_MAX as u32 + 1), 0);
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
            health.set_last_error(&"ä".repeat(choice as usize % ERROR_TEXT_MAX));
        }),
        snapshots(),
    ]
}

/// A body behind a valid header, so that it reaches the message's own checks.
fn sealed(kind: u16, body: &[u8]) -> Vec<u8> {
    let mut bytes = VERSION.to_le_bytes().to_vec();
    bytes.extend(kind.to_le_bytes());
    bytes.extend(crc32c::crc32c(body).to_le_bytes());
    bytes.extend(body);
    bytes
}

fn lies() -> impl Strategy<Value = Vec<u8>> {
    let kind = prop_oneof![1_u16..=8, Just(99)];
    let body = prop_oneof![
        vec(any::<u8>(), 0..1200),
        vec(prop_oneof![Just(0_u8), Just(1), Just(255)], 0..1200)
    ];
    (kind, body).prop_map(|(kind, body)| sealed(kind, &body))
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
            // A number may be encoded with more bytes than it needs.
            prop_assert!(read.len() <= bytes.len());
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
        let kind = u16::from_le_bytes([bytes[2], bytes[3]]);
        let body = &bytes[wire::HEADER_BYTES..];
        let cut = &body[..length.index(body.len())];
        prop_assert!(
            as_every_message(&bytes[..wire::HEADER_BYTES + cut.len()]).iter().all(Result::is_err)
        );
        prop_assert!(
            as_every_message(&sealed(kind, cut)).iter().all(Result::is_err),
            "with a checksum to match"
        );
        let mut drawn_out = body.to_vec();
        drawn_out.resize(body.len() + more, 0);
        prop_assert!(
            as_every_message(&sealed(kind, &drawn_out)).iter().all(Result::is_err),
            "with a checksum to match"
        );
    }
}

#[test]
fn another_version_and_another_kind_are_refused_with_both_named() {
    let mut bytes = encoded(Credit::zeroed());
    assert_eq!(
        wire::decode::<Command>(&bytes),
        Err(DecodeError::Kind { message: "Command", expected: 2, got: 4 })
    );
    bytes[0] = 77;
    assert_eq!(
        wire::decode::<Credit>(&bytes),
        Err(DecodeError::Version { expected: VERSION, got: 77 })
    );
}

#[test]
fn every_bit_of_a_number_survives() -> Result<(), DecodeError> {
    let quiet_nan_with_payload = f64::from_bits(0x7ff8_0000_dead_beef);
    let signalling_nan = f64::from_bits(0xfff0_0000_0000_0001);
    let sent =
        Command { input: [quiet_nan_with_payload, signalling_nan, -0.0], ..Command::zeroed() };
    let received: Command = wire::decode(&encoded(sent))?;
    assert_eq!(received.input.map(f64::to_bits), sent.input.map(f64::to_bits));
    Ok(())
}

#[test]
fn unused_parts_of_a_message_are_not_sent() {
    let short = encoded(Plan { horizon: 1, ..Plan::zeroed() });
    let long = encoded(Plan { horizon: 40, ..Plan::zeroed() });
    assert_eq!(long.len() - short.len(), 39 * (6 + 6 + 3 + 3) * 8);
}

#[test]
fn encoding_into_a_warm_buffer_does_not_move_it() {
    let mut bytes = Vec::new();
    let command = Command { tail_len: 4, ..Command::zeroed() };
    wire::encode(&command, &mut bytes);
    let (place, capacity) = (bytes.as_ptr(), bytes.capacity());
    wire::encode(&command, &mut bytes);
    assert_eq!((bytes.as_ptr(), bytes.capacity()), (place, capacity));
}
