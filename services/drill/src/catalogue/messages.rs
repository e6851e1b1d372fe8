//! Exercises in which messages are lost, late, damaged, or wrong.

use super::{Carrier, Exercise, Extent, Launch, Refused, Task};
use learner::settings::SnapshotFaultKind;
use protocol::message::Participant::{self, Controller, Learner, Plant, Recorder};
use std::fmt::Write;

/// Fault, its kind in the fault file, and further keys of its entry.
type Kind = (&'static str, &'static str, &'static [&'static str]);

const KINDS: [Kind; 11] = [
    (
        "loss",
        "drop",
        &[
            "probability = 0.01\n",
            "probability = 0.05\n",
            "probability = 0.2\n",
            "probability = 0.5\n",
        ],
    ),
    ("duplicates", "duplicate", &["probability = 0.5\n"]),
    ("reordering", "reorder", &["probability = 0.3\n", "messages = 3\nprobability = 0.3\n"]),
    ("delay", "delay", &["millis = 20\n", "millis = 60\n", "millis = 100\n"]),
    ("jitter", "jitter", &["millis = 100\nprobability = 0.5\n"]),
    ("corruption", "corrupt", &["probability = 0.5\n"]),
    ("truncation", "truncate", &["probability = 0.5\n"]),
    ("other version", "version", &["probability = 0.5\n"]),
    ("stale burst", "replay", &["messages = 20\nprobability = 0.5\n"]),
    ("nan", "nan", &["probability = 0.3\n"]),
    ("stuck", "freeze", &[""]),
];

/// Ticks of 20 ms from the start of one window to the next, and the length of a window.
const STRIDE: u64 = 75;
const WINDOW: u64 = 25;

/// Faults of the links between plant and controller, in real time: windows with faults, each
/// followed by time without.
pub(super) fn on_control_links(extent: Extent, apart: bool, all: &mut Vec<Exercise>) {
    for (topic, participant, field) in
        [("command", Plant, "input"), ("state", Controller, "velocity")]
    {
        let each: Vec<Vec<Kind>> = KINDS.iter().map(|kind| vec![*kind]).collect();
        let groups = if extent == Extent::Quick && !apart { vec![KINDS.to_vec()] } else { each };
        for kinds in groups {
            let rounds = extent.pick(1, 10);
            let (mut faults, mut from) = (String::new(), STRIDE);
            let (mut misquoted, mut misled) = (Vec::new(), Vec::new());
            for (_, kind, levels) in &kinds {
                for level in extent.pick(levels.get(levels.len() - 1..).unwrap_or_default(), levels)
                {
                    for _ in 0..rounds {
                        let named = if *kind == "nan" {
                            format!("field = {field:?}\n")
                        } else {
                            String::new()
                        };
                        let until = from + extent.pick(12, WINDOW);
                        faults += &message(
                            topic,
                            participant,
                            kind,
                            from,
                            until,
                            &format!("{level}{named}"),
                        );
                        if *kind == "freeze" {
                            let windows =
                                if topic == "command" { &mut misquoted } else { &mut misled };
                            windows.push(from..until);
                        }
                        from += extent.pick(STRIDE / 2, STRIDE);
                    }
                }
            }
            let fault = if let [(only, ..)] = kinds.as_slice() { *only } else { "bad link" };
            let duration_s = from as f64 * 0.02 + 2.0;
            let launch = Launch {
                duration_s,
                faults,
                misquoted,
                misled,
                refused: Some(Refused::Messages),
                ..Launch::default()
            };
            all.push(Exercise {
                fault,
                target: topic,
                carrier: Carrier::SharedMemory,
                task: Task::Launch(launch),
            });
        }
    }
}

/// Messages of another protocol version with a valid checksum, for every reader.
pub(super) fn of_other_versions(extent: Extent, all: &mut Vec<Exercise>) {
    let ticks = extent.pick(150, 1500);
    let mut faults = String::new();
    for (topic, participant) in [
        ("command", Plant),
        ("state", Controller),
        ("snapshot", Controller),
        ("residual", Learner),
        ("residual", Recorder),
        ("snapshot", Recorder),
        ("plan", Recorder),
    ] {
        faults += &message(topic, participant, "version", 50, 50 + ticks, "probability = 0.1\n");
    }
    let duration_s = (50 + ticks) as f64 * 0.02 + 2.0;
    let launch =
        Launch { duration_s, faults, refused: Some(Refused::Messages), ..Launch::default() };
    all.push(Exercise {
        fault: "other version",
        target: "every topic",
        carrier: Carrier::SharedMemory,
        task: Task::Launch(launch),
    });
}

/// Damaged snapshots, and snapshots with wrong content from a faulty learner, in lock step, where
/// snapshots are frequent.
pub(super) fn snapshots(extent: Extent, all: &mut Vec<Exercise>) {
    let duration_s: f64 = extent.pick(20.0, 400.0);
    let until = (duration_s * 50.0) as u64 - 100;
    let mut of = |fault, target, faults, refused| {
        let launch = Launch {
            duration_s,
            lock_step: true,
            faults,
            undisturbed: true,
            refused: Some(refused),
            ..Launch::default()
        };
        all.push(Exercise {
            fault,
            target,
            carrier: Carrier::SharedMemory,
            task: Task::Launch(launch),
        });
    };
    let (half, earlier) = ("probability = 0.5\n", "messages = 3\nprobability = 0.5\n");
    for (kind, keys) in [("corrupt", half), ("truncate", half), ("replay", earlier)] {
        of(
            "bad snapshot",
            kind,
            message("snapshot", Controller, kind, 50, until, keys),
            Refused::Messages,
        );
    }
    let lie = |kind: SnapshotFaultKind, from: u64, until: u64, keys: &str| {
        format!(
            "[[snapshot]]\nkind = {:?}\nfrom_tick = {from}\nuntil_tick = {until}\n{keys}",
            kind.name()
        )
    };
    if extent == Extent::Quick {
        // One fault after the other, with good snapshots between; a stale fault needs some before
        // it.
        let (mut faults, share) = (String::new(), (until - 200) / 7);
        for (kind, from) in SnapshotFaultKind::ALL.into_iter().zip((200..).step_by(share as usize))
        {
            let _ = write!(faults, "{}", lie(kind, from, from + share / 2, ""));
        }
        of("bad snapshot", "learner", faults, Refused::Snapshots);
    } else {
        for kind in SnapshotFaultKind::ALL {
            of("bad snapshot", kind.name(), lie(kind, 50, until, half), Refused::Snapshots);
        }
    }
}

fn message(
    topic: &str,
    participant: Participant,
    kind: &str,
    from: u64,
    until: u64,
    keys: &str,
) -> String {
    let name = participant.text();
    format!(
        "[[fault]]\ntopic = {topic:?}\nat = \"reader\"\nparticipant = {name:?}\nkind = {kind:?}\n\
         from_tick = {from}\nuntil_tick = {until}\n{keys}"
    )
}
