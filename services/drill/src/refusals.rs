//! What was injected ↔ what was rejected: one rejection for each injection, and the last good
//! message stays in use.

use super::record::Record;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::{fs, io};

/// Faults that make a message malformed, so that its reader rejects and counts it.
const MALFORMED: [&str; 3] = ["corrupt", "truncate", "version"];

/// Faults of one kind that one process has injected on one link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct OnLink {
    /// Name of its log, without the extension.
    pub(super) process: String,
    /// Name of the topic.
    pub(super) topic: String,
    /// Name of the fault.
    pub(super) kind: String,
    /// Number of injections.
    pub(super) count: u64,
}

/// The injections that the processes of a run have logged.
///
/// # Errors
/// If a log cannot be read.
pub(super) fn on_links(run: &Path) -> io::Result<Vec<OnLink>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(run)? {
        let path = entry?.path();
        let Some(process) = path
            .file_stem()
            .filter(|_| path.extension().is_some_and(|extension| extension == "log"))
        else {
            continue;
        };
        let text = fs::read_to_string(&path)?;
        let of_line = |line: &str| {
            let (topic, kind) = (value(line, "topic")?.to_owned(), value(line, "kind")?.to_owned());
            Some(OnLink {
                process: process.to_string_lossy().into_owned(),
                topic,
                kind,
                count: value(line, "injected")?.parse().ok()?,
            })
        };
        found.extend(
            text.lines().filter(|line| line.contains("faults were injected")).filter_map(of_line),
        );
    }
    Ok(found)
}

/// The value of `key` in a line of a log.
fn value<'a>(line: &'a str, key: &str) -> Option<&'a str> {
    line.split_whitespace()
        .find_map(|word| Some(word.strip_prefix(key)?.strip_prefix('=')?.trim_matches('"')))
}

/// Every malformed message was rejected and counted by the process that read it.
pub(super) fn judge_messages(on_links: &[OnLink], record: &Record) -> Vec<String> {
    let mut injected: BTreeMap<(&str, &str), u64> = BTreeMap::new();
    for fault in on_links.iter().filter(|fault| MALFORMED.contains(&fault.kind.as_str())) {
        *injected.entry((&fault.process, &fault.topic)).or_default() += fault.count;
    }
    let counted = |process: &str, topic: &str| {
        record.health_of(process).next_back()?.fields["refused"][topic].as_u64()
    };
    let differs = |((process, topic), count): ((&str, &str), u64)| {
        let refused = counted(process, topic);
        (refused != Some(count)).then(|| {
            format!(
                "{process} counts {refused:?} messages refused on topic {topic}, expected {count}"
            )
        })
    };
    injected.into_iter().filter_map(differs).collect()
}

/// The number of bad snapshots that the learner of a run has sent, and the errors in how the
/// controller handled them.
///
/// # Errors
/// If the learner's log cannot be read.
pub(super) fn judge_snapshots(run: &Path, record: &Record) -> io::Result<(u64, Vec<String>)> {
    let log = fs::read_to_string(run.join("learner.log"))?;
    let sent: Vec<&str> =
        log.lines().filter(|line| line.contains("a bad snapshot is sent")).collect();
    let mut violations = Vec::new();
    let refused = record
        .health_of("controller")
        .next_back()
        .map_or(0, |health| health.count("snapshots_refused"));
    if refused != sent.len() as u64 {
        violations.push(format!(
            "the controller refused {refused} snapshots, expected all {} bad ones and no other",
            sent.len()
        ));
    }
    // A stale snapshot carries the version of a good one.
    let fresh = sent.iter().filter(|line| value(line, "kind") != Some("stale"));
    let bad: BTreeSet<u64> =
        fresh.filter_map(|line| value(line, "version")?.parse().ok()).collect();
    let mut newest = 0;
    for command in record.of("command") {
        let (tick, version) = (command.stamp("tick"), command.count("model_version"));
        if bad.contains(&version) {
            violations.push(format!("bad snapshot {version} is in use at tick {tick}"));
        }
        if version < newest {
            violations.push(format!(
                "model {newest} was replaced by {version} at tick {tick}, \
                 expected the last good one to stay"
            ));
        }
        newest = newest.max(version);
    }
    if newest == 0 {
        violations.push("no model was ever in use: the exercise shows nothing".to_owned());
    }
    Ok((sent.len() as u64, violations))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Message;
    use serde_json::json;

    #[test]
    fn injected_faults_are_read_from_the_logs() -> io::Result<()> {
        let run = tempfile::tempdir()?;
        let line = "INFO chain: faults were injected fault=0 topic=\"state\" at=Reader \
                    kind=\"version\" seen=9 injected=4";
        fs::write(run.path().join("controller.log"), format!("{line}\nsomething else\n"))?;
        let found = on_links(run.path())?;
        let expected = OnLink {
            process: "controller".into(),
            topic: "state".into(),
            kind: "version".into(),
            count: 4,
        };
        assert_eq!(found, [expected]);
        let health = |refused: u64| {
            let fields =
                json!({"participant": "controller", "refused": {"state": refused, "command": 0}});
            Record::of_messages(vec![Message { topic: "health".into(), fields }])
        };
        assert_eq!(judge_messages(&found, &health(4)), [""; 0]);
        assert_eq!(judge_messages(&found, &health(3)).len(), 1);
        Ok(())
    }

    #[test]
    fn a_bad_snapshot_in_use_and_a_dropped_good_one_are_violations() -> io::Result<()> {
        let run = tempfile::tempdir()?;
        fs::write(
            run.path().join("learner.log"),
            "WARN learner::fault_injector: a bad snapshot is sent kind=\"nan\" version=2 tick=50\n",
        )?;
        let judged = |versions: &[u64], refused: u64| {
            let command = |(tick, &version): (usize, &u64)| Message {
                topic: "command".into(),
                fields: json!({"stamp": {"tick": tick}, "model_version": version}),
            };
            let mut messages: Vec<Message> = versions.iter().enumerate().map(command).collect();
            messages.push(Message {
                topic: "health".into(),
                fields: json!({"participant": "controller", "snapshots_refused": refused}),
            });
            judge_snapshots(run.path(), &Record::of_messages(messages))
                .map(|(sent, violations)| (sent, violations.len()))
        };
        assert_eq!(judged(&[0, 1, 1, 3], 1)?, (1, 0));
        assert_eq!(judged(&[0, 1, 1, 3], 0)?, (1, 1));
        assert_eq!(judged(&[0, 1, 2, 3], 1)?, (1, 1));
        assert_eq!(judged(&[0, 1, 0, 3], 1)?, (1, 1));
        assert_eq!(judged(&[0, 0], 1)?, (1, 1));
        Ok(())
    }
}
