//! Rule f: what was sent is in the record, or the recorder has counted it as lost.

use super::{Rule, Violation};
use crate::drill::record::{Message, Record};
use std::collections::{BTreeMap, BTreeSet};

/// Topics that are recorded.
const TOPICS: [&str; 7] = ["state", "command", "residual", "snapshot", "plan", "health", "truth"];

/// What the record has of one writer on one topic: sequence numbers by epoch.
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
        return; // what was said while the recorder was dead is nowhere
    }
    let [recorder] = recorders.as_slice() else {
        if recorders.is_empty() {
            let (found, expected) =
                ("no health of a recorder".to_owned(), "one that says what was lost".to_owned());
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
        // A writer of whom nothing came through is still known by its health.
        for writer in last_words.keys() {
            writers.entry(*writer).or_default();
        }
        let (mut sent, mut stored) = (0, 0);
        for (writer, epochs) in &writers {
            sent += sent_by(last_words.get(writer).copied(), topic, epochs);
            stored += epochs.values().map(|sequences| sequences.len() as u64).sum::<u64>();
        }
        let lost = recorder.says["lost"][topic].as_u64().unwrap_or(0);
        // What a killed writer said while the disk was full is counted, but nobody can know of it from elsewhere.
        let unheard_of = full_disk
            && writers
                .keys()
                .any(|writer| last_words.get(writer).is_none_or(|health| was_killed(health)));
        if sent != stored + lost && !(unheard_of && sent < stored + lost) {
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

/// Whether these are not the last words of one that ended in order. The recorder's own come before its end.
fn was_killed(health: &Message) -> bool {
    health.word("phase") != "finished" && health.word("participant") != "recorder"
}

/// What a writer has sent: in each epoch up to the greatest sequence number that was seen, and in its last one by its last words, if it had some.
/// Of an epoch that nobody ever heard of, nobody can count what was lost.
fn sent_by(last_words: Option<&Message>, topic: &str, epochs: &Stored) -> u64 {
    let seen =
        |epochs: &Stored| -> u64 { epochs.values().filter_map(|sequences| sequences.last()).sum() };
    match last_words {
        Some(health) if health.word("phase") == "finished" => {
            let earlier = epochs
                .range(..health.stamp("epoch"))
                .map(|(epoch, sequences)| (*epoch, sequences.clone()))
                .collect();
            seen(&earlier) + health.says["sent"][topic].as_u64().unwrap_or(0)
        }
        _ => seen(epochs),
    }
}
