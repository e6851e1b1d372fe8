//! topic → watchers: the newest message, at a limited rate.

use crate::run::GatewayError;
use crate::settings::Rates;
use network::telemetry::Publisher;
use protocol::topic::OnTopic;
use std::time::{Duration, Instant};
use transport::{OpenError, Ports, ReceiveError, Source, Tally};

/// The relay of one topic to the watchers.
pub(crate) struct TopicRelay<T> {
    pub(crate) source: Source<T>,
    turn: Turn,
}

impl<T: OnTopic> TopicRelay<T> {
    /// Subscribes to the topic of `T` passively, to relay it at `rate` \[Hz\].
    pub(crate) fn open(ports: &Ports, rate: f64) -> Result<Self, OpenError> {
        Ok(Self { source: ports.watcher()?, turn: Turn::new(Rates::interval(rate)) })
    }

    /// Publishes the newest message, if there is one and it is time. Returns the published message.
    pub(crate) fn pass(
        &mut self,
        now: Instant,
        publisher: &mut Publisher,
    ) -> Result<Option<T>, GatewayError> {
        if !self.turn.has_come(now) {
            return Ok(None);
        }
        let message = self.source.latest()?;
        if let Some(message) = &message {
            publisher.publish(message)?;
            self.turn.taken(now);
        }
        Ok(message)
    }

    pub(crate) fn tally(&self) -> Tally {
        self.source.tally()
    }
}

/// The relay of a topic whose messages are of several kinds, such as Health of each process: the
/// newest of each kind is relayed.
pub(crate) struct KindsRelay<T, const KINDS: usize> {
    source: Source<T>,
    turn: Turn,
    kind: fn(&T) -> u32,
    newest: [Option<Box<T>>; KINDS],
}

impl<T: OnTopic, const KINDS: usize> KindsRelay<T, KINDS> {
    /// Subscribes to the topic of `T` passively, to relay each kind at `rate` \[Hz\].
    pub(crate) fn open(ports: &Ports, rate: f64, kind: fn(&T) -> u32) -> Result<Self, OpenError> {
        Ok(Self {
            source: ports.watcher()?,
            turn: Turn::new(Rates::interval(rate)),
            kind,
            newest: std::array::from_fn(|_| None),
        })
    }

    /// Receives all messages, and publishes the newest of each kind if it is time. `shown` receives
    /// each published message.
    pub(crate) fn pass(
        &mut self,
        now: Instant,
        publisher: &mut Publisher,
        mut shown: impl FnMut(&T),
    ) -> Result<(), GatewayError> {
        self.receive()?;
        if !self.turn.has_come(now) || self.newest.iter().all(Option::is_none) {
            return Ok(());
        }
        self.turn.taken(now);
        self.newest.iter_mut().filter_map(Option::take).try_for_each(|message| {
            shown(&message);
            Ok(publisher.publish(&*message)?)
        })
    }

    fn receive(&mut self) -> Result<(), ReceiveError> {
        while let Some(message) = self.source.next()? {
            if let Some(place) = self.newest.get_mut((self.kind)(&message) as usize) {
                *place = Some(Box::new(message));
            }
        }
        Ok(())
    }

    pub(crate) fn tally(&self) -> Tally {
        self.source.tally()
    }
}

/// The time of the next message.
#[derive(Debug)]
struct Turn {
    interval: Option<Duration>,
    next: Option<Instant>,
}

impl Turn {
    fn new(interval: Option<Duration>) -> Self {
        Self { interval, next: None }
    }

    /// A tenth of the interval early counts as in time. Else a topic of exactly that rate would
    /// lose every other message.
    fn has_come(&self, now: Instant) -> bool {
        let Some(interval) = self.interval else { return false };
        self.next.is_none_or(|next| next.saturating_duration_since(now) <= interval / 10)
    }

    /// After an early message the next wait is longer, so that the mean rate is kept.
    fn taken(&mut self, now: Instant) {
        let after = |time: Instant| self.interval.and_then(|interval| time.checked_add(interval));
        self.next = self.next.and_then(after).filter(|&next| next > now).or_else(|| after(now));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(rate: f64, every: Duration, over: Duration) -> usize {
        let (mut turn, begin, mut now) =
            (Turn::new(Rates::interval(rate)), Instant::now(), Duration::ZERO);
        let mut taken = 0;
        while now < over {
            if turn.has_come(begin + now) {
                turn.taken(begin + now);
                taken += 1;
            }
            now += every;
        }
        taken
    }

    #[test]
    fn no_rate_is_exceeded_and_a_topic_of_exactly_that_rate_passes_complete() {
        let (ms, second) = (Duration::from_millis, Duration::from_secs(1));
        assert_eq!(taken(50.0, ms(100), second), 10, "a slow topic passes whole");
        assert_eq!(taken(50.0, ms(20), second), 50);
        assert_eq!(
            taken(50.0, Duration::from_micros(19_900), second),
            50,
            "just faster than the rate"
        );
        assert!((48..=51).contains(&taken(50.0, ms(1), second)));
        assert_eq!(taken(0.0, ms(1), second), 0);
    }
}
