//! Exercises in which processes or the machine fail.

use super::{Carrier, Exercise, Extent, Launch, Rivalry, Task};
use protocol::message::Participant::{self, Bridge, Controller, Gateway, Learner, Plant, Recorder};
use std::fmt::Write;

/// Longest time between the two kills of a pair \[s\].
const EARLY_S: f64 = 0.3;

/// SIGKILL, swept over the phase of the period. Every fifth kill has a second one, swept over the
/// start-up time of the successor.
pub(super) fn kills(extent: Extent, all: &mut Vec<Exercise>) {
    for (participant, every_s) in [
        (Controller, 0.9),
        (Plant, 1.3),
        (Learner, 2.5),
        (Recorder, 1.0),
        (Gateway, 1.0),
        (Bridge, 2.0),
    ] {
        let (quick, whole) = (if participant == Learner { 3 } else { 6 }, 210_u32);
        let regular = extent.pick(quick, whole - whole / 5);
        let early = regular / 5;
        let mut faults = process("kill", participant, 1.5, every_s, regular, "");
        if early > 0 {
            let step = EARLY_S / f64::from(early);
            faults +=
                &process("kill", participant, 1.5 + 0.5 * step, 5.0 * every_s + step, early, "");
        }
        let duration_s =
            1.5 + f64::from(regular) * every_s + if participant == Learner { 4.0 } else { 2.0 };
        let launch = Launch {
            duration_s,
            faults,
            restarts: Some(participant),
            undisturbed: !needed(participant),
            ..Launch::default()
        };
        all.push(Exercise {
            fault: "kill",
            target: participant.text(),
            carrier: carrier_of(participant),
            task: Task::Launch(launch),
        });
    }
}

/// A bridge runs where there are two hosts. Both bridges then get its faults at the same moments.
fn carrier_of(participant: Participant) -> Carrier {
    if participant == Bridge { Carrier::Hosts } else { Carrier::SharedMemory }
}

fn needed(participant: Participant) -> bool {
    graph::file::is_needed(participant)
}

/// SIGSTOP for one period to ten seconds, then SIGCONT.
pub(super) fn stops(extent: Extent, all: &mut Vec<Exercise>) {
    for participant in [Controller, Plant, Learner, Recorder, Gateway, Bridge] {
        let millis: &[u64] =
            extent.pick(&[20, 60, 1000], &[20, 40, 60, 100, 200, 350, 500, 1000, 4000, 10_000]);
        let (mut faults, mut at) = (String::new(), 1.5);
        for millis in millis {
            let rounds = extent.pick(1, 3);
            let every = *millis as f64 * 1e-3 + 2.0;
            faults +=
                &process("stop", participant, at, every, rounds, &format!("millis = {millis}\n"));
            at += f64::from(rounds) * every;
        }
        let launch = Launch {
            duration_s: at + 2.0,
            faults,
            undisturbed: !needed(participant),
            restarts: Some(participant),
            ..Launch::default()
        };
        all.push(Exercise {
            fault: "stop",
            target: participant.text(),
            carrier: carrier_of(participant),
            task: Task::Launch(launch),
        });
    }
}

pub(super) fn shared_fates(extent: Extent) -> Vec<Exercise> {
    let of = |fault, target, carrier, task| Exercise { fault, target, carrier, task };
    vec![
        of("kill all", "everybody", Carrier::SharedMemory, Task::KillAll(extent.pick(3, 100))),
        of(
            "two controllers",
            "greater epoch",
            Carrier::SharedMemory,
            Task::Rivals(Rivalry::GreaterEpoch, extent.pick(3, 50)),
        ),
        of(
            "two controllers",
            "equal epochs",
            Carrier::SharedMemory,
            Task::Rivals(Rivalry::EqualEpochs, extent.pick(2, 20)),
        ),
        of(
            "two controllers",
            "old epoch",
            Carrier::SharedMemory,
            Task::Rivals(Rivalry::OldEpoch, extent.pick(3, 50)),
        ),
        of("two launchers", "one folder", Carrier::SharedMemory, Task::Compete(extent.pick(2, 20))),
        of("two launchers", "side by side", Carrier::SharedMemory, Task::SideBySide),
        of(
            "shared memory",
            "launch",
            Carrier::SharedMemory,
            Task::LittleSharedMemory(extent.pick(vec![4, 64], (2..34).step_by(2).collect())),
        ),
        of(
            "damaged bytes",
            "all readers",
            Carrier::None,
            Task::Damaged(extent.pick(100_000, 1_000_000)),
        ),
    ]
}

/// Faults of the machine.
pub(super) fn machine(extent: Extent, all: &mut Vec<Exercise>) {
    let mut of = |fault, target, faults| {
        let launch = Launch {
            duration_s: extent.pick(6.0, 30.0),
            faults,
            undisturbed: true,
            ..Launch::default()
        };
        all.push(Exercise {
            fault,
            target,
            carrier: Carrier::SharedMemory,
            task: Task::Launch(launch),
        });
    };
    let hog = format!(
        "[[process]]\nkind = \"hog\"\nfrom_s = 1.0\nmillis = {}\n",
        extent.pick(3000, 25_000)
    );
    of("busy machine", "everybody", hog);
    of("no memory", "learner", process("memory", Learner, 1.0, 1.0, 1, "mebibytes = 1\n"));
    of("full disk", "recorder", process("disk", Recorder, 1.0, 1.0, 1, "mebibytes = 1\n"));
    // Another process takes all of the memory, and gives it back.
    let rounds = extent.pick(1, 10);
    let faults = format!(
        "[[process]]\nkind = \"shared-memory\"\nmebibytes = 0\nmillis = 2000\n\
         from_s = 1.5\nevery_s = 4.0\ntimes = {rounds}\n"
    );
    let launch = Launch {
        duration_s: 2.5 + 4.0 * f64::from(rounds),
        faults,
        undisturbed: true,
        shared_memory_mebibytes: Some(64),
        ..Launch::default()
    };
    all.push(Exercise {
        fault: "shared memory",
        target: "running graph",
        carrier: Carrier::SharedMemory,
        task: Task::Launch(launch),
    });
    if extent == Extent::Whole {
        let faults = "[[process]]\nkind = \"hog\"\nfrom_s = 1.0\nmillis = 598000\n".to_owned();
        let launch = Launch { duration_s: 600.0, faults, undisturbed: true, ..Launch::default() };
        all.push(Exercise {
            fault: "ten minutes",
            target: "everybody",
            carrier: Carrier::SharedMemory,
            task: Task::Launch(launch),
        });
    }
}

fn process(
    kind: &str,
    participant: Participant,
    from_s: f64,
    every_s: f64,
    times: u32,
    keys: &str,
) -> String {
    let name = participant.text();
    let mut text = String::new();
    let _ = write!(
        text,
        "[[process]]\nkind = {kind:?}\nparticipant = {name:?}\nfrom_s = {from_s:.3}\n\
         every_s = {every_s:.3}\ntimes = {times}\n{keys}"
    );
    text
}
