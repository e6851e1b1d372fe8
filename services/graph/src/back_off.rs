//! When to restart a process that has ended.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Failures older than this do not count.
const WINDOW: Duration = Duration::from_mins(1);

/// Limits of the restarts of one process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RestartPolicy {
    /// Largest number of restarts within a minute.
    pub per_minute: u32,
    /// Wait before the second restart within a minute. The first has no wait, and each further wait
    /// is twice the one before.
    pub second: Duration,
    /// Longest wait.
    pub longest: Duration,
}

/// The restarts of one process.
#[derive(Debug, Clone, Default)]
pub struct Restarts {
    within_window: VecDeque<Instant>,
    total: u64,
}

impl Restarts {
    /// Wait before the restart after a failure at `now`; none if there were too many.
    pub fn after_death(&mut self, policy: &RestartPolicy, now: Instant) -> Option<Duration> {
        while self
            .within_window
            .front()
            .is_some_and(|&time| now.saturating_duration_since(time) >= WINDOW)
        {
            self.within_window.pop_front();
        }
        let before = u32::try_from(self.within_window.len()).unwrap_or(u32::MAX);
        if before >= policy.per_minute {
            return None;
        }
        self.within_window.push_back(now);
        self.total += 1;
        Some(delay(policy, before))
    }

    /// Total number.
    pub fn total(&self) -> u64 {
        self.total
    }
}

/// Wait before a restart, if `before` others came before it within the minute.
fn delay(policy: &RestartPolicy, before: u32) -> Duration {
    let Some(doublings) = before.checked_sub(1) else { return Duration::ZERO };
    let factor = 2_u32.checked_pow(doublings).unwrap_or(u32::MAX);
    policy.second.saturating_mul(factor).min(policy.longest)
}

#[cfg(test)]
mod tests {
    use super::*;

    const POLICY: RestartPolicy = RestartPolicy {
        per_minute: 8,
        second: Duration::from_millis(100),
        longest: Duration::from_secs(2),
    };

    #[test]
    fn the_first_restart_is_immediate_then_the_wait_doubles_up_to_the_longest() {
        let mut restarts = Restarts::default();
        let now = Instant::now();
        let waits: Vec<Option<u128>> = (0..8)
            .map(|_| restarts.after_death(&POLICY, now).map(|wait| wait.as_millis()))
            .collect();
        let expected = [0, 100, 200, 400, 800, 1600, 2000, 2000].map(Some);
        assert_eq!(waits, expected);
    }

    #[test]
    fn too_many_failures_in_a_minute_end_the_restarts() {
        let mut restarts = Restarts::default();
        let now = Instant::now();
        for _ in 0..POLICY.per_minute {
            assert!(restarts.after_death(&POLICY, now).is_some());
        }
        assert_eq!(restarts.after_death(&POLICY, now), None);
        assert_eq!(restarts.total(), 8, "a death without a restart is none");
    }

    #[test]
    fn failures_older_than_a_minute_do_not_count() {
        let mut restarts = Restarts::default();
        let now = Instant::now();
        for _ in 0..POLICY.per_minute {
            restarts.after_death(&POLICY, now);
        }
        assert_eq!(restarts.after_death(&POLICY, now + WINDOW), Some(Duration::ZERO));
    }

    #[test]
    fn no_policy_overflows() {
        let policy = RestartPolicy {
            per_minute: u32::MAX,
            second: Duration::MAX,
            longest: Duration::from_secs(2),
        };
        assert_eq!(delay(&policy, 4_000_000_000), policy.longest);
    }
}
