//! Sleeping until a message waits.

use crate::fixture::{BRIEF, Fixture, LONG, Outcome, command, receive, receive_until};
use protocol::message::Command;
use std::thread;
use std::time::{Duration, Instant};
use transport::Since;

pub(crate) fn a_wait_ends_when_a_message_comes<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let mut source = graph.ports(1)?.source::<Command>(Since::First)?;
    thread::scope(|scope| {
        let (received, is_received) = std::sync::mpsc::channel();
        let graph = &graph;
        let writer = scope.spawn(move || -> Outcome {
            let mut sink = graph.ports(1)?.sink::<Command>()?;
            thread::sleep(BRIEF);
            sink.send(&mut command(1))?;
            Ok(is_received.recv()?)
        });
        receive(&mut source)?;
        received.send(())?;
        writer.join().map_err(|_| "the writer panicked")??;
        Ok(())
    })
}

pub(crate) fn a_wait_ends_without_a_message_when_its_time_is_over<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let _sink = ports.sink::<Command>()?;
    for timeout in [BRIEF, BRIEF / 20, BRIEF / 1_000_000, Duration::ZERO] {
        let start = Instant::now();
        assert!(!source.wait(timeout)?);
        assert!(start.elapsed() >= timeout, "it ended early");
    }
    Ok(())
}

pub(crate) fn a_wait_is_over_at_once_when_a_message_is_there_already<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let mut sink = ports.sink::<Command>()?;
    sink.send(&mut command(1))?;
    sink.send(&mut command(2))?;
    assert!(source.wait(LONG)?, "it comes");
    for _ in 0..3 {
        assert!(source.wait(Duration::ZERO)?);
        assert!(source.wait(LONG)?);
    }
    source.next()?;
    assert!(source.wait(LONG)?, "the second is still there");
    Ok(())
}

pub(crate) fn a_wait_does_not_end_for_what_has_been_taken_already<F: Fixture>() -> Outcome {
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut source = ports.source::<Command>(Since::First)?;
    let mut sink = ports.sink::<Command>()?;
    assert!(!source.wait(BRIEF)?);
    for tick in 1..=2_000 {
        sink.send(&mut command(tick))?;
    }
    receive_until(&mut source, |command| command.stamp.tick == 2_000)?;
    assert!(!source.wait(BRIEF)?);
    sink.send(&mut command(2_001))?;
    assert!(source.wait(LONG)?);
    Ok(())
}

pub(crate) fn no_wake_up_is_lost_among_many<F: Fixture>() -> Outcome {
    const ROUNDS: u64 = 2_000;
    let graph = F::new(false)?;
    let ports = graph.ports(1)?;
    let mut questions = ports.sink::<Command>()?;
    let mut answers = ports.source::<protocol::message::Credit>(Since::First)?;
    let mut source = ports.source::<Command>(Since::First)?;
    assert!(source.next()?.is_none());
    thread::scope(|scope| {
        let (ready, is_ready) = std::sync::mpsc::channel();
        let graph = &graph;
        let other = scope.spawn(move || -> Outcome {
            let ports = graph.ports(1)?;
            let mut questions = ports.source::<Command>(Since::First)?;
            let mut answers = ports.sink::<protocol::message::Credit>()?;
            ready.send(())?;
            for tick in 1..=ROUNDS {
                while !questions.wait(LONG)? {}
                let question = questions.next()?.ok_or("woken for nothing")?;
                assert_eq!(question.stamp.tick, tick);
                answers.send(&mut crate::fixture::credit(tick))?;
            }
            Ok(())
        });
        is_ready.recv()?;
        for tick in 1..=ROUNDS {
            questions.send(&mut command(tick))?;
            assert!(answers.wait(LONG)?, "round {tick} was slept through");
            assert_eq!(answers.next()?.map(|credit| credit.through_tick), Some(tick));
        }
        other.join().map_err(|_| "the other side panicked")??;
        Ok(())
    })
}
