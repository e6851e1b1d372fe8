//! How often one role is heard on a topic that several write: else who floods it displaces what the others say.
//!
//! A topic of one role needs no limit at its readers. Its queue is bounded, the newest displace the oldest, and whoever has the certificate of that
//! role could say all of it anyway. What keeps a router busy is limited there, on all topics.

use super::Network;
use crate::access::Role;
use crate::topic::Topic;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Messages of one role that are heard \[1/s\]: twenty times what processes that are well say.
const PER_SECOND: u32 = 200;
/// How many of them may come at once.
const AT_ONCE: u32 = 64;
/// Time in which there is room for one more.
const INTERVAL: Duration = Duration::from_millis(1_000 / PER_SECOND as u64);
/// Pause between two lines in the log about the same role.
const PAUSE: Duration = Duration::from_secs(10);

/// What each role has said on one topic.
pub(super) struct Rates {
    topic: Topic,
    roles: BTreeMap<Role, Heard>,
}

/// What one role has said.
#[derive(Default)]
struct Heard {
    /// When there is room for as many as may come at once; nothing if there always was.
    empty: Option<Instant>,
    /// Refused since it was last told.
    untold: u64,
    told: Option<Instant>,
}

impl Rates {
    /// Those of `topic`, if roles share it and it is known who says what.
    pub(super) fn on(topic: Topic, network: &Network) -> Option<Self> {
        (network.role.is_some() && Role::share(topic)).then(|| Self { topic, roles: BTreeMap::new() })
    }

    /// Whether what the writer called `id` says `now` is heard. Tells the log, now and then, who says too much.
    pub(super) fn admit(&mut self, id: &str, now: Instant) -> bool {
        // Routers let nobody else pass.
        let Some(role) = id.split_once('.').and_then(|(role, _)| Role::named(role)) else { return false };
        let heard = self.roles.entry(role).or_default();
        let is_heard = heard.admit(now);
        if let Some(count) = heard.due(now) {
            tell(role, self.topic, count);
        }
        is_heard
    }
}

impl Drop for Rates {
    /// Tells the log who has not been told of yet.
    fn drop(&mut self) {
        for (role, heard) in self.roles.iter().filter(|(_, heard)| heard.untold > 0) {
            tell(*role, self.topic, heard.untold);
        }
    }
}

fn tell(role: Role, topic: Topic, count: u64) {
    let (role, topic) = (role.name(), topic.name());
    tracing::warn!(count, "{role} says more on {topic} than {PER_SECOND} messages a second: the rest is not heard");
}

impl Heard {
    fn admit(&mut self, now: Instant) -> bool {
        let empty = self.empty.map_or(now, |empty| empty.max(now)) + INTERVAL;
        let is_heard = empty - now <= INTERVAL * AT_ONCE;
        if is_heard {
            self.empty = Some(empty);
        } else {
            self.untold += 1;
        }
        is_heard
    }

    /// How many have been refused since that was told last, if it is to be told now: the first at once.
    fn due(&mut self, now: Instant) -> Option<u64> {
        let is_due = self.untold > 0 && self.told.is_none_or(|told| now.saturating_duration_since(told) >= PAUSE);
        is_due.then(|| {
            self.told = Some(now);
            std::mem::take(&mut self.untold)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of so many messages, evenly over so many seconds, those that are heard, and what the log is told.
    fn heard(heard: &mut Heard, begin: Instant, messages: u32, seconds: u32) -> (u32, Vec<u64>) {
        let (mut admitted, mut told) = (0, Vec::new());
        for message in 0..messages {
            let now = begin + Duration::from_secs(seconds.into()) * message / messages;
            admitted += u32::from(heard.admit(now));
            told.extend(heard.due(now));
        }
        (admitted, told)
    }

    #[test]
    fn who_says_what_is_usual_is_always_heard() {
        let (mut role, begin) = (Heard::default(), Instant::now());
        assert_eq!(heard(&mut role, begin, PER_SECOND * 60, 60), (PER_SECOND * 60, Vec::new()));
        // What has waited while a link was cut comes at once.
        let later = begin + Duration::from_mins(2);
        assert!((0..AT_ONCE).all(|_| role.admit(later)));
        assert!(!role.admit(later));
        assert!(role.admit(later + INTERVAL));
    }

    #[test]
    fn of_a_flood_only_what_is_usual_is_heard_and_it_is_a_line_every_ten_seconds() {
        let (mut role, begin) = (Heard::default(), Instant::now());
        let (admitted, told) = heard(&mut role, begin, 250_000, 25);
        assert!((PER_SECOND * 25..PER_SECOND * 25 + AT_ONCE + 1).contains(&admitted), "{admitted}");
        assert_eq!((told.len(), told[0]), (3, 1));
        assert!(told.iter().skip(1).all(|count| (97_000..100_000).contains(count)), "{told:?}");
    }

    #[test]
    fn who_floods_a_topic_does_not_displace_the_others() {
        let mut rates = Rates { topic: Topic::Health, roles: BTreeMap::new() };
        let now = Instant::now();
        let learner = (0..1_000).filter(|_| rates.admit("learner.00", now)).count();
        assert_eq!(learner, AT_ONCE as usize);
        assert!(rates.admit("controller.00", now) && rates.admit("robot-host.00", now));
        assert!(!rates.admit("root.00", now) && !rates.admit("00", now));
    }
}
