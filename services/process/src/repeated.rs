//! Events that may repeat without end → one line in the log per kind, then a line with their number
//! at most every 10 s.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Shortest time between two lines of the same kind.
const PAUSE: Duration = Duration::from_secs(10);

/// Kind of event → number of events, and the time of its last line.
#[derive(Debug)]
pub struct Repeated<K>(BTreeMap<K, Events>);

impl<K> Default for Repeated<K> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

#[derive(Debug, Default)]
struct Events {
    /// Number since the last line.
    unlogged: u64,
    logged: Option<Instant>,
}

impl<K: Ord + Clone> Repeated<K> {
    /// Counts `count` events of one kind.
    pub fn note(&mut self, kind: K, count: u64) {
        self.0.entry(kind).or_default().unlogged += count;
    }

    /// The kinds whose line is due, each with its number since the last line: at once, and then at
    /// most every ten seconds.
    pub fn due(&mut self, now: Instant) -> Vec<(K, u64)> {
        self.take(now, |events| {
            events.logged.is_none_or(|logged| now.saturating_duration_since(logged) >= PAUSE)
        })
    }

    /// All kinds without a line, independent of the time of the last one: for the end.
    pub fn rest(&mut self) -> Vec<(K, u64)> {
        self.take(Instant::now(), |_| true)
    }

    fn take(&mut self, now: Instant, is_time: impl Fn(&Events) -> bool) -> Vec<(K, u64)> {
        let is_due = |events: &Events| events.unlogged > 0 && is_time(events);
        let due = self.0.iter_mut().filter(|(_, events)| is_due(events));
        due.map(|(kind, events)| {
            events.logged = Some(now);
            (kind.clone(), std::mem::take(&mut events.unlogged))
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_events_is_one_line_every_ten_seconds() {
        let (mut events, begin) = (Repeated::default(), Instant::now());
        let mut lines = Vec::new();
        for hundredth in 0..2_500 {
            events.note("malformed", 1);
            lines.extend(events.due(begin + Duration::from_millis(10 * hundredth)));
        }
        let counts: Vec<u64> = lines.iter().map(|(_, count)| *count).collect();
        assert_eq!(counts, [1, 1000, 1000]);
        assert_eq!(events.due(begin + Duration::from_mins(1)), [("malformed", 499)]);
        assert_eq!(events.due(begin + Duration::from_secs(90)), []);
        events.note("malformed", 1);
        assert_eq!(
            (events.due(begin + Duration::from_secs(61)), events.rest().len(), events.rest().len()),
            (Vec::new(), 1, 0)
        );
    }
}
