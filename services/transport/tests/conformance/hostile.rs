//! Bytes that are no message, or another message than the expected one.

use crate::fixture::{Fixture, Outcome, bytes, command, count_until, receive, snapshot};
use protocol::frame::DecodeError;
use protocol::message::{Command, Message, ModelSnapshot, Stamp};
use protocol::topic::Topic;
use protocol::{VERSION, message};
use transport::{Since, Tally};

/// A valid first message of writer 1, modified by `change`.
fn encoded<T: Message>(mut message: T, change: impl FnOnce(&mut Stamp)) -> Vec<u8> {
    *message.stamp_mut() = Stamp {
        version: VERSION,
        kind: T::KIND,
        writer: 1,
        epoch: 1,
        sequence: 1,
        ..Stamp::default()
    };
    change(message.stamp_mut());
    bytes(&message)
}

pub(crate) fn another_version_is_refused_with_both_named<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let mut raw = ports.raw_sink(Topic::Command)?;
    raw.send_raw(&encoded(command(1), |stamp| stamp.version = 77))?;
    count_until(&mut source, |source| source.tally().refused == 1)?;
    let refusal = source.last_refusal().ok_or("nothing was refused")?;
    assert_eq!(refusal, DecodeError::Version { expected: VERSION, got: 77 });
    let text = refusal.to_string();
    assert!(text.contains("77") && text.contains(&VERSION.to_string()), "{text}");
    Ok(())
}

pub(crate) fn another_kind_is_refused_with_both_named<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let state: message::PlantState = bytemuck::Zeroable::zeroed();
    let mut raw = ports.raw_sink(Topic::Command)?;
    raw.send_raw(&encoded(state, |_| {}))?;
    count_until(&mut source, |source| source.tally().refused == 1)?;
    let refusal = source.last_refusal().ok_or("nothing was refused")?;
    assert_eq!(refusal, DecodeError::Kind { message: "Command", expected: 2, got: 1 });
    Ok(())
}

pub(crate) fn damaged_truncated_and_oversize_bytes_are_refused<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let mut raw = ports.raw_sink(Topic::Command)?;
    let good = encoded(command(1), |_| {});
    let mut oversize = good.clone();
    oversize.resize(300_000, 0xA5);
    let mut damaged = good.clone();
    if let Some(byte) = damaged.last_mut() {
        *byte ^= 1;
    }
    let truncated = good.get(..good.len() - 8).unwrap_or_default();
    let garbage: Vec<u8> = (0..4096_u32).map(|index| (index * 37 % 251) as u8).collect();
    let bad: [&[u8]; 6] =
        [&[1, 2, 3], good.get(..40).unwrap_or_default(), truncated, &oversize, &damaged, &garbage];
    for (refused, bytes) in bad.iter().enumerate() {
        raw.send_raw(bytes)?;
        count_until(&mut source, |source| source.tally().refused > refused as u64)?;
        assert_eq!(source.tally(), Tally { refused: refused as u64 + 1, ..Tally::default() });
    }
    raw.send_raw(&good)?;
    assert_eq!(receive(&mut source)?.input, command(1).input, "a good one still gets through");
    Ok(())
}

pub(crate) fn a_message_sent_twice_is_received_once<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let mut raw = ports.raw_sink(Topic::Command)?;
    for sequence in [1, 2, 2, 1, 5] {
        raw.send_raw(&encoded(command(1), |stamp| stamp.sequence = sequence))?;
    }
    for sequence in [1, 2, 5] {
        assert_eq!(receive(&mut source)?.stamp.sequence, sequence);
    }
    assert_eq!(source.tally(), Tally { received: 3, lost: 2, refused: 0, stale: 2 });
    Ok(())
}

pub(crate) fn a_snapshot_that_promises_more_points_than_it_has_is_refused<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<ModelSnapshot>(Since::First)?;
    let mut raw = ports.raw_sink(Topic::Snapshot)?;
    for points in [11, 16_384, u32::MAX] {
        let mut forged = snapshot(1, 10)?;
        forged.head.points = points;
        raw.send_raw(&encoded(forged, |_| {}))?;
    }
    count_until(&mut source, |source| source.tally().refused == 3)?;
    assert_eq!(source.tally(), Tally { refused: 3, ..Tally::default() });
    Ok(())
}
