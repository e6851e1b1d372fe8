//! Sent messages arrive whole and in order, and lost messages are counted.

use crate::fixture::{
    BRIEF, Failure, Fence, Fixture, LONG, Outcome, PATIENCE, command, count_until, credit, receive,
    receive_until, snapshot,
};
use bytemuck::Zeroable;
use protocol::message::{
    Command, Credit, FallbackLevel, Health, Message, ModelSnapshot, Plan, PlantState,
    ResidualSample, Truth,
};
use protocol::topic::{OnTopic, Topic};
use std::thread;
use transport::{Ports, SendError, Since, Tally};

pub(crate) fn messages_arrive_in_order<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(3)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let mut sink = ports.sink::<Command>()?;
    for tick in 1..=100 {
        sink.send(&mut command(tick))?;
    }
    for tick in 1..=100 {
        let received = receive(&mut source)?;
        assert_eq!(
            (received.stamp.tick, received.stamp.sequence, received.stamp.epoch),
            (tick, tick, 3)
        );
    }
    assert_eq!(source.next()?, None);
    assert_eq!(source.tally(), Tally { received: 100, ..Tally::default() });
    assert_eq!(sink.sent(), 100);
    Ok(())
}

pub(crate) fn every_kind_of_message_crosses_whole<F: Fixture>() -> Outcome {
    fn crosses<T: OnTopic + PartialEq>(ports: &Ports, mut message: T) -> Outcome {
        let mut source = ports.source::<T>(Since::First)?;
        let mut sink = ports.sink::<T>()?;
        sink.send(&mut message)?;
        assert!(receive(&mut source)? == message, "{} has changed on its way", T::NAME);
        Ok(())
    }
    let graph = F::new(true)?;
    let ports = graph.ports(1)?;
    crosses(
        &ports,
        PlantState {
            pose: [1.0, f64::MIN_POSITIVE, -3.0],
            fallback_level: FallbackLevel::Brake.code(),
            ..PlantState::zeroed()
        },
    )?;
    crosses(&ports, command(7))?;
    crosses(
        &ports,
        ResidualSample { residual: [0.1, 0.2, 0.3], usable: 1, ..ResidualSample::zeroed() },
    )?;
    crosses(&ports, snapshot(5, 40)?)?;
    crosses(&ports, Plan { horizon: 40, predicted: [[2.5; 6]; 41], ..Plan::zeroed() })?;
    crosses(&ports, Truth { wheel_command: [1.0; 8], ..Truth::zeroed() })?;
    crosses(&ports, credit(9))?;
    let mut health = Health::zeroed();
    health.set_last_error("out of ideas");
    crosses(&ports, health)
}

pub(crate) fn of_too_many_messages_the_newest_win_and_the_rest_are_counted<F: Fixture>() -> Outcome
{
    let graph = F::new(false)?;
    let (here, there) = (graph.ports(1)?, graph.ports(1)?);
    let mut source = here.source::<Credit>(Since::First)?;
    let mut sink = there.sink::<Credit>()?;
    let mut fence = Fence::between(&there, &here)?;
    assert_eq!(source.next()?, None);
    let depth = Topic::Credit.quality(false).depth as u64;
    for tick in 1..=depth + 17 {
        sink.send(&mut credit(tick))?;
    }
    fence.pass(sink)?;
    for tick in 18..=depth + 17 {
        assert_eq!(source.next()?.map(|credit| credit.through_tick), Some(tick));
    }
    assert_eq!(source.next()?, None);
    assert_eq!(source.tally(), Tally { received: depth, lost: 17, ..Tally::default() });
    Ok(())
}

pub(crate) fn the_latest_message_passes_over_the_older_ones<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let (here, there) = (graph.ports(1)?, graph.ports(1)?);
    let mut source = here.source::<Command>(Since::First)?;
    let mut sink = there.sink::<Command>()?;
    let mut fence = Fence::between(&there, &here)?;
    assert_eq!(source.latest()?, None);
    for tick in 1..=9 {
        sink.send(&mut command(tick))?;
    }
    fence.pass(sink)?;
    assert_eq!(source.latest()?.map(|command| command.stamp.tick), Some(9));
    assert_eq!(source.latest()?, None);
    assert_eq!(source.tally(), Tally { received: 9, ..Tally::default() });
    Ok(())
}

pub(crate) fn the_latest_message_is_of_the_greatest_epoch<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let here = graph.ports(1)?;
    let mut source = here.source::<Command>(Since::First)?;
    let (new, old) = (graph.ports(2)?, graph.ports(1)?);
    let (mut successor, mut hung) = (new.sink::<Command>()?, old.sink::<Command>()?);
    let (mut after_successor, mut after_hung) =
        (Fence::between(&new, &here)?, Fence::between(&old, &here)?);
    assert_eq!(source.next()?, None);
    successor.send(&mut command(50))?;
    hung.send(&mut command(40))?;
    after_successor.pass(successor)?;
    after_hung.pass(hung)?;
    assert_eq!(source.latest()?.map(|command| command.stamp.tick), Some(50));
    assert_eq!(source.tally().received, 2);
    Ok(())
}

pub(crate) fn a_reader_that_never_reads_does_not_stop_the_control_path<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let (here, there) = (graph.ports(1)?, graph.ports(1)?);
    let mut stopped = here.source::<Command>(Since::First)?;
    let mut reading = here.source::<Command>(Since::First)?;
    let mut sink = there.sink::<Command>()?;
    let mut fence = Fence::between(&there, &here)?;
    assert!(!stopped.wait(BRIEF)?, "it listens, and then stops");
    for tick in 1..=20_000 {
        sink.send(&mut command(tick))?;
        if tick % 10 == 0 {
            receive_until(&mut reading, |command| command.stamp.tick == tick)?;
        }
    }
    fence.pass(sink)?;
    assert_eq!(reading.tally(), Tally { received: 20_000, ..Tally::default() });
    let depth = Topic::Command.quality(false).depth as u64;
    assert_eq!(stopped.latest()?.map(|command| command.stamp.tick), Some(20_000));
    assert_eq!(
        stopped.tally(),
        Tally { received: depth, lost: 20_000 - depth, ..Tally::default() }
    );
    Ok(())
}

pub(crate) fn nothing_is_lost_in_lock_step<F: Fixture>() -> Outcome {
    const COUNT: u64 = 5_000;
    let graph = F::new(true)?;
    let mut source = graph.ports(1)?.source::<Command>(Since::First)?;
    thread::scope(|scope| {
        let (done, is_done) = std::sync::mpsc::channel();
        let graph = &graph;
        let writer = scope.spawn(move || -> Result<u64, Failure> {
            let mut sink = graph.ports(1)?.sink::<Command>()?;
            for tick in 1..=COUNT {
                sink.send(&mut command(tick))?;
            }
            is_done.recv()?;
            Ok(sink.sent())
        });
        for tick in 1..=COUNT {
            assert!(source.wait(LONG)?, "command {tick} is missing");
            assert_eq!(source.next()?.map(|command| command.stamp.tick), Some(tick));
        }
        assert_eq!((source.tally().received, source.tally().lost), (COUNT, 0));
        done.send(())?;
        assert_eq!(writer.join().map_err(|_| "the writer panicked")??, COUNT);
        Ok(())
    })
}

pub(crate) fn a_lossless_writer_gives_up_when_its_patience_is_over<F: Fixture>() -> Outcome {
    let graph = F::with_patience(true, PATIENCE)?;
    let (here, there) = (graph.ports(1)?, graph.ports(1)?);
    let mut stopped = here.source::<Credit>(Since::First)?;
    let mut sink = there.sink::<Credit>()?;
    let mut fence = Fence::between(&there, &here)?;
    let depth = Topic::Credit.quality(true).depth as u64;
    for tick in 1..=depth {
        sink.send(&mut credit(tick))?;
    }
    let mut reading = here.source::<Credit>(Since::Joining)?;
    assert_eq!(
        sink.send(&mut credit(depth + 1)),
        Err(SendError::NoRoom { topic: Topic::Credit, waited: PATIENCE })
    );
    assert_eq!(sink.sent(), depth);
    receive_until(&mut reading, |credit| credit.through_tick == depth + 1)?;
    fence.cross()?;

    assert_eq!(receive(&mut stopped)?.through_tick, 1);
    sink.send(&mut credit(depth + 2))?;
    receive_until(&mut stopped, |credit| credit.through_tick == depth + 2)?;
    assert_eq!(stopped.tally(), Tally { received: depth + 1, lost: 1, ..Tally::default() });
    Ok(())
}

pub(crate) fn each_writer_of_a_topic_is_counted_by_itself<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let mut source = graph.ports(1)?.source::<Health>(Since::First)?;
    let mut sinks = Vec::new();
    for epoch in 0..5 {
        sinks.push(graph.ports(epoch)?.sink::<Health>()?);
    }
    for _ in 0..20 {
        for sink in &mut sinks {
            sink.send(&mut Health::zeroed())?;
        }
    }
    count_until(&mut source, |source| source.tally().received == 100)?;
    assert_eq!(source.tally(), Tally { received: 100, ..Tally::default() });
    Ok(())
}

pub(crate) fn a_snapshot_of_a_megabyte_crosses_whole<F: Fixture>() -> Outcome {
    let graph = F::new(true)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<ModelSnapshot>(Since::First)?;
    let mut sink = ports.sink::<ModelSnapshot>()?;
    for (version, points) in [(1, 10), (2, 12_000), (3, 16_384), (4, 20)] {
        let mut sent = snapshot(version, points)?;
        assert!(version != 2 || sent.byte_len() > 1_000_000);
        sink.send(&mut sent)?;
        assert!(receive(&mut source)? == sent, "snapshot {version} has changed on its way");
    }
    assert_eq!(source.tally(), Tally { received: 4, ..Tally::default() });
    Ok(())
}
