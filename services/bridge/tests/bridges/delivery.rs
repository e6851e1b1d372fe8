//! Messages on their way between two bridges, over a cable that may be cut.

use crate::hosts::{Host, Outcome, Pair, is_silent, receive};
use crate::messages::{bits, command, credit, health, plan, residual, snapshot, state, truth};
use protocol::message::{Command, Health, ModelSnapshot, Participant, Phase, PlantState};
use protocol::topic::{OnTopic, Topic};
use std::thread;
use std::time::Duration;
use transport::{Identity, Ports, Since};

/// Sends a message on one host, and receives it on the other.
fn crosses<T: OnTopic>(from: &Host, to: &Host, mut message: T) -> Outcome {
    let mut source = to.source::<T>()?;
    let mut sink = from.ports.sink()?;
    sink.send(&mut message)?;
    let sent = *message.stamp();
    let arrived = receive(&mut source, |arrived: &T| arrived.stamp().writer == sent.writer)?;
    assert!(bits(&arrived) == bits(&message), "{}: {:?} is not {sent:?}", T::NAME, arrived.stamp());
    Ok(())
}

#[test]
fn a_message_of_every_topic_arrives_with_its_own_stamp_bit_for_bit() -> Outcome {
    for lock_step in [false, true] {
        let pair = Pair::new(lock_step)?;
        let _bridges = pair.start()?;
        let (robot, control) = (&pair.robot, &pair.control);
        crosses(robot, control, state(7))?;
        crosses(robot, control, snapshot(1, 4_000))?;
        crosses(robot, control, truth())?;
        crosses(robot, control, health(Participant::Plant))?;
        crosses(control, robot, command(7))?;
        crosses(control, robot, residual())?;
        crosses(control, robot, plan())?;
        crosses(control, robot, credit())?;
        crosses(control, robot, health(Participant::Controller))?;
    }
    Ok(())
}

#[test]
fn what_came_from_another_host_is_not_sent_on() -> Outcome {
    let pair = Pair::new(false)?;
    let _bridges = pair.start()?;
    let mut received = pair.control.source::<Health>()?;
    let mut sink = pair.robot.ports.sink()?;
    for from in [Participant::Controller, Participant::Plant] {
        sink.send(&mut health(from))?;
    }
    let is_sent = |health: &Health| health.participant() != Some(Participant::Bridge);
    let first = receive(&mut received, is_sent)?;
    assert_eq!(first.participant(), Some(Participant::Plant));
    Ok(())
}

#[test]
fn in_lock_step_many_cuts_lose_no_message_and_double_none() -> Outcome {
    const CUTS: u64 = 12;
    const STATES: u64 = 3_000;
    const SNAPSHOTS: u64 = STATES / 200;
    let (pair, relay) = Pair::relayed(true)?;
    let _bridges = pair.start()?;
    let mut states = pair.control.source::<PlantState>()?;
    let mut snapshots = pair.control.source::<ModelSnapshot>()?;
    let links = pair.robot.settings.run.links.clone();
    let writer = thread::spawn(move || -> Outcome {
        let ports = Ports::open(&links, Identity::new(1))?;
        let (mut states, mut snapshots) = (ports.sink()?, ports.sink()?);
        for tick in 1..=STATES {
            states.send(&mut state(tick))?;
            if tick.is_multiple_of(200) {
                snapshots.send(&mut snapshot(tick / 200, 2_000))?;
            }
        }
        Ok(())
    });
    let (mut tick, mut version) = (0, 0);
    while tick < STATES || version < SNAPSHOTS {
        states.wait(Duration::from_millis(20))?;
        while let Some(state) = states.next()? {
            tick += 1;
            assert_eq!(state.stamp.tick, tick);
            if tick.is_multiple_of(STATES / CUTS) {
                relay.cut();
            }
        }
        while let Some(snapshot) = snapshots.next()? {
            version += 1;
            assert_eq!(snapshot.head.version, version);
        }
    }
    writer.join().map_err(|_| "the writer panicked")??;
    for tally in [states.tally(), snapshots.tally()] {
        assert_eq!((tally.lost, tally.stale, tally.refused), (0, 0, 0));
    }
    Ok(())
}

#[test]
fn in_lock_step_messages_wait_for_a_reader_without_room() -> Outcome {
    const STATES: u64 = 1_000;
    let pair = Pair::new(true)?;
    let [_robot, mut bridge] = pair.start()?;
    let mut states = pair.control.source::<PlantState>()?;
    let links = pair.robot.settings.run.links.clone();
    let writer = thread::spawn(move || -> Outcome {
        let mut sink = Ports::open(&links, Identity::new(1))?.sink()?;
        (1..=STATES).try_for_each(|tick| sink.send(&mut state(tick)).map_err(Into::into))
    });
    let depth = Topic::State.quality(true).depth as u64;
    bridge.until(|health| health.received[Topic::State.index()] == depth)?;
    for tick in 1..=STATES {
        let arrived = receive(&mut states, |_: &PlantState| true)?;
        assert_eq!(arrived.stamp.tick, tick);
    }
    writer.join().map_err(|_| "the writer panicked")??;
    let tally = states.tally();
    assert_eq!((tally.lost, tally.stale, tally.refused), (0, 0, 0));
    Ok(())
}

#[test]
fn after_a_cut_the_newest_message_arrives_and_a_late_joiner_gets_the_last_snapshot() -> Outcome {
    let (pair, relay) = Pair::relayed(false)?;
    let mut bridges = pair.start()?;
    let mut states = pair.control.source::<PlantState>()?;
    let mut snapshots = pair.control.source::<ModelSnapshot>()?;
    let (mut state_sink, mut snapshot_sink) = (pair.robot.ports.sink()?, pair.robot.ports.sink()?);
    snapshot_sink.send(&mut snapshot(1, 4_000))?;
    receive(&mut snapshots, |snapshot| snapshot.head.version == 1)?;

    relay.pull();
    for bridge in &mut bridges {
        bridge.until(|health| health.phase() == Phase::Degraded && health.error_len > 0)?;
    }
    for tick in 1..=50 {
        state_sink.send(&mut state(tick))?;
    }
    snapshot_sink.send(&mut snapshot(2, 4_000))?;
    relay.plug();

    receive(&mut states, |state| state.stamp.tick == 50)?;
    receive(&mut snapshots, |snapshot| snapshot.head.version == 2)?;
    for bridge in &mut bridges {
        bridge.is_running()?;
    }
    state_sink.send(&mut state(51))?;
    receive(&mut states, |state| state.stamp.tick == 51)?;
    let mut late = pair.control.ports.source::<ModelSnapshot>(Since::Joining)?;
    receive(&mut late, |snapshot| snapshot.head.version == 2)?;
    Ok(())
}

#[test]
fn a_killed_bridge_carries_on_after_its_restart() -> Outcome {
    let mut pair = Pair::new(false)?;
    let [robot, control] = pair.start()?;
    for host in [&mut pair.robot, &mut pair.control] {
        (host.settings.run.restarted, host.settings.run.epoch_floor) = (true, 1);
    }
    let mut states = pair.control.source::<PlantState>()?;
    let mut snapshots = pair.control.source::<ModelSnapshot>()?;
    let mut commands = pair.robot.source::<Command>()?;
    let (mut state_sink, mut snapshot_sink) = (pair.robot.ports.sink()?, pair.robot.ports.sink()?);
    let mut command_sink = pair.control.ports.sink()?;

    drop(robot);
    snapshot_sink.send(&mut snapshot(1, 4_000))?;
    let mut robot = pair.robot.start()?;
    robot.is_running()?;
    snapshot_sink.refresh()?;
    receive(&mut snapshots, |snapshot| snapshot.head.version == 1)?;

    drop(control);
    let mut control = pair.control.start()?;
    // That of the robot still counts as connected for a while.
    control.is_running()?;
    let mut late = pair.control.ports.source::<ModelSnapshot>(Since::Joining)?;
    receive(&mut late, |snapshot| snapshot.head.version == 1)?;
    state_sink.send(&mut state(1))?;
    command_sink.send(&mut command(1))?;
    receive(&mut states, |state| state.stamp.tick == 1)?;
    receive(&mut commands, |command| command.stamp.tick == 1)?;
    Ok(())
}

#[test]
fn bridges_of_different_pace_exchange_no_message_and_report_it() -> Outcome {
    for paces in [[true, false], [false, true]] {
        let pair = Pair::of_paces(paces)?;
        let mut bridges = [pair.robot.start()?, pair.control.start()?];
        for bridge in &mut bridges {
            bridge.until(|health| health.phase() == Phase::Degraded && health.error_len > 0)?;
        }
        let mut states = pair.control.source::<PlantState>()?;
        let mut commands = pair.robot.source::<Command>()?;
        let mut state_sink = pair.robot.ports.sink()?;
        let mut command_sink = pair.control.ports.sink()?;
        state_sink.send(&mut state(1))?;
        command_sink.send(&mut command(1))?;
        assert!(is_silent(&mut states)? && is_silent(&mut commands)?, "{paces:?}");
    }
    Ok(())
}

/// 1 Mbit/s.
const SLOW: u64 = 125_000;

#[test]
fn over_a_slow_link_a_long_message_arrives_and_no_state_is_lost_by_it() -> Outcome {
    let (pair, _relay) = Pair::slow(SLOW)?;
    let _bridges = pair.start()?;
    let mut states = pair.control.source::<PlantState>()?;
    let mut models = pair.control.source::<ModelSnapshot>()?;
    let (mut state_sink, mut model_sink) = (pair.robot.ports.sink()?, pair.robot.ports.sink()?);
    // It takes more than a second.
    let mut model = snapshot(1, 1_500);
    model_sink.send(&mut model)?;
    for tick in 1..=50 {
        state_sink.send(&mut state(tick))?;
        assert_eq!(receive(&mut states, |_| true)?.stamp.tick, tick);
        thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(receive(&mut models, |_| true)?.head.version, 1);
    assert_eq!(states.tally().lost, 0);
    Ok(())
}
