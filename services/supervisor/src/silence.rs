//! Detects processes without heartbeats.

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

#[cfg(test)]
mod tests {
    use super::*;

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
