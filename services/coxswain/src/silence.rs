//! Who says nothing for too long, and whom nobody hears.

use std::time::Duration;

/// How long one that is started again may say nothing.
const STARTS_WITHIN: Duration = Duration::from_secs(10);

/// Most that one round counts as silence.
const ROUND_MOST: Duration = Duration::from_millis(40);

/// How long somebody has said nothing, in rounds of the launcher: one that is kept from running itself accuses nobody.
#[derive(Debug, Default)]
pub(crate) struct Silence {
    /// Heartbeats heard by now.
    beats: u64,
    lasted: Duration,
    /// It was killed for it, and dies as soon as the system lets it.
    punished: bool,
}

impl Silence {
    /// How long it lasts, once that is longer than `patience`: once, since nobody is killed twice. Before the first word it may last as long as
    /// a start may take, but not of one that is `stopped`: that does not start.
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

/// So many heartbeats in a row that nobody hears are too many: those of ten seconds.
const UNHEARD_MOST: u64 = 100;

/// How long somebody whose loop turns has not been heard on the graph's links: each heartbeat goes out there as well, as a Health.
#[derive(Debug, Default)]
pub(crate) struct Unheard {
    /// Health of its role heard by now, of whichever process.
    heard: u64,
    /// Heartbeats by now.
    beats: u64,
    /// Rounds since it was heard in which there was a heartbeat: a launcher that was away finds many at once, before it has heard anything.
    rounds: u64,
    told: bool,
}

impl Unheard {
    /// How many heartbeats in a row nobody heard, once that are too many: once, until it is heard again.
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
    fn who_turns_but_is_not_heard_is_told_of_once() {
        let told = |heard: &dyn Fn(u64) -> u64| {
            let mut unheard = Unheard::default();
            (1..=1_000).filter_map(|beats| unheard.since(beats, heard(beats))).collect::<Vec<_>>()
        };
        assert!(told(&|beats| beats).is_empty());
        assert!(told(&|beats| beats / 100).is_empty(), "one in a hundred is enough");
        assert_eq!(told(&|_| 0), [101]);
        assert_eq!(told(&|beats| beats.min(500)), [101]);
        assert_eq!(told(&|beats| beats / 500), [101, 101], "each time anew");
        let mut away = Unheard::default();
        assert_eq!(
            (away.since(50, 50), away.since(500, 50), away.since(501, 499)),
            (None, None, None),
            "the launcher was stopped"
        );
    }

    const ROUND: Duration = Duration::from_millis(20);
    const PATIENCE: Duration = Duration::from_millis(400);

    /// Rounds until the silence is broken, if it is within 20 s.
    fn rounds(silence: &mut Silence, beats: u64, stopped: bool) -> Option<u32> {
        (1..1000).find(|_| silence.broken_by(beats, ROUND, PATIENCE, || stopped).is_some())
    }

    #[test]
    fn one_that_starts_may_be_silent_for_longer_unless_it_is_stopped() {
        assert_eq!(rounds(&mut Silence::default(), 0, false), Some(501));
        assert_eq!(rounds(&mut Silence::default(), 0, true), Some(21));
        let mut silence = Silence::default();
        assert_eq!(silence.broken_by(1, ROUND, PATIENCE, || false), None);
        assert_eq!(rounds(&mut silence, 1, false), Some(21));
    }

    #[test]
    fn nobody_is_killed_twice_for_one_silence() {
        let mut silence = Silence::default();
        assert_eq!(rounds(&mut silence, 0, true), Some(21));
        assert_eq!(rounds(&mut silence, 0, true), None, "the system takes its time to let it die");
    }
}
