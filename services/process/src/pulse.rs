//! process → everyone: the heartbeat of one process, and by a line of its own → its launcher.

use crate::{Pace, lifeline};
use bytemuck::Zeroable;
use protocol::clock::monotonic_nanos;
use protocol::message::{Exposure, GateState, Health, Participant, Phase, Reason};
use protocol::port::{OpenError, Ports, Sink, Tally};
use protocol::topic::{OnTopic, Topic};
use std::thread;
use std::time::Duration;

/// Heartbeats go out this far apart at least \[ns\].
const INTERVAL_NANOS: u64 = 100_000_000;
/// Pauses before last words in real time, and before they are said again: a router lets go of what comes right behind something else of the
/// same role.
const LAST_AFTER: [Duration; 3] =
    [Duration::from_millis(2), Duration::from_millis(20), Duration::from_millis(80)];

/// Heartbeat and counters of this process: owns what it says of itself.
///
/// Nobody has to listen: a Health that cannot be sent is counted and never an error.
pub struct Pulse {
    health: Health,
    sink: Sink<Health>,
    last_nanos: u64,
    unsent: u64,
    /// Said in earlier epochs.
    before: u64,
    /// State of the gate that was shown last, and why it had stopped.
    gate: Option<(GateState, Reason)>,
}

impl Pulse {
    /// Opens the link. The phase is [`Phase::Starting`], and nothing is said yet.
    ///
    /// # Errors
    /// [`OpenError`] if there is no place on the link.
    pub fn new(ports: &Ports, participant: Participant) -> Result<Self, OpenError> {
        let mut health = Health::zeroed();
        health.participant = participant.code();
        health.phase = Phase::Starting.code();
        health.pid = std::process::id();
        Ok(Self { health, sink: ports.sink()?, last_nanos: 0, unsent: 0, before: 0, gate: None })
    }

    /// The same, of a graph to which strangers can do this.
    #[must_use]
    pub fn exposed(mut self, exposure: Exposure) -> Self {
        self.health.exposure = exposure.code();
        self
    }

    /// What will be said next time.
    pub fn health(&mut self) -> &mut Health {
        &mut self.health
    }

    /// Changes the phase, and says so at once. Says nothing if it is the phase already.
    pub fn phase(&mut self, phase: Phase) {
        if self.health.phase != phase.code() {
            self.health.phase = phase.code();
            self.send_now();
        }
    }

    /// Shows as an error that the gate lets no command through, and takes it back when it does again.
    /// Does not allocate.
    pub fn show_gate(&mut self, state: GateState, stop: Reason) {
        let before = self.gate.replace((state, stop));
        if before == Some((state, stop)) {
            return;
        }
        let is_shut = |state| matches!(state, GateState::Disarmed | GateState::Stopped);
        if is_shut(state) {
            self.health.set_last_error(shut_text(state, stop));
        } else if before.is_some_and(|(before, _)| is_shut(before)) {
            self.health.set_last_error("");
        }
    }

    /// Counts one more round of the loop, and says so if it is time. Does not allocate, wait or fail.
    pub fn beat(&mut self) {
        self.health.heartbeat += 1;
        if monotonic_nanos().saturating_sub(self.last_nanos) >= INTERVAL_NANOS {
            self.send_now();
        }
    }

    /// Says it now.
    pub fn send_now(&mut self) {
        self.last_nanos = monotonic_nanos();
        lifeline::beat(self.health.phase);
        self.health.sent[Topic::Health.index()] = self.sink.sent() - self.before + 1;
        self.health.dropped[Topic::Health.index()] = self.sink.dropped();
        if self.sink.send(&mut self.health).is_err() {
            self.unsent += 1;
        }
    }

    /// Says in which phase this process ends, in real time again, and once more: nobody is there afterwards to repeat it, and others end by it. That
    /// takes a tenth of a second.
    pub fn last_words(&mut self, phase: Phase, pace: Pace) {
        self.health.phase = phase.code();
        let pauses: &[Duration] =
            if pace == Pace::RealTime { &LAST_AFTER } else { &[Duration::ZERO] };
        for pause in pauses {
            thread::sleep(*pause);
            self.send_now();
        }
    }

    /// Speaks in another epoch from now on.
    pub fn set_epoch(&mut self, epoch: u64) {
        self.before = self.sink.sent();
        self.sink.set_epoch(epoch);
    }

    /// Takes over what a writer has counted.
    pub fn count_sink<T: OnTopic>(&mut self, sink: &Sink<T>) {
        let index = T::TOPIC.index();
        self.health.sent[index] = sink.sent();
        self.health.dropped[index] = sink.dropped();
    }

    /// Takes over what a reader of `topic` has counted.
    pub fn count_source(&mut self, topic: Topic, tally: Tally) {
        let index = topic.index();
        self.health.received[index] = tally.received;
        self.health.lost[index] = tally.lost;
        self.health.refused[index] = tally.refused;
    }

    /// Times that nobody could be told.
    pub fn unsent(&self) -> u64 {
        self.unsent
    }
}

/// Why no command drives, and what ends that.
fn shut_text(state: GateState, stop: Reason) -> &'static str {
    match (state, stop) {
        (GateState::Disarmed, _) => "the gate is disarmed: `coxswain arm` lets the robot drive",
        (_, Reason::PositionError) => {
            "stopped: position error above limits.tracking_error_m; `coxswain resume` lets it drive"
        }
        (_, Reason::HeadingError) => {
            "stopped: heading error above limits.tracking_error_heading_rad; `coxswain resume` lets it drive"
        }
        (_, Reason::BadState) => {
            "stopped: the robot's own measurement is not finite; `coxswain resume` lets it drive"
        }
        (_, Reason::EmergencyStop) => {
            "stopped: emergency stop pressed; release it, then `coxswain resume` lets it drive"
        }
        _ => "stopped; `coxswain resume` lets the robot drive",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::message::{Command, ModelSnapshot, SnapshotHead};
    use protocol::port::{Carrier, Carriers, Exchange, Identity, Links, Router, Since, Source};
    use std::error::Error;
    use std::time::Duration;

    fn pair() -> Result<(Pulse, Source<Health>), OpenError> {
        let exchange = Exchange::new(false, Duration::from_secs(1));
        let ports = Ports::in_memory(&exchange, Identity::new(4));
        let source = ports.source(Since::First)?;
        Ok((Pulse::new(&ports, Participant::Learner)?, source))
    }

    #[test]
    fn a_new_phase_is_said_at_once_and_only_once() -> Result<(), Box<dyn Error>> {
        let (mut pulse, mut source) = pair()?;
        pulse.phase(Phase::Ready);
        pulse.phase(Phase::Ready);
        let health = source.next()?.ok_or("nothing was said")?;
        assert_eq!(
            (health.participant(), health.phase()),
            (Some(Participant::Learner), Phase::Ready)
        );
        assert_eq!((health.pid, health.stamp.epoch), (std::process::id(), 4));
        assert!(source.next()?.is_none());
        Ok(())
    }

    #[test]
    fn every_stop_has_a_text_that_fits_and_is_taken_back() -> Result<(), Box<dyn Error>> {
        let (mut pulse, _source) = pair()?;
        for &reason in Reason::ALL {
            for state in [GateState::Stopped, GateState::Disarmed] {
                let text = shut_text(state, reason);
                assert!(text.len() <= protocol::message::ERROR_TEXT_MAX, "{text}");
                pulse.show_gate(state, reason);
                assert_eq!(pulse.health().last_error(), text);
            }
            pulse.show_gate(GateState::Armed, Reason::None);
            assert_eq!(pulse.health().last_error(), "");
        }
        pulse.health().set_last_error("another");
        pulse.show_gate(GateState::Driving, Reason::None);
        assert_eq!(pulse.health().last_error(), "another");
        Ok(())
    }

    #[test]
    fn last_words_are_said_again_in_real_time() -> Result<(), Box<dyn Error>> {
        for (pace, times) in [(Pace::RealTime, 3), (Pace::LockStep, 1)] {
            let (mut pulse, mut source) = pair()?;
            pulse.last_words(Phase::Finished, pace);
            for time in 0..times {
                let health = source.next()?.ok_or_else(|| format!("said {time} times"))?;
                assert_eq!(health.phase(), Phase::Finished);
            }
            assert!(source.next()?.is_none());
        }
        Ok(())
    }

    #[test]
    fn a_fast_loop_does_not_talk_all_the_time() -> Result<(), Box<dyn Error>> {
        let (mut pulse, mut source) = pair()?;
        let begin = monotonic_nanos();
        for _ in 0..1000 {
            pulse.beat();
        }
        let most = 1 + monotonic_nanos().saturating_sub(begin) / INTERVAL_NANOS;
        let health = source.latest()?.ok_or("nothing was said")?;
        assert!(source.tally().received <= most, "{} in {most} intervals", source.tally().received);
        assert!(health.heartbeat >= 1);
        Ok(())
    }

    #[test]
    fn counters_land_at_their_topic() -> Result<(), Box<dyn Error>> {
        let (mut pulse, mut source) = pair()?;
        let ports =
            Ports::in_memory(&Exchange::new(false, Duration::from_secs(1)), Identity::new(4));
        let mut commands = ports.sink::<Command>()?;
        for _ in 0..7 {
            commands.send(&mut Command::zeroed())?;
        }
        pulse.count_sink(&commands);
        pulse.count_source(Topic::State, Tally { received: 9, lost: 2, refused: 1, stale: 0 });
        pulse.send_now();
        let health = source.next()?.ok_or("nothing was said")?;
        assert_eq!(health.sent[Topic::Command.index()], 7);
        assert_eq!(health.sent[Topic::Health.index()], 1);
        let state = Topic::State.index();
        assert_eq!((health.received[state], health.lost[state], health.refused[state]), (9, 2, 1));
        Ok(())
    }

    #[test]
    fn what_gave_way_before_the_network_is_said() -> Result<(), Box<dyn Error>> {
        let (mut pulse, mut source) = pair()?;
        let router = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[])?;
        let (carriers, connect) = (Carriers::all(Carrier::Network), router.endpoints().to_vec());
        let links = Links { carriers, connect, ..Links::on_this_machine("pulse", "", false, 1000) };
        let mut snapshots = Ports::open(&links, Identity::new(1))?.sink::<ModelSnapshot>()?;
        let mut snapshot = ModelSnapshot::new(SnapshotHead { inputs: 6, ..SnapshotHead::zeroed() });
        for _ in 0..1000 {
            snapshot.push(&[0.0; 6], [0.0; 3], [0.0; 3])?;
        }
        // A queue for eight of a hundred kilobytes is full sooner than the network has taken one.
        while snapshots.dropped() == 0 {
            snapshots.send(&mut snapshot)?;
        }
        pulse.count_sink(&snapshots);
        pulse.send_now();
        let health = source.next()?.ok_or("nothing was said")?;
        let index = Topic::Snapshot.index();
        assert_eq!(
            (health.sent[index], health.dropped[index]),
            (snapshots.sent(), snapshots.dropped())
        );
        Ok(())
    }
}
