//! Counters → Health, and a few lines in the log.

use super::Connection;
use crate::settings::Remote;
use process::{Pulse, Repeated};
use protocol::message::Phase;
use protocol::topic::{TOPIC_COUNT, Topic};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Counters → Health, and a few lines in the log.
#[derive(Default)]
pub(super) struct Report {
    refusals: Repeated<Refusal>,
    /// What the log has been told of, per kind.
    counted: BTreeMap<Refusal, u64>,
}

/// Messages of another host that were not delivered.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Refusal {
    host: String,
    topic: Option<Topic>,
    reason: &'static str,
}

impl Report {
    pub(super) fn show(
        &mut self,
        connections: &[Connection<'_>],
        rejected: u64,
        pulse: &mut Pulse,
        now: Instant,
    ) {
        let health = pulse.health();
        let (mut sent, mut received) = ([0; TOPIC_COUNT], [0; TOPIC_COUNT]);
        let (mut refused, mut dropped) = ([0; TOPIC_COUNT], [0; TOPIC_COUNT]);
        for Connection { remote, shared, sent_away, .. } in connections {
            for topic in Topic::ALL {
                let index = topic.index();
                sent[index] += count(&shared.sent[index].messages);
                dropped[index] += count(&shared.sent[index].given_up);
                let Some(incoming) = &shared.arrivals.incoming[index] else { continue };
                let from = &incoming.received;
                received[index] += count(&from.messages);
                dropped[index] += count(&from.overflowed);
                for (counter, reason) in [
                    (&from.too_many, "more messages than the largest rate"),
                    (&from.malformed, "malformed"),
                    (&from.of_another_host, "in the name of a process of another host"),
                ] {
                    refused[index] += count(counter);
                    self.note(Some(remote), Some(topic), reason, count(counter));
                }
            }
            let not_permitted = count(&shared.arrivals.not_permitted);
            self.note(Some(remote), None, "a topic that this host does not publish", not_permitted);
            self.note(Some(remote), None, "a peer with another certificate", *sent_away);
        }
        self.note(None, None, "a request of an operator or planner", rejected);
        health.sent = sent;
        health.received = received;
        health.refused = refused;
        health.dropped = dropped;
        let trouble = connections.iter().find_map(|connection| connection.trouble(now));
        health.set_last_error(trouble.as_deref().unwrap_or_default());
        let are_connected = connections.iter().all(|connection| connection.is_connected(now));
        match trouble {
            None if are_connected => pulse.phase(Phase::Running),
            None => {}
            Some(_) => pulse.phase(Phase::Degraded),
        }
        self.refusals.due(now).iter().for_each(tell);
    }

    fn note(
        &mut self,
        remote: Option<&Remote>,
        topic: Option<Topic>,
        reason: &'static str,
        total: u64,
    ) {
        if total == 0 {
            return;
        }
        let host = remote.map_or_else(|| "-".to_owned(), |remote| remote.host.clone());
        let refusal = Refusal { host, topic, reason };
        let before = self.counted.insert(refusal.clone(), total).unwrap_or(0);
        if total > before {
            self.refusals.note(refusal, total - before);
        }
    }

    pub(super) fn rest(&mut self) {
        self.refusals.rest().iter().for_each(tell);
    }
}

fn count(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

fn tell((Refusal { host, topic, reason }, count): &(Refusal, u64)) {
    let topic = topic.map_or("-", Topic::name);
    tracing::warn!(count, host, topic, "refused: {reason}");
}
