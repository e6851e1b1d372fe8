//! process → all subscribers: the heartbeat of one process; and on a line of its own → its
//! launcher.

use crate::{Pace, lifeline};
use bytemuck::Zeroable;
use protocol::clock::monotonic_nanos;
use protocol::message::{Exposure, GateState, Health, Participant, Phase, Reason};
use protocol::topic::{OnTopic, Topic};
use std::thread;
use std::time::Duration;
use transport::{OpenError, Ports, Sink, Tally};

/// Shortest interval between two heartbeats \[ns\].
const INTERVAL_NANOS: u64 = 100_000_000;
/// Pauses before the last heartbeat in real time, and before its repetitions. A link to another
/// host may drop one of them.
const LAST_AFTER: [Duration; 3] =
    [Duration::from_millis(2), Duration::from_millis(20), Duration::from_millis(80)];

/// Heartbeat and counters of this process: the content of its Health.
///
/// No subscriber is required. A Health that cannot be sent is counted, and is never an error.
pub struct Pulse {
    health: Health,
    sink: Sink<Health>,
    last_nanos: u64,
    unsent: u64,
    /// Number sent in earlier epochs.
    before: u64,
    /// Last state of the gate that was shown, and the reason of its stop.
    gate: Option<(GateState, Reason)>,
}

impl Pulse {
    /// Opens the link. The phase is [`Phase::Starting`], and nothing is sent yet.
    ///
    /// # Errors
    /// [`OpenError`] if the link cannot be opened.
    pub fn new(ports: &Ports, participant: Participant) -> Result<Self, OpenError> {
        let mut health = Health::zeroed();
        health.participant = participant.code();
        health.phase = Phase::Starting.code();
        health.pid = std::process::id();
        Ok(Self { health, sink: ports.sink()?, last_nanos: 0, unsent: 0, before: 0, gate: None })
    }

    /// The same, for a graph that is exposed to unauthenticated peers in this way.
    #[must_use]
    pub fn exposed(mut self, exposure: Exposure) -> Self {
        self.health.exposure = exposure.code();
        self
    }

    /// Content of the next heartbeat.
    pub fn health(&mut self) -> &mut Health {
        &mut self.health
    }

    /// Changes the phase, and sends it at once. Sends nothing if the phase is the same.
    pub fn phase(&mut self, phase: Phase) {
        if self.health.phase != phase.code() {
            self.health.phase = phase.code();
            self.send_now();
        }
    }

    /// Reports as an error that the gate accepts no command, and clears the error when it accepts
    /// commands again. Does not allocate.
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

    /// Counts one more iteration of the loop, and sends a heartbeat if it is due. Does not
    /// allocate, wait or fail.
    pub fn beat(&mut self) {
        self.health.heartbeat += 1;
        if monotonic_nanos().saturating_sub(self.last_nanos) >= INTERVAL_NANOS {
            self.send_now();
        }
    }

    /// Sends a heartbeat now.
    pub fn send_now(&mut self) {
        self.last_nanos = monotonic_nanos();
        lifeline::beat(self.health.phase);
        self.health.sent[Topic::Health.index()] = self.sink.sent() - self.before + 1;
        if self.sink.send(&mut self.health).is_err() {
            self.unsent += 1;
        }
    }

    /// Sends the phase in which this process ends. In real time it repeats that, because other
    /// processes end by it and no later heartbeat follows. This takes a tenth of a second.
    pub fn last_words(&mut self, phase: Phase, pace: Pace) {
        self.health.phase = phase.code();
        let pauses: &[Duration] =
            if pace == Pace::RealTime { &LAST_AFTER } else { &[Duration::ZERO] };
        for pause in pauses {
            thread::sleep(*pause);
            self.send_now();
        }
    }

    /// Publishes in another epoch from now on.
    pub fn set_epoch(&mut self, epoch: u64) {
        self.before = self.sink.sent();
        self.sink.set_epoch(epoch);
    }

    /// Copies the counters of a writer.
    pub fn count_sink<T: OnTopic>(&mut self, sink: &Sink<T>) {
        self.health.sent[T::TOPIC.index()] = sink.sent();
    }

    /// Copies the counters of a reader of `topic`.
    pub fn count_source(&mut self, topic: Topic, tally: Tally) {
        let index = topic.index();
        self.health.received[index] = tally.received;
        self.health.lost[index] = tally.lost;
        self.health.refused[index] = tally.refused;
    }

    /// Number of heartbeats that could not be sent.
    pub fn unsent(&self) -> u64 {
        self.unsent
    }
}

/// Why no command drives the robot, and the command that ends it.
fn shut_text(state: GateState, stop: Reason) -> &'static str {
    match (state, stop) {
        (GateState::Disarmed, _) => "the gate is disarmed: `coxswain arm` lets the robot drive",
        (_, Reason::PositionError) => {
            "stopped: position error above limits.tracking_error_m; run `coxswain resume`"
        }
        (_, Reason::HeadingError) => {
            "stopped: heading error above limits.tracking_error_heading_rad; run `coxswain resume`"
        }
        (_, Reason::BadState) => {
            "stopped: the robot's own measurement is not finite; run `coxswain resume`"
        }
        (_, Reason::EmergencyStop) => {
            "stopped: emergency stop pressed; release it, then run `coxswain resume`"
        }
        (_, Reason::OperatorStop) => "stopped by an operator; run `coxswain resume`",
        _ => "stopped; run `coxswain resume`",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::message::Command;
    use std::error::Error;
    use std::time::Duration;
    use transport::{Exchange, Identity, Since, Source};

    fn pair() -> Result<(Pulse, Source<Health>), OpenError> {
        let exchange = Exchange::new(false, Duration::from_secs(1));
        let ports = Ports::in_memory(&exchange, Identity::new(4));
        let source = ports.source(Since::First)?;
        Ok((Pulse::new(&ports, Participant::Learner)?, source))
    }

    #[test]
    fn a_new_phase_is_sent_at_once_and_only_once() -> Result<(), Box<dyn Error>> {
        let (mut pulse, mut source) = pair()?;
        pulse.phase(Phase::Ready);
        pulse.phase(Phase::Ready);
        let health = source.next()?.ok_or("nothing was sent")?;
        assert_eq!(
            (health.participant(), health.phase()),
            (Some(Participant::Learner), Phase::Ready)
        );
        assert_eq!((health.pid, health.stamp.epoch), (std::process::id(), 4));
        assert!(source.next()?.is_none());
        Ok(())
    }

    #[test]
    fn every_stop_has_a_text_that_fits_and_is_cleared() -> Result<(), Box<dyn Error>> {
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
    fn the_last_heartbeat_is_repeated_in_real_time() -> Result<(), Box<dyn Error>> {
        for (pace, times) in [(Pace::RealTime, 3), (Pace::LockStep, 1)] {
            let (mut pulse, mut source) = pair()?;
            pulse.last_words(Phase::Finished, pace);
            for time in 0..times {
                let health = source.next()?.ok_or_else(|| format!("sent {time} times"))?;
                assert_eq!(health.phase(), Phase::Finished);
            }
            assert!(source.next()?.is_none());
        }
        Ok(())
    }

    #[test]
    fn a_fast_loop_sends_at_most_one_heartbeat_per_interval() -> Result<(), Box<dyn Error>> {
        let (mut pulse, mut source) = pair()?;
        let begin = monotonic_nanos();
        for _ in 0..1000 {
            pulse.beat();
        }
        let most = 1 + monotonic_nanos().saturating_sub(begin) / INTERVAL_NANOS;
        let health = source.latest()?.ok_or("nothing was sent")?;
        assert!(source.tally().received <= most, "{} in {most} intervals", source.tally().received);
        assert!(health.heartbeat >= 1);
        Ok(())
    }

    #[test]
    fn counters_are_reported_with_their_topic() -> Result<(), Box<dyn Error>> {
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
        let health = source.next()?.ok_or("nothing was sent")?;
        assert_eq!(health.sent[Topic::Command.index()], 7);
        assert_eq!(health.sent[Topic::Health.index()], 1);
        let state = Topic::State.index();
        assert_eq!((health.received[state], health.lost[state], health.refused[state]), (9, 2, 1));
        Ok(())
    }
}
