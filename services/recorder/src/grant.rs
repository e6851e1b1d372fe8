//! state → Credit: the tick up to which the plant's clock may run ahead of the record.

use process::{Pace, Pulse};
use protocol::message::{Credit, Participant, Stamp};
use std::time::{Duration, Instant};
use transport::{OpenError, Ports, SendError, Sink};

/// Largest lead of the plant over the record \[ticks\]. It is below the depth of every topic with
/// one message per tick, so that all messages in between have room.
pub(crate) const WINDOW_TICKS: u64 = 32;

/// Number of ticks between two grants \[ticks\]. A grant per tick would wake the plant for nothing.
const STRIDE_TICKS: u64 = WINDOW_TICKS / 4;

/// Silence of the plant after which the last grant is sent again, since it may be lost.
const SILENCE: Duration = Duration::from_secs(1);

/// Grants credit to the plant, in lock step; in real time it grants nothing.
pub(crate) struct Grant {
    sink: Option<Sink<Credit>>,
    reach: Reach,
    /// The last grant, and the time of the last grant or state.
    last: Option<Credit>,
    received: Instant,
}

impl Grant {
    /// Grants the first ticks.
    ///
    /// # Errors
    /// [`OpenError`].
    pub(crate) fn open(ports: &Ports, pace: Pace) -> Result<Self, OpenError> {
        let sink = match pace {
            Pace::RealTime => None,
            Pace::LockStep => Some(ports.sink()?),
        };
        Ok(Self { sink, reach: Reach::default(), last: None, received: Instant::now() })
    }

    /// Notes that the plant of `epoch` has reached `tick`, and that its state is written.
    pub(crate) fn note_state(&mut self, epoch: u64, tick: u64) {
        self.reach.note(epoch, tick);
        self.received = Instant::now();
    }

    /// Notes the same by a Health: a plant that sends nothing else may be waiting for its credit.
    pub(crate) fn note_health(&mut self, epoch: u64, tick: u64) {
        self.reach.note(epoch, tick);
    }

    /// Grants more ticks if enough were written since the last grant, or if that grant could not be
    /// sent.
    ///
    /// # Errors
    /// [`SendError`].
    pub(crate) fn extend(&mut self) -> Result<(), SendError> {
        let Some(sink) = &mut self.sink else { return Ok(()) };
        let Some(through_tick) = self.reach.due() else { return Ok(()) };
        let mut credit = Credit {
            stamp: Stamp::default(),
            through_tick,
            participant: Participant::Recorder.code(),
            reserved: 0,
        };
        let sent = sink.send(&mut credit).inspect_err(|_| self.reach.granted_at = None);
        (self.last, self.received) = (Some(credit), Instant::now());
        sent
    }

    /// Sends the last grant to a plant that has joined since, and repeats it after a silence of the
    /// plant.
    ///
    /// # Errors
    /// [`SendError`].
    pub(crate) fn refresh(&mut self) -> Result<(), SendError> {
        let Some(sink) = &mut self.sink else { return Ok(()) };
        sink.refresh()?;
        match &self.last {
            Some(credit) if self.received.elapsed() > SILENCE => {
                self.received = Instant::now();
                sink.send_stamped(credit)
            }
            _ => Ok(()),
        }
    }

    /// Reports the number of credits sent.
    pub(crate) fn count(&self, pulse: &mut Pulse) {
        if let Some(sink) = &self.sink {
            pulse.count_sink(sink);
        }
    }
}

/// The last written tick, and the last grant.
#[derive(Debug, Default)]
struct Reach {
    epoch: u64,
    written_tick: u64,
    /// `written_tick` at the last grant; `None` if this epoch has had none.
    granted_at: Option<u64>,
}

impl Reach {
    /// A new epoch begins at tick 0, and needs a grant of its own.
    fn note(&mut self, epoch: u64, tick: u64) {
        if epoch > self.epoch {
            *self = Self { epoch, written_tick: tick, granted_at: None };
        } else if epoch == self.epoch {
            self.written_tick = self.written_tick.max(tick);
        }
    }

    /// Last tick to grant now, if a grant is due.
    fn due(&mut self) -> Option<u64> {
        if self.granted_at.is_some_and(|granted_at| self.written_tick < granted_at + STRIDE_TICKS) {
            return None;
        }
        self.granted_at = Some(self.written_tick);
        Some(self.written_tick + WINDOW_TICKS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::topic::Topic;

    #[test]
    fn all_messages_within_a_grant_have_room() {
        // Each process writes one message per period, and the learner at most one snapshot in five.
        for topic in [Topic::State, Topic::Command, Topic::Residual, Topic::Plan, Topic::Truth] {
            assert!(topic.quality(true).depth as u64 > WINDOW_TICKS);
        }
        assert!(Topic::Snapshot.quality(true).depth as u64 > WINDOW_TICKS / 5);
    }

    #[test]
    fn the_first_grant_needs_no_state() {
        let mut reach = Reach::default();
        assert_eq!(reach.due(), Some(WINDOW_TICKS));
        assert_eq!(reach.due(), None);
    }

    #[test]
    fn a_plant_at_the_end_of_its_grant_always_gets_another() {
        let mut reach = Reach::default();
        let mut granted = reach.due();
        for _ in 0..10 {
            let end = granted.unwrap_or(0);
            reach.note(1, end);
            granted = reach.due();
            assert_eq!(granted, Some(end + WINDOW_TICKS));
        }
    }

    #[test]
    fn a_new_epoch_of_the_plant_revokes_the_grant_of_the_old_one() {
        let mut reach = Reach::default();
        reach.note(1, 200);
        assert_eq!(reach.due(), Some(200 + WINDOW_TICKS));
        reach.note(2, 0);
        assert_eq!(reach.due(), Some(WINDOW_TICKS));
        reach.note(1, 201);
        assert_eq!(reach.due(), None, "a late word of the old epoch");
    }
}
