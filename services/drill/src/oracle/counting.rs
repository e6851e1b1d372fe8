//! Rule f: each message sent is in the record, or the recorder has counted it as lost.

use super::{Rule, Violation};
use crate::record::{Message, Record};
use std::collections::{BTreeMap, BTreeSet};

/// Recorded topics.
const TOPICS: [&str; 7] = ["state", "command", "residual", "snapshot", "plan", "health", "truth"];

/// Stored messages of one writer on one topic: sequence numbers by epoch.
type Stored = BTreeMap<u64, BTreeSet<u64>>;

pub(super) fn judge(record: &Record, violations: &mut Vec<Violation>) {
    let mut last_words: BTreeMap<u64, &Message> = BTreeMap::new();
    for health in record.of("health") {
        last_words.insert(health.stamp("writer"), health);
    }
    let recorders: Vec<&Message> = last_words
        .values()
        .filter(|health| health.word("participant") == "recorder")
        .copied()
        .collect();
    let full_disk =
        record.summary["unwritten"].as_object().is_some_and(|unwritten| !unwritten.is_empty());
    if record.summary["segments"].as_u64().is_some_and(|segments| segments > 1) && !full_disk {
        return; // messages sent while the recorder was dead are not in any record
    }
    let [recorder] = recorders.as_slice() else {
        if recorders.is_empty() {
            let (found, expected) =
                ("no health of a recorder".to_owned(), "one that reports what was lost".to_owned());
            violations.push(Violation { rule: Rule::Count, epoch: 0, tick: 0, found, expected });
        }
        return;
    };
    for topic in TOPICS {
        let mut writers: BTreeMap<u64, Stored> = BTreeMap::new();
        for message in record.of(topic) {
            let stored = writers.entry(message.stamp("writer")).or_default();
            stored.entry(message.stamp("epoch")).or_default().insert(message.stamp("sequence"));
        }
        // A writer whose messages were all lost is still known by its health.
        for writer in last_words.keys() {
            writers.entry(*writer).or_default();
        }
        let (mut sent, mut stored) = (0, 0);
        for (writer, epochs) in &writers {
            sent += sent_by(last_words.get(writer).copied(), topic, epochs);
            stored += epochs.values().map(|sequences| sequences.len() as u64).sum::<u64>();
        }
        let lost = recorder.fields["lost"][topic].as_u64().unwrap_or(0);
        // Messages that a killed writer sent while the disk was full are counted as lost, but no
        // other source can confirm them.
        let may_be_lost = full_disk
            && writers
                .keys()
                .any(|writer| last_words.get(writer).is_none_or(|health| was_killed(health)));
        if sent != stored + lost && !(may_be_lost && sent < stored + lost) {
            let found = format!("{topic}: {sent} sent, {stored} stored and {lost} counted as lost");
            let tick = recorder.stamp("tick");
            violations.push(Violation {
                rule: Rule::Count,
                epoch: recorder.stamp("writer"),
                tick,
                found,
                expected: "the same number".to_owned(),
            });
        }
    }
}

/// Whether this last Health does not come from an orderly end. The recorder's own last Health comes
/// before its end.
fn was_killed(health: &Message) -> bool {
    health.word("phase") != "finished" && health.word("participant") != "recorder"
}

/// The number of messages that a writer has sent.
///
/// For each epoch it is the greatest sequence number in the record. For the last epoch of a writer
/// that ended in order, it is the count in its last Health. Lost messages of an epoch without any
/// recorded message cannot be counted.
fn sent_by(last_words: Option<&Message>, topic: &str, epochs: &Stored) -> u64 {
    let seen =
        |epochs: &Stored| -> u64 { epochs.values().filter_map(|sequences| sequences.last()).sum() };
    // A bridge counts the messages of others that it has passed on.
    let is_own = |health: &Message| topic == "health" || health.word("participant") != "bridge";
    match last_words {
        Some(health) if health.word("phase") == "finished" && is_own(health) => {
            let earlier = epochs
                .range(..health.stamp("epoch"))
                .map(|(epoch, sequences)| (*epoch, sequences.clone()))
                .collect();
            seen(&earlier) + health.fields["sent"][topic].as_u64().unwrap_or(0)
        }
        _ => seen(epochs),
    }
}
