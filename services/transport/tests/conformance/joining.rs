//! Readers and writers that join late, or join again.

use crate::fixture::{
    BRIEF, Fixture, LONG, Outcome, command, credit, receive, receive_until, snapshot,
};
use protocol::message::{Command, Credit, ModelSnapshot};
use protocol::topic::Topic;
use transport::{OpenError, Since, Tally};

pub(crate) fn a_late_joiner_gets_the_last_snapshot<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut early = ports.source::<ModelSnapshot>(Since::First)?;
    let mut sink = ports.sink::<ModelSnapshot>()?;
    for version in 1..=3 {
        sink.send(&mut snapshot(version, 100)?)?;
    }
    receive_until(&mut early, |snapshot| snapshot.head.version == 3)?;
    let mut late = ports.source::<ModelSnapshot>(Since::Joining)?;
    sink.refresh()?;
    assert_eq!(receive(&mut late)?.head.version, 3);
    assert_eq!(late.next()?, None);

    sink.refresh()?;
    assert_eq!(late.next()?, None, "it gets it once");
    sink.send(&mut snapshot(4, 100)?)?;
    assert_eq!(receive(&mut late)?.head.version, 4);
    assert_eq!(late.tally(), Tally { received: 2, ..Tally::default() });
    assert_eq!(receive(&mut early)?.head.version, 4);
    assert_eq!(
        early.tally(),
        Tally { received: 4, ..Tally::default() },
        "the others do not notice"
    );
    Ok(())
}

pub(crate) fn a_late_joiner_counts_no_losses_from_before_its_time<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut early = ports.source::<Command>(Since::First)?;
    let mut sink = ports.sink::<Command>()?;
    for tick in 1..=10 {
        sink.send(&mut command(tick))?;
    }
    receive_until(&mut early, |command| command.stamp.tick == 10)?;
    let mut joining = ports.source::<Command>(Since::Joining)?;
    let mut strict = ports.source::<Command>(Since::First)?;
    sink.send(&mut command(11))?;
    assert_eq!(receive(&mut joining)?.stamp.tick, 11);
    assert_eq!(joining.tally(), Tally { received: 1, ..Tally::default() });
    assert_eq!(receive(&mut strict)?.stamp.tick, 11);
    assert_eq!(strict.tally(), Tally { received: 1, lost: 10, ..Tally::default() });
    Ok(())
}

pub(crate) fn a_restarted_writer_is_received_at_once<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let mut source = graph.ports(1)?.source::<Command>(Since::First)?;
    for epoch in 1..=8 {
        let mut sink = graph.ports(epoch)?.sink::<Command>()?;
        sink.send(&mut command(1))?;
        sink.send(&mut command(2))?;
        for sequence in 1..=2 {
            let stamp = receive(&mut source)?.stamp;
            assert_eq!((stamp.epoch, stamp.sequence), (epoch, sequence));
        }
    }
    assert_eq!(source.tally(), Tally { received: 16, ..Tally::default() });
    Ok(())
}

pub(crate) fn a_new_epoch_starts_at_sequence_one<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::Joining)?;
    let mut sink = ports.sink::<Command>()?;
    sink.send(&mut command(1))?;
    sink.send(&mut command(2))?;
    sink.set_epoch(9);
    sink.send(&mut command(3))?;
    assert_eq!(sink.sent(), 3);
    for expected in [(1, 1), (1, 2), (9, 1)] {
        let stamp = receive(&mut source)?.stamp;
        assert_eq!((stamp.epoch, stamp.sequence), expected);
    }
    assert_eq!(source.tally(), Tally { received: 3, ..Tally::default() });
    Ok(())
}

pub(crate) fn a_restarted_reader_receives_what_comes_next<F: Fixture>() -> Outcome {
    let graph = F::new(true)?;
    let mut sink = graph.ports(1)?.sink::<Command>()?;
    let depth = Topic::Command.quality(true).depth as u64;
    let mut tick = 0;
    for _ in 0..4 {
        let mut source = graph.ports(1)?.source::<Command>(Since::Joining)?;
        for _ in 0..depth {
            tick += 1;
            sink.send(&mut command(tick))?;
        }
        receive_until(&mut source, |command| command.stamp.tick == tick)?;
        assert_eq!(source.tally(), Tally { received: depth, ..Tally::default() });
    }
    Ok(())
}

pub(crate) fn a_place_that_is_left_can_be_taken_again<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let quality = Topic::Credit.quality(false);
    let mut sinks = Vec::new();
    for _ in 0..quality.writers {
        sinks.push(ports.sink::<Credit>()?);
    }
    let refused = ports.sink::<Credit>().map(drop);
    assert!(
        matches!(&refused, Err(OpenError::Full { topic: Topic::Credit, limit: 4, .. })),
        "{refused:?}"
    );
    sinks.pop();
    sinks.push(ports.sink::<Credit>()?);
    let mut sources = Vec::new();
    for _ in 0..quality.readers {
        sources.push(ports.source::<Credit>(Since::Joining)?);
    }
    let refused = ports.source::<Credit>(Since::Joining).map(drop);
    assert!(
        matches!(&refused, Err(OpenError::Full { topic: Topic::Credit, limit: 8, .. })),
        "{refused:?}"
    );
    sources.pop();
    sources.push(ports.source::<Credit>(Since::Joining)?);
    for source in &mut sources {
        assert!(!source.wait(BRIEF / 8)?, "each can listen");
    }
    for sink in &mut sinks {
        sink.send(&mut credit(1))?;
    }
    for source in &mut sources {
        receive(source)?;
    }
    Ok(())
}

pub(crate) fn two_graphs_do_not_receive_each_other<F: Fixture>() -> Outcome {
    let (here, there) = (F::new(false)?, F::new(false)?);
    let mut source_here = here.ports(1)?.source::<Command>(Since::First)?;
    let mut source_there = there.ports(1)?.source::<Command>(Since::First)?;
    let mut sink = here.ports(1)?.sink::<Command>()?;
    sink.send(&mut command(1))?;
    assert!(source_here.wait(LONG)?);
    assert!(!source_there.wait(BRIEF)?);
    assert_eq!(source_there.next()?, None);
    Ok(())
}
