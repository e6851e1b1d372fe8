//! Whether the robot is there: when its last state came, and when it counts as lost.

use std::time::{Duration, Instant};

/// Time without a state after which the robot counts as lost, unless its period is longer.
const SILENCE: Duration = Duration::from_secs(1);

/// Presence of one robot. It is awaited until its first state.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Presence {
    /// Time of the last state.
    last: Option<Instant>,
    silence: Duration,
    lost: bool,
}

impl Default for Presence {
    fn default() -> Self {
        Self { last: None, silence: SILENCE, lost: false }
    }
}

impl Presence {
    /// A robot that counts as lost unless a state comes soon after `now`.
    pub(crate) fn expected(now: Instant) -> Self {
        Self { last: Some(now), ..Self::default() }
    }

    /// A state has come, of a robot with this period \[ns\]. Returns whether the robot was lost.
    pub(crate) fn receive(&mut self, now: Instant, period_nanos: u64) -> bool {
        self.last = Some(now);
        self.silence = SILENCE.max(Duration::from_nanos(period_nanos).saturating_mul(3));
        std::mem::take(&mut self.lost)
    }

    /// Whether it was lost since the last call.
    pub(crate) fn falls_silent(&mut self, now: Instant) -> bool {
        let lost = self.silent_for(now).is_some_and(|silent| silent > self.silence);
        !std::mem::replace(&mut self.lost, lost) && lost
    }

    /// Whether it is lost.
    pub(crate) fn is_lost(&self) -> bool {
        self.lost
    }

    /// Time since the last state; none while it is awaited.
    pub(crate) fn silent_for(&self, now: Instant) -> Option<Duration> {
        self.last.map(|last| now.saturating_duration_since(last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NANOS: u64 = 100_000_000;

    #[test]
    fn loss_and_return_are_reported_once() {
        let begin = Instant::now();
        let after = |seconds| begin + Duration::from_secs(seconds);
        let mut presence = Presence::expected(begin);
        assert!(!presence.falls_silent(after(1)));
        assert!(presence.falls_silent(after(2)) && !presence.falls_silent(after(3)));
        assert!(presence.receive(after(4), PERIOD_NANOS));
        assert!(!presence.receive(after(5), PERIOD_NANOS));
        assert!(presence.falls_silent(after(7)) && presence.is_lost());
    }

    #[test]
    fn a_robot_is_awaited_before_its_first_state() {
        let mut presence = Presence::default();
        assert!(!presence.falls_silent(Instant::now() + Duration::from_secs(9)));
        assert_eq!(presence.silent_for(Instant::now()), None);
    }
}
