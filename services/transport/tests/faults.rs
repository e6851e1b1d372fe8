//! Promise: faults are injected as the settings specify, and a reader never accepts a damaged
//! message as valid.

use bytemuck::Zeroable;
use protocol::message::{Command, Participant, PlantState};
use protocol::topic::Topic;
use std::error::Error;
use std::time::Duration;
use transport::{End, Exchange, Fault, Faults, Identity, Kind, Ports, Since, Sink, Source, Tally};

type Outcome = Result<(), Box<dyn Error>>;

const LONG: Duration = Duration::from_mins(1);

fn fault(at: End, kind: Kind) -> Fault {
    let (participant, from_tick, until_tick, probability) = (None, 5, Some(10), 1.0);
    let (millis, messages, field, number, amount) = (None, None, None, None, None);
    Fault {
        topic: Topic::Command,
        at,
        participant,
        kind,
        from_tick,
        until_tick,
        probability,
        millis,
        messages,
        field,
        number,
        amount,
    }
}

fn faults(fault: Vec<Fault>) -> Faults {
    Faults { seed: 7, process: Some(Participant::Plant), fault }
}

/// A link with an injected fault.
struct Link {
    ports: Ports,
    sink: Sink<Command>,
    source: Source<Command>,
}

impl Link {
    fn new(lock_step: bool, faults: &Faults) -> Result<Self, Box<dyn Error>> {
        faults.check()?;
        let exchange = Exchange::new(lock_step, LONG);
        let ports = Ports::in_memory_with(&exchange, Identity::new(1), faults);
        let source = ports.source(Since::First)?;
        Ok(Self { sink: ports.sink()?, ports, source })
    }

    fn send(&mut self, tick: u64) -> Outcome {
        let mut command = Command::zeroed();
        command.stamp.tick = tick;
        command.input = [tick as f64, 0.5, -0.25];
        Ok(self.sink.send(&mut command)?)
    }

    fn received(&mut self) -> Result<Vec<Command>, Box<dyn Error>> {
        let mut received = Vec::new();
        while let Some(command) = self.source.next()? {
            received.push(command);
        }
        Ok(received)
    }

    fn ticks(&mut self) -> Result<Vec<u64>, Box<dyn Error>> {
        Ok(self.received()?.iter().map(|command| command.stamp.tick).collect())
    }
}

/// Sends ticks 0 to 14, with one fault in ticks 5 to 9. Returns the ticks received, the counts, and
/// how often the fault was injected.
fn run(fault: Fault) -> Result<(Vec<Command>, Tally, u64), Box<dyn Error>> {
    let mut link = Link::new(false, &faults(vec![fault]))?;
    for tick in 0..15 {
        link.send(tick)?;
    }
    let received = link.received()?;
    Ok((received, link.source.tally(), link.ports.injected()[0]))
}

fn ticks(received: &[Command]) -> Vec<u64> {
    received.iter().map(|command| command.stamp.tick).collect()
}

const BOTH: [End; 2] = [End::Writer, End::Reader];

#[test]
fn dropped_messages_are_lost_and_counted_and_all_others_come() -> Outcome {
    for at in BOTH {
        let (received, tally, injected) = run(fault(at, Kind::Drop))?;
        assert_eq!(ticks(&received), [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]);
        assert_eq!((tally, injected), (Tally { received: 10, lost: 5, refused: 0, stale: 0 }, 5));
    }
    Ok(())
}

#[test]
fn duplicates_and_replays_are_stale_and_change_nothing() -> Outcome {
    for at in BOTH {
        for (kind, messages) in
            [(Kind::Duplicate, None), (Kind::Replay, None), (Kind::Replay, Some(3))]
        {
            let (received, tally, injected) = run(Fault { messages, ..fault(at, kind) })?;
            assert_eq!(ticks(&received), (0..15).collect::<Vec<u64>>());
            assert_eq!(
                (tally, injected),
                (Tally { received: 15, lost: 0, refused: 0, stale: 5 }, 5)
            );
        }
    }
    Ok(())
}

#[test]
fn a_message_behind_later_ones_is_stale_and_was_counted_as_lost() -> Outcome {
    for at in BOTH {
        let (received, tally, injected) = run(fault(at, Kind::Reorder))?;
        assert_eq!(
            ticks(&received),
            [0, 1, 2, 3, 4, 6, 8, 10, 11, 12, 13, 14],
            "swaps of 5 and 6, 7 and 8, 9 and 10"
        );
        assert_eq!((tally, injected), (Tally { received: 12, lost: 3, refused: 0, stale: 3 }, 3));
        let (received, tally, injected) =
            run(Fault { messages: Some(2), ..fault(at, Kind::Delay) })?;
        // All messages of the window are held equally long and so keep their order, until the first
        // message behind the window overtakes them.
        assert_eq!(ticks(&received), [0, 1, 2, 3, 4, 5, 6, 7, 10, 11, 12, 13, 14]);
        assert_eq!((tally, injected), (Tally { received: 13, lost: 2, refused: 0, stale: 2 }, 5));
        let (received, tally, injected) =
            run(Fault { messages: Some(4), ..fault(at, Kind::Jitter) })?;
        assert_eq!((tally.received + tally.lost, tally.lost, tally.refused), (15, tally.stale, 0));
        assert!(ticks(&received).is_sorted());
        assert_eq!(injected, 5);
    }
    Ok(())
}

#[test]
fn every_damaged_message_is_refused_and_counted() -> Outcome {
    for at in BOTH {
        for kind in [Kind::Corrupt, Kind::Truncate, Kind::Version] {
            let (received, tally, injected) = run(fault(at, kind))?;
            assert_eq!(ticks(&received), [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]);
            assert_eq!(
                (tally, injected),
                (Tally { received: 10, lost: 5, refused: 5, stale: 0 }, 5)
            );
        }
    }
    Ok(())
}

#[test]
fn a_thousand_flipped_bits_cuts_and_other_versions_are_all_refused() -> Outcome {
    for kind in [Kind::Corrupt, Kind::Truncate, Kind::Version] {
        let mut link = Link::new(
            false,
            &faults(vec![Fault { from_tick: 0, until_tick: None, ..fault(End::Reader, kind) }]),
        )?;
        for tick in 0..1000 {
            link.send(tick)?;
            assert!(link.source.next()?.is_none());
        }
        assert_eq!((link.source.tally().refused, link.ports.injected()), (1000, vec![1000]));
    }
    Ok(())
}

#[test]
fn a_stuck_sensor_repeats_its_numbers_in_valid_messages() -> Outcome {
    for at in BOTH {
        let (received, tally, injected) = run(fault(at, Kind::Freeze))?;
        let inputs: Vec<f64> = received.iter().map(|command| command.input[0]).collect();
        assert_eq!(
            inputs,
            [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 5.0, 5.0, 5.0, 5.0, 10.0, 11.0, 12.0, 13.0, 14.0]
        );
        assert_eq!(ticks(&received), (0..15).collect::<Vec<u64>>());
        assert_eq!((tally.received, injected), (15, 4));
    }
    Ok(())
}

#[test]
fn a_number_of_the_field_that_was_named_is_not_a_number() -> Outcome {
    for at in BOTH {
        let (received, tally, injected) =
            run(Fault { field: Some("input".to_owned()), ..fault(at, Kind::Nan) })?;
        for command in &received {
            let nans = command.input.iter().filter(|value| value.is_nan()).count();
            assert_eq!(nans, usize::from((5..10).contains(&command.stamp.tick)));
            assert!(command.tail.as_flattened().iter().all(|value| value.is_finite()));
        }
        assert_eq!((tally.received, injected), (15, 5));
    }
    Ok(())
}

#[test]
fn a_flipped_field_has_the_other_sign_and_an_outlier_is_off_by_no_more_than_was_asked_for()
-> Outcome {
    for at in BOTH {
        let field = Some("input".to_owned());
        let (received, tally, injected) =
            run(Fault { field: field.clone(), ..fault(at, Kind::Flip) })?;
        for command in &received {
            let (tick, sign) = (
                command.stamp.tick,
                if (5..10).contains(&command.stamp.tick) { -1.0 } else { 1.0 },
            );
            assert_eq!(command.input, [tick as f64, 0.5, -0.25].map(|value| sign * value));
        }
        assert_eq!((tally.received, injected), (15, 5));
        let (received, tally, injected) =
            run(Fault { field, amount: Some(0.1), ..fault(at, Kind::Outlier) })?;
        for command in &received {
            let (tick, wrong) = (command.stamp.tick, (5..10).contains(&command.stamp.tick));
            let off = command
                .input
                .iter()
                .zip([tick as f64, 0.5, -0.25])
                .map(|(value, meant)| (value - meant).abs());
            assert!(off.fold(0.0, f64::max) <= if wrong { 0.1 } else { 0.0 }, "{command:?}");
            assert!(!wrong || command.input[1] != 0.5, "{command:?}");
        }
        assert_eq!((tally.received, injected), (15, 5));
    }
    Ok(())
}

#[test]
fn a_delayed_message_arrives_after_its_delay_even_without_further_messages() -> Outcome {
    for kind in [Kind::Delay, Kind::Jitter] {
        let mut link = Link::new(
            false,
            &faults(vec![Fault { millis: Some(30), ..fault(End::Reader, kind) }]),
        )?;
        link.send(5)?;
        assert!(link.source.wait(LONG)?);
        assert_eq!(link.ticks()?, [5]);
    }
    let mut link = Link::new(
        false,
        &faults(vec![Fault { millis: Some(5000), ..fault(End::Reader, Kind::Delay) }]),
    )?;
    link.send(5)?;
    assert_eq!(link.ticks()?, [0; 0], "not before");
    assert!(!link.source.wait(Duration::from_millis(20))?);
    Ok(())
}

#[test]
fn a_writer_releases_delayed_messages_with_its_next_message() -> Outcome {
    let mut link = Link::new(
        false,
        &faults(vec![Fault { millis: Some(1), ..fault(End::Writer, Kind::Delay) }]),
    )?;
    link.send(5)?;
    while link.ports.injected() == [1] && !link.source.wait(Duration::from_millis(2))? {
        link.sink.refresh()?;
    }
    assert_eq!(link.ticks()?, [5]);
    Ok(())
}

#[test]
fn in_lock_step_what_was_withheld_comes_after_all_when_the_reader_has_waited_in_vain() -> Outcome {
    for (kind, messages) in [
        (Kind::Drop, None),
        (Kind::Corrupt, None),
        (Kind::Truncate, None),
        (Kind::Version, None),
        (Kind::Reorder, None),
        (Kind::Delay, Some(3)),
        (Kind::Jitter, Some(3)),
    ] {
        let withheld = faults(vec![Fault { messages, ..fault(End::Reader, kind) }]);
        withheld.check_lock_step()?;
        let mut link = Link::new(true, &withheld)?;
        for tick in 0..15 {
            link.send(tick)?;
            assert!(link.source.wait(LONG)?, "{kind:?}");
            while link.source.next()?.is_none() {
                link.source.wait(LONG)?;
            }
        }
        assert_eq!((link.source.tally().received, link.source.tally().lost), (15, 0), "{kind:?}");
        assert!(link.ports.injected()[0] > 0);
    }
    Ok(())
}

#[test]
fn in_lock_step_what_was_dropped_stays_away_once_a_later_message_has_come() -> Outcome {
    let mut link = Link::new(true, &faults(vec![fault(End::Reader, Kind::Drop)]))?;
    for tick in 0..15 {
        link.send(tick)?;
    }
    assert_eq!(link.ticks()?, [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]);
    Ok(())
}

#[test]
fn a_fault_outside_its_window_its_link_its_end_or_its_process_touches_nothing() -> Outcome {
    let dropped = fault(End::Reader, Kind::Drop);
    for untouched in [
        Fault { from_tick: 100, until_tick: None, ..dropped.clone() },
        Fault { topic: Topic::State, ..dropped.clone() },
        Fault { participant: Some(Participant::Recorder), ..dropped.clone() },
    ] {
        let (received, tally, injected) = run(untouched)?;
        assert_eq!((received.len(), tally.lost, injected), (15, 0, 0));
    }
    let named = Fault { participant: Some(Participant::Plant), ..dropped };
    assert_eq!(run(named)?.2, 5);
    Ok(())
}

#[test]
fn the_same_seed_gives_the_same_faults_and_another_one_others() -> Outcome {
    let with_seed = |seed| -> Result<Vec<Vec<u64>>, Box<dyn Error>> {
        let mut outcomes = Vec::new();
        for kind in [Kind::Drop, Kind::Jitter, Kind::Corrupt] {
            let messages = (kind == Kind::Jitter).then_some(5);
            let fault = Fault {
                from_tick: 0,
                until_tick: None,
                probability: 0.5,
                messages,
                ..fault(End::Reader, kind)
            };
            let mut link = Link::new(false, &Faults { seed, process: None, fault: vec![fault] })?;
            for tick in 0..200 {
                link.send(tick)?;
            }
            outcomes.push(link.ticks()?);
        }
        Ok(outcomes)
    };
    assert_eq!(with_seed(1)?, with_seed(1)?);
    assert_ne!(with_seed(1)?, with_seed(2)?);
    Ok(())
}

#[test]
fn faults_on_one_link_work_one_behind_the_other() -> Outcome {
    let both = faults(vec![fault(End::Reader, Kind::Duplicate), fault(End::Reader, Kind::Corrupt)]);
    let mut link = Link::new(false, &both)?;
    for tick in 0..15 {
        link.send(tick)?;
    }
    assert_eq!(link.ticks()?, [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]);
    assert_eq!((link.ports.injected(), link.source.tally().refused), (vec![5, 10], 10));
    Ok(())
}

#[test]
fn what_a_fault_holds_is_bounded() -> Outcome {
    let held = Fault {
        from_tick: 0,
        until_tick: None,
        millis: Some(10_000),
        ..fault(End::Reader, Kind::Delay)
    };
    let mut link = Link::new(false, &faults(vec![held]))?;
    for tick in 0..1000 {
        link.send(tick)?;
        let _ = link.source.next()?;
    }
    assert_eq!(
        link.source.tally().received,
        1000 - 256,
        "the oldest comes out when there is no more room"
    );
    Ok(())
}

#[test]
fn impossible_faults_are_refused_by_key() -> Outcome {
    let delay = Fault { messages: Some(1), ..fault(End::Reader, Kind::Delay) };
    for (fault, key) in [
        (Fault { probability: 0.0, ..delay.clone() }, "fault.0.probability"),
        (Fault { probability: f64::NAN, ..delay.clone() }, "fault.0.probability"),
        (Fault { until_tick: Some(5), ..delay.clone() }, "fault.0.until_tick"),
        (Fault { millis: Some(1), ..delay.clone() }, "fault.0.messages"),
        (Fault { messages: Some(0), ..delay.clone() }, "fault.0.messages"),
        (Fault { messages: Some(65), ..delay.clone() }, "fault.0.messages"),
        (Fault { messages: None, ..delay.clone() }, "fault.0.millis"),
        (Fault { kind: Kind::Drop, ..delay.clone() }, "fault.0.messages"),
        (Fault { field: Some("input".to_owned()), ..delay.clone() }, "fault.0.field"),
        (fault(End::Reader, Kind::Nan), "fault.0.field"),
        (fault(End::Reader, Kind::Flip), "fault.0.field"),
        (
            Fault { field: Some("input".to_owned()), ..fault(End::Reader, Kind::Outlier) },
            "fault.0.amount",
        ),
        (Fault { amount: Some(0.1), ..fault(End::Reader, Kind::Drop) }, "fault.0.amount"),
        (
            Fault { field: Some("velocity".to_owned()), ..fault(End::Reader, Kind::Nan) },
            "fault.0.field",
        ),
        (Fault { topic: Topic::Health, ..fault(End::Reader, Kind::Freeze) }, "fault.0.topic"),
    ] {
        let refusal = faults(vec![fault]).check().err().ok_or(key)?;
        assert_eq!(refusal.key, key, "{refusal}");
    }
    for (fault, key) in [
        (Fault { messages: None, millis: Some(5), ..delay }, "fault.0.millis"),
        (fault(End::Writer, Kind::Drop), "fault.0.at"),
    ] {
        faults(vec![fault.clone()]).check()?;
        let refusal = faults(vec![fault]).check_lock_step().err().ok_or(key)?;
        assert_eq!(refusal.key, key, "{refusal}");
    }
    Ok(())
}

#[test]
fn a_number_field_of_every_message_can_be_reached() -> Outcome {
    for topic in Topic::ALL {
        for field in topic.numbers() {
            let nan =
                Fault { topic, field: Some((*field).to_owned()), ..fault(End::Reader, Kind::Nan) };
            faults(vec![nan]).check()?;
        }
    }
    let exchange = Exchange::new(false, LONG);
    let nan = Fault {
        topic: Topic::State,
        field: Some("velocity".to_owned()),
        from_tick: 0,
        ..fault(End::Reader, Kind::Nan)
    };
    let ports = Ports::in_memory_with(&exchange, Identity::new(1), &faults(vec![nan]));
    let (mut source, mut sink) =
        (ports.source::<PlantState>(Since::First)?, ports.sink::<PlantState>()?);
    sink.send(&mut PlantState::zeroed())?;
    let state = source.next()?.ok_or("no state")?;
    assert!(state.velocity.iter().any(|value| value.is_nan()) && state.pose == [0.0; 3]);
    Ok(())
}
