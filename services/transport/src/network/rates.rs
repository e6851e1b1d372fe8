//! Who is heard on a topic that several roles write, the heartbeats. Nobody is heard in the name of
//! another: routers see to it by the name of the writer, and here it is held against what is said.
//! And nobody more often than is usual: else who floods it displaces what the others say. Each role
//! has a few places, a writer keeps his own while he says something, and so who floods in the name
//! of a role displaces no writer of it either who was there before. Who does so under the very name
//! of a writer displaces that one: routers know the role of a link, and not whose it is.
//!
//! A topic of one role needs no limit at its readers. Its queue is bounded, the newest displace the
//! oldest, and whoever has the certificate of that role could say all of it anyway. What keeps a
//! router busy is limited there, on all topics.

use super::Network;
use access::Role;
use protocol::message::Health;
use protocol::topic::Topic;
use protocol::wire;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Writers of one role that are heard at one time: one process, its successor, and as many again.
const PLACES: usize = 4;
/// A place is free again after so long a silence: as long as a link may be silent.
const FREE_AFTER: Duration = Duration::from_secs(2);
/// Messages of one writer that are heard \[1/s\]: five times what processes that are well say.
const PER_SECOND: u32 = 50;
/// How many of them may come at once.
const AT_ONCE: u32 = 16;
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
    places: [Option<Place>; PLACES],
    /// What was too much.
    surplus: Refused,
    /// What is not his to say.
    false_words: Refused,
}

/// What has been refused, for the log.
#[derive(Default)]
struct Refused {
    /// Since it was last told.
    untold: u64,
    told: Option<Instant>,
}

/// One writer who is heard.
struct Place {
    writer: String,
    /// When he said something last, heard or not.
    said: Instant,
    /// When there is room for as many as may come at once.
    empty: Instant,
}

impl Rates {
    /// Those of `topic`, if roles share it and it is known who says what.
    pub(super) fn on(topic: Topic, network: &Network) -> Option<Self> {
        (network.role.is_some() && Role::share(topic))
            .then(|| Self { topic, roles: BTreeMap::new() })
    }

    /// Whether what the writer called `id` says `now` is heard. Tells the log, now and then, who
    /// says too much.
    pub(super) fn admit(&mut self, id: &str, now: Instant) -> bool {
        // Routers let nobody else pass.
        let Some(role) = role_of(id) else { return false };
        let heard = self.roles.entry(role).or_default();
        let is_heard = heard.admit(id, now);
        if let Some(count) = heard.surplus.due(now) {
            tell_surplus(role, self.topic, count);
        }
        is_heard
    }

    /// Whether the writer called `id` may say `message` `now`: a heartbeat, of a process in his
    /// role. Tells the log, now and then, who says others.
    pub(super) fn believe(&mut self, id: &str, message: &[u8], now: Instant) -> bool {
        let Some(role) = role_of(id) else { return false };
        let whose = wire::decode::<Health>(message)
            .ok()
            .and_then(|health| health.participant())
            .map(Role::from);
        if whose == Some(role) {
            return true;
        }
        let heard = self.roles.entry(role).or_default();
        heard.false_words.untold += 1;
        if let Some(count) = heard.false_words.due(now) {
            tell_false_words(role, self.topic, count);
        }
        false
    }
}

/// The role that a writer's name begins with.
fn role_of(id: &str) -> Option<Role> {
    id.split_once('.').and_then(|(role, _)| Role::named(role))
}

impl Drop for Rates {
    /// Tells the log who has not been told of yet.
    fn drop(&mut self) {
        for (&role, Heard { surplus, false_words, .. }) in &self.roles {
            if surplus.untold > 0 {
                tell_surplus(role, self.topic, surplus.untold);
            }
            if false_words.untold > 0 {
                tell_false_words(role, self.topic, false_words.untold);
            }
        }
    }
}

fn tell_false_words(role: Role, topic: Topic, count: u64) {
    let (role, topic) = (role.name(), topic.name());
    tracing::warn!(
        count,
        "{role} publishes on {topic} what its role may not publish: the message is dropped"
    );
}

fn tell_surplus(role: Role, topic: Topic, count: u64) {
    let (role, topic) = (role.name(), topic.name());
    tracing::warn!(
        count,
        "{role} publishes more on {topic} than {PER_SECOND} messages a second from each of \
         {PLACES} writers: the rest is dropped"
    );
}

impl Heard {
    fn admit(&mut self, writer: &str, now: Instant) -> bool {
        let is_heard = self.place(writer, now).is_some_and(|place| place.admit(now));
        self.surplus.untold += u64::from(!is_heard);
        is_heard
    }

    /// The place of `writer`, or one that is free.
    fn place(&mut self, writer: &str, now: Instant) -> Option<&mut Place> {
        let is_his =
            |place: &Option<Place>| place.as_ref().is_some_and(|place| place.writer == writer);
        let is_free = |place: &Option<Place>| {
            place
                .as_ref()
                .is_none_or(|place| now.saturating_duration_since(place.said) >= FREE_AFTER)
        };
        let own = self.places.iter().position(is_his);
        let index = own.or_else(|| self.places.iter().position(is_free))?;
        if own.is_none() {
            self.places[index] = Some(Place { writer: writer.to_owned(), said: now, empty: now });
        }
        self.places[index].as_mut()
    }
}

impl Refused {
    /// How many have been refused since that was told last, if it is to be told now: the first at
    /// once.
    fn due(&mut self, now: Instant) -> Option<u64> {
        let is_due = self.untold > 0
            && self.told.is_none_or(|told| now.saturating_duration_since(told) >= PAUSE);
        is_due.then(|| {
            self.told = Some(now);
            std::mem::take(&mut self.untold)
        })
    }
}

impl Place {
    fn admit(&mut self, now: Instant) -> bool {
        self.said = now;
        let empty = self.empty.max(now) + INTERVAL;
        let is_heard = empty - now <= INTERVAL * AT_ONCE;
        if is_heard {
            self.empty = empty;
        }
        is_heard
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::VERSION;
    use protocol::message::{Message, Participant};

    /// Of so many messages, evenly over so many seconds, those that are heard, and what the log is
    /// told.
    fn heard(heard: &mut Heard, begin: Instant, messages: u32, seconds: u32) -> (u32, Vec<u64>) {
        let (mut admitted, mut told) = (0, Vec::new());
        for message in 0..messages {
            let now = begin + Duration::from_secs(seconds.into()) * message / messages;
            admitted += u32::from(heard.admit("learner.00", now));
            told.extend(heard.surplus.due(now));
        }
        (admitted, told)
    }

    #[test]
    fn who_says_what_is_usual_is_always_heard() {
        let (mut role, begin) = (Heard::default(), Instant::now());
        assert_eq!(heard(&mut role, begin, PER_SECOND * 60, 60), (PER_SECOND * 60, Vec::new()));
        // What has waited while a link was cut comes at once.
        let later = begin + Duration::from_mins(2);
        assert!((0..AT_ONCE).all(|_| role.admit("learner.00", later)));
        assert!(!role.admit("learner.00", later));
        assert!(role.admit("learner.00", later + INTERVAL));
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
    fn nobody_is_believed_who_speaks_in_the_name_of_another() {
        let mut rates = Rates { topic: Topic::Health, roles: BTreeMap::new() };
        let now = Instant::now();
        let mut says = |id: &str, participant: Participant| {
            let mut health = Health::zeroed();
            (health.stamp.version, health.stamp.kind, health.participant) =
                (VERSION, Health::KIND, participant.code());
            let mut message = Vec::new();
            wire::encode(&health, &mut message);
            rates.believe(id, &message, now)
        };
        for &participant in Participant::ALL {
            for role in Role::ALL {
                let is_his = Role::from(participant) == role;
                assert_eq!(
                    says(&format!("{}.00", role.name()), participant),
                    is_his,
                    "{role:?} of {participant}"
                );
            }
            assert!(!says("root.00", participant) && !says("", participant));
        }
        assert!(!rates.believe("robot.00", b"no heartbeat", now));
        let refused =
            |role| rates.roles.get(&role).map_or(0, |heard: &Heard| heard.false_words.untold);
        // The first of each is told at once.
        assert_eq!(
            (refused(Role::Robot), refused(Role::Learner), refused(Role::RobotHost)),
            (4, 3, 4)
        );
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

    #[test]
    fn who_floods_in_the_name_of_a_role_displaces_no_writer_of_it_who_was_there_before() {
        let mut rates = Rates { topic: Topic::Health, roles: BTreeMap::new() };
        let begin = Instant::now();
        assert!(rates.admit("learner.honest", begin));
        let mut forged = 0;
        for tenth in 1..=100 {
            let now = begin + Duration::from_millis(100) * tenth;
            // By one name, and by another each time.
            forged += (0..500).filter(|_| rates.admit("learner.flood", now)).count();
            forged += (0..500)
                .filter(|number| rates.admit(&format!("learner.{tenth}-{number}"), now))
                .count();
            assert!(
                rates.admit("learner.honest", now),
                "not heard after {tenth} tenths of a second"
            );
        }
        let most = (PLACES - 1) * (PER_SECOND * 10 + AT_ONCE) as usize;
        assert!(forged > 0 && forged <= most, "{forged} of {most}");
        // Who is silent for long has lost his place, and finds another when there is one.
        assert!(rates.admit("learner.next", begin + Duration::from_secs(10) + FREE_AFTER));
    }
}
