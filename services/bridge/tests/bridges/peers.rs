//! Peers that are no bridges of ours: hostile ones, and a robot's driver.

use crate::certificates::Authority;
use crate::hosts::{Outcome, Pair, Peer, is_silent, receive};
use crate::messages::{bits, command, health, state, truth};
use access::Role;
use protocol::message::{Command, Health, Message, Participant, Phase, PlantState, Truth};
use protocol::topic::Topic;
use protocol::{VERSION, wire};
use std::time::Instant;
use zenoh::Wait;

/// The bytes of a message on the network, from the writer 1.
fn encoded<T: Message>(mut message: T, sequence: u64) -> Vec<u8> {
    let stamp = message.stamp_mut();
    (stamp.version, stamp.kind) = (VERSION, T::KIND);
    (stamp.writer, stamp.epoch, stamp.sequence) = (1, 1, sequence);
    let mut bytes = Vec::new();
    wire::encode(&message, &mut bytes);
    bytes
}

fn put_state(peer: &Peer, tick: u64) -> Outcome {
    peer.put("state", [(encoded(state(tick), tick).as_slice(), None)])
}

#[test]
fn a_message_of_a_process_of_another_host_is_counted_and_not_delivered() -> Outcome {
    let pair = Pair::new(false)?;
    let mut control = pair.alone()?;
    let (mut healths, mut commands) =
        (pair.control.source::<Health>()?, pair.control.source::<Command>()?);
    let peer = pair.client(None)?;
    peer.hello(VERSION, false)?;
    control.is_running()?;
    peer.put("command", [(encoded(command(1), 1).as_slice(), None)])?;
    let [forged, genuine] = [Participant::Controller, Participant::Plant]
        .map(|participant| encoded(health(participant), 1));
    peer.put("health", [(forged.as_slice(), None), (genuine.as_slice(), None)])?;
    let is_sent = |health: &Health| health.stamp.writer == 1;
    let first = receive(&mut healths, is_sent)?;
    assert_eq!(first.participant(), Some(Participant::Plant));
    assert_eq!(control.refuses(Topic::Health, 1)?, 1);
    assert!(is_silent(&mut commands)?, "the robot's host has no controller");
    Ok(())
}

#[test]
fn a_bridge_of_another_protocol_version_exchanges_no_message_until_it_is_replaced() -> Outcome {
    let pair = Pair::new(false)?;
    let mut control = pair.alone()?;
    let mut states = pair.control.source::<PlantState>()?;
    let peer = pair.client(None)?;
    peer.hello(VERSION - 1, false)?;
    control.until(|health| health.phase() == Phase::Degraded && health.error_len > 0)?;
    put_state(&peer, 1)?;
    assert!(is_silent(&mut states)?);
    peer.hello(VERSION, false)?;
    control.is_running()?;
    put_state(&peer, 2)?;
    assert_eq!(receive(&mut states, |_| true)?.stamp.tick, 2);
    Ok(())
}

#[test]
fn a_flood_of_one_topic_is_counted_and_the_other_topics_go_on() -> Outcome {
    const ROUNDS: u64 = 20;
    const STATES: u64 = 1_000;
    let pair = Pair::new(false)?;
    let mut control = pair.alone()?;
    let mut truths = pair.control.source::<Truth>()?;
    let peer = pair.client(None)?;
    peer.hello(VERSION, false)?;
    control.is_running()?;
    let begin = Instant::now();
    for round in 0..ROUNDS {
        let states: Vec<Vec<u8>> = (1..=STATES)
            .map(|tick| round * STATES + tick)
            .map(|tick| encoded(state(tick), tick))
            .collect();
        peer.put("state", states.iter().map(|state| (state.as_slice(), None)))?;
        peer.put("truth", [(encoded(truth(), round + 1).as_slice(), None)])?;
    }
    for _ in 0..ROUNDS {
        receive(&mut truths, |_| true)?;
    }
    let state = Topic::State.index();
    let [received, refused] = [
        |health: &Health| health.received[Topic::State.index()],
        |health: &Health| health.refused[Topic::State.index()],
    ];
    let counted = control.until(|health| {
        received(health) + refused(health) + health.dropped[state] == ROUNDS * STATES
    })?;
    // Four times the rate, and 64 at once.
    let most = 64.0 + 4.0 * 50.0 * begin.elapsed().as_secs_f64();
    assert!(received(&counted) as f64 <= most, "{} > {most}", received(&counted));
    assert!(refused(&counted) > 0);
    Ok(())
}

/// Attachments and payloads that no bridge sends, for the key of states.
fn malformed() -> (Vec<Vec<u8>>, Vec<Vec<u8>>) {
    let valid = encoded(state(1), 1);
    let mut payloads = vec![vec![0], vec![0xff; 100], encoded(command(1), 1)];
    payloads.extend([1, 7, 8, valid.len() - 1].map(|length| valid[..length].to_vec()));
    payloads.push([valid.as_slice(), &[0]].concat());
    for index in [0, 2, 5, 8, 12, valid.len() - 1] {
        let mut damaged = valid.clone();
        damaged[index] ^= 0x10;
        payloads.push(damaged);
    }
    let labels = [1, 23, 25, 100].map(|length| vec![0xff; length]).to_vec();
    (payloads, labels)
}

/// Well-formed labels that contradict their pieces and each other.
fn contradictory() -> Vec<Vec<u8>> {
    let rows: [(u64, u64, u32, u32); 8] = [
        (1, u64::MAX, 0, u32::MAX),
        (1, 0, 1, u32::MAX),
        (1, 1, 0, 0),
        (1, 2, u32::MAX, 1),
        (1, 3, 0, 1),
        (u64::MAX, u64::MAX, 0, 1_000_000),
        (u64::MAX, 0, 200, 1_000_000),
        (0, 0, u32::MAX, u32::MAX),
    ];
    let row = |(instance, number, offset, length): (u64, u64, u32, u32)| {
        [
            instance.to_le_bytes().as_slice(),
            &number.to_le_bytes(),
            &offset.to_le_bytes(),
            &length.to_le_bytes(),
        ]
        .concat()
    };
    rows.map(row).to_vec()
}

#[test]
fn malformed_bytes_and_labels_are_counted_and_stop_nothing() -> Outcome {
    for lock_step in [false, true] {
        let pair = Pair::new(lock_step)?;
        let mut control = pair.alone()?;
        let mut states = pair.control.source::<PlantState>()?;
        let peer = pair.client(None)?;
        for what in ["hello", "state-ack", "command-ack", "health-ack", "speed"] {
            peer.put(what, [([0xff; 24].as_slice(), None), (b"{}", None)])?;
        }
        peer.hello(VERSION, lock_step)?;
        control.is_running()?;
        let (payloads, labels) = malformed();
        let valid = encoded(state(1), 1);
        peer.put("state", payloads.iter().map(|payload| (payload.as_slice(), None)))?;
        let labelled = labels.iter().chain(&contradictory()).cloned().collect::<Vec<_>>();
        peer.put("state", labelled.iter().map(|label| (valid.as_slice(), Some(label.as_slice()))))?;
        put_state(&peer, 2)?;
        let refused = (payloads.len() + labels.len()) as u64;
        assert_eq!(control.refuses(Topic::State, refused)?, refused);
        assert_eq!(receive(&mut states, |_| true)?.stamp.tick, 2);
    }
    Ok(())
}

#[test]
fn a_peer_with_another_certificate_delivers_nothing_and_does_not_keep_the_host_out() -> Outcome {
    let (authority, other) = (Authority::new()?, Authority::new()?);
    let pair = Pair::guarded(&authority)?;
    let mut control = pair.alone()?;
    let mut states = pair.control.source::<PlantState>()?;
    let strangers =
        [authority.of_host("thief")?, authority.of(&Role::Driver)?, other.of_host("robot")?];
    // They stay, and connect again and again.
    let strangers: Vec<Peer> =
        strangers.iter().filter_map(|stranger| pair.client(Some(stranger)).ok()).collect();
    for stranger in &strangers {
        let bytes = encoded(state(1), 1);
        stranger.session.put("coxswain-link/g/robot/control/state", bytes).wait()?;
    }
    assert!(pair.client(None).is_err(), "without TLS");
    let mut robot = pair.robot.start()?;
    robot.is_running()?;
    control.is_running()?;
    let mut sink = pair.robot.ports.sink()?;
    sink.send(&mut state(9))?;
    assert_eq!(receive(&mut states, |_| true)?.stamp.tick, 9);
    Ok(())
}

#[test]
fn a_second_session_with_the_same_certificate_is_refused_while_the_first_lives() -> Outcome {
    let authority = Authority::new()?;
    let pair = Pair::guarded(&authority)?;
    let [robot, mut control] = pair.start()?;
    let same = authority.of_host("robot")?;
    for _ in 0..5 {
        assert!(pair.client(Some(&same)).is_err());
    }
    let mut states = pair.control.source::<PlantState>()?;
    let mut sink = pair.robot.ports.sink()?;
    sink.send(&mut state(1))?;
    assert_eq!(receive(&mut states, |_| true)?.stamp.tick, 1);
    drop(robot);
    control.until(|health| health.phase() == Phase::Degraded)?;
    assert!(pair.client(Some(&same)).is_ok());
    Ok(())
}

#[test]
fn a_link_that_carries_nothing_does_not_keep_the_host_out() -> Outcome {
    let authority = Authority::new()?;
    let pair = Pair::guarded(&authority)?;
    let mut control = pair.alone()?;
    // It has the host's certificate, holds the one session, and says nothing.
    let _silent = pair.client(Some(&authority.of_host("robot")?))?;
    let mut robot = pair.robot.start()?;
    robot.is_running()?;
    control.is_running()?;
    let mut states = pair.control.source::<PlantState>()?;
    let mut sink = pair.robot.ports.sink()?;
    sink.send(&mut state(3))?;
    assert_eq!(receive(&mut states, |_| true)?.stamp.tick, 3);
    Ok(())
}

#[test]
fn a_driver_exchanges_state_and_command() -> Outcome {
    let authority = Authority::new()?;
    let mut pair = Pair::guarded(&authority)?;
    let remote = &mut pair.control.settings.remotes[0];
    (remote.driver, remote.processes) = (true, vec![Participant::Plant]);
    let mut control = pair.alone()?;
    let mut states = pair.control.source::<PlantState>()?;
    let peer = pair.client(Some(&authority.of(&Role::Driver)?))?;
    let commands =
        peer.session.declare_subscriber("coxswain-link/g/control/robot/command").wait()?;
    control.is_running()?;
    put_state(&peer, 1)?;
    let arrived = receive(&mut states, |_| true)?;
    assert_eq!(encoded(arrived, 1), encoded(state(1), 1));
    let (mut sent, mut sink) = (command(1), pair.control.ports.sink()?);
    sink.send(&mut sent)?;
    let sample = commands.recv_timeout(crate::hosts::LONG)?.ok_or("no command")?;
    let command: Command = wire::decode(&sample.payload().to_bytes())?;
    assert_eq!(bits(&command), bits(&sent));
    Ok(())
}
