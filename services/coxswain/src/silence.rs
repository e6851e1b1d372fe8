//! Detects processes without heartbeats, and heartbeats that do not arrive on the links.

use std::time::Duration;

/// Longest time without a heartbeat for a process that is restarted.
const STARTS_WITHIN: Duration = Duration::from_secs(10);

/// Largest contribution of one round to the time without a heartbeat.
const ROUND_MOST: Duration = Duration::from_millis(40);

/// Time without a heartbeat of one process, in rounds of the launcher. A launcher that did not run
/// itself does not count that time.
#[derive(Debug, Default)]
pub(crate) struct Silence {
    /// Number of heartbeats so far.
    beats: u64,
    lasted: Duration,
    /// Whether it was killed for this, and has not ended yet.
    punished: bool,
}

impl Silence {
    /// Time without a heartbeat, once it is longer than `patience`. Returned only once, so that no
    /// process is killed twice. Before the first heartbeat the limit is the time of a start. For a
    /// `stopped` process the limit stays `patience`, because it does not start.
    pub(crate) fn broken_by(
        &mut self,
        beats: u64,
        round: Duration,
        patience: Duration,
        stopped: impl FnOnce() -> bool,
    ) -> Option<Duration> {
        if beats != self.beats {
            *self = Self { beats, lasted: Duration::ZERO, punished: self.punished };
            return None;
        }
        self.lasted += round.min(ROUND_MOST);
        let broken = !self.punished
            && self.lasted > patience
            && (self.beats > 0 || self.lasted > STARTS_WITHIN || stopped());
        self.punished |= broken;
        broken.then_some(self.lasted)
    }
}

/// Limit of heartbeats in sequence without a received one: those of ten seconds.
const UNHEARD_MOST: u64 = 100;

/// Number of heartbeats of a running loop that did not arrive on the graph's links. The process
/// publishes each heartbeat there as well, as a Health.
#[derive(Debug, Default)]
pub(crate) struct Unheard {
    /// Number of received Health messages of its role, from any process.
    heard: u64,
    /// Number of heartbeats so far.
    beats: u64,
    /// Rounds with a heartbeat since the last Health. A launcher that did not run finds many
    /// heartbeats at once, before it has received any Health.
    rounds: u64,
    told: bool,
}

impl Unheard {
    /// Number of heartbeats in sequence that did not arrive, once it is above the limit. Returned
    /// only once, until the next Health arrives.
    pub(crate) fn since(&mut self, beats: u64, heard: u64) -> Option<u64> {
        if heard != self.heard {
            *self = Self { heard, beats, ..Self::default() };
        }
        self.rounds += u64::from(beats != self.beats);
        self.beats = beats;
        let is_news = !self.told && self.rounds > UNHEARD_MOST;
        self.told |= is_news;
        is_news.then_some(self.rounds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_running_loop_without_received_heartbeats_is_reported_once() {
        let reported = |heard: &dyn Fn(u64) -> u64| {
            let mut unheard = Unheard::default();
            (1..=1_000).filter_map(|beats| unheard.since(beats, heard(beats))).collect::<Vec<_>>()
        };
        assert!(reported(&|beats| beats).is_empty());
        assert!(reported(&|beats| beats / 100).is_empty(), "one in a hundred is enough");
        assert_eq!(reported(&|_| 0), [101]);
        assert_eq!(reported(&|beats| beats.min(500)), [101]);
        assert_eq!(reported(&|beats| beats / 500), [101, 101], "each time anew");
        let mut away = Unheard::default();
        assert_eq!(
            (away.since(50, 50), away.since(500, 50), away.since(501, 499)),
            (None, None, None),
            "the launcher was stopped"
        );
    }

    const ROUND: Duration = Duration::from_millis(20);
    const PATIENCE: Duration = Duration::from_millis(400);

    /// Rounds until the process counts as silent, if that is within 20 s.
    fn rounds(silence: &mut Silence, beats: u64, stopped: bool) -> Option<u32> {
        (1..1000).find(|_| silence.broken_by(beats, ROUND, PATIENCE, || stopped).is_some())
    }

    #[test]
    fn a_starting_process_has_a_longer_limit_unless_it_is_stopped() {
        assert_eq!(rounds(&mut Silence::default(), 0, false), Some(501));
        assert_eq!(rounds(&mut Silence::default(), 0, true), Some(21));
        let mut silence = Silence::default();
        assert_eq!(silence.broken_by(1, ROUND, PATIENCE, || false), None);
        assert_eq!(rounds(&mut silence, 1, false), Some(21));
    }

    #[test]
    fn no_process_is_killed_twice_for_one_silence() {
        let mut silence = Silence::default();
        assert_eq!(rounds(&mut silence, 0, true), Some(21));
        assert_eq!(rounds(&mut silence, 0, true), None, "the system takes its time to let it die");
    }
}
