//! Messages with contents that no default value has.

use bytemuck::Zeroable;
use protocol::frame;
use protocol::message::{
    Command, Credit, Health, Message, ModelSnapshot, Participant, Plan, PlantState, ResidualSample,
    SnapshotHead, Truth,
};

/// A NaN whose bits are not those of the usual one, a negative zero, and a number without a short
/// decimal form.
const ODD: [f64; 3] = [f64::from_bits(0x7ff8_0000_0000_1234), -0.0, 0.1 + 0.2];

pub(crate) fn state(tick: u64) -> PlantState {
    let mut state = PlantState { velocity: ODD, ..PlantState::zeroed() };
    state.stamp.tick = tick;
    state
}

pub(crate) fn command(tick: u64) -> Command {
    let mut command = Command { input: ODD, ..Command::zeroed() };
    command.stamp.tick = tick;
    command
}

pub(crate) fn residual() -> ResidualSample {
    ResidualSample { residual: ODD, ..ResidualSample::zeroed() }
}

pub(crate) fn plan() -> Plan {
    Plan { disturbance: ODD, ..Plan::zeroed() }
}

pub(crate) fn truth() -> Truth {
    Truth { force: ODD, ..Truth::zeroed() }
}

pub(crate) fn credit() -> Credit {
    let participant = Participant::Recorder.code();
    Credit { through_tick: u64::MAX, participant, ..Credit::zeroed() }
}

/// A heartbeat of `participant`.
pub(crate) fn health(participant: Participant) -> Health {
    Health { participant: participant.code(), stalled_nanos: u64::MAX, ..Health::zeroed() }
}

/// A snapshot with `points` data points of 6 inputs, 104 bytes each.
pub(crate) fn snapshot(version: u64, points: u32) -> ModelSnapshot {
    let mut snapshot =
        ModelSnapshot::new(SnapshotHead { version, inputs: 6, ..SnapshotHead::zeroed() });
    for point in 0..points {
        // It has room for more points than any test has.
        let _ = snapshot.push(&[f64::from(point); 6], ODD, [1.0, 2.0, f64::from(point)]);
    }
    snapshot
}

/// All bits of a message, those of its stamp included.
pub(crate) fn bits<T: Message>(message: &T) -> Vec<u8> {
    let mut bytes = vec![0; message.byte_len()];
    frame::encode(message, &mut bytes);
    bytes
}
