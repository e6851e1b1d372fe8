//! Who says nothing for too long.

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
        let broken = !self.punished && self.lasted > patience && (self.beats > 0 || self.lasted > STARTS_WITHIN || stopped());
        self.punished |= broken;
        broken.then_some(self.lasted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
