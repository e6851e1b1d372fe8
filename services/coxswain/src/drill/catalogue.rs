//! The exercises: which faults, in whom, over what, and what must hold.

use protocol::message::Participant::{self, Controller, Gateway, Learner, Plant, Recorder};
use std::fmt::Write;

/// A graph of the drill.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Carrier {
    /// Every link over shared memory.
    SharedMemory,
    /// Every link over the network, on the loopback or between two hosts.
    Network,
    /// No graph: what one function does.
    None,
}

impl Carrier {
    /// Its name in table and rows.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SharedMemory => "shared memory",
            Self::Network => "network",
            Self::None => "-",
        }
    }
}

/// What is done.
#[derive(Debug, Clone, PartialEq)]
pub enum Task {
    /// A graph is launched with faults.
    Launch(Launch),
    /// Everything is killed at once, and launched again, so often.
    KillAll(u32),
    /// A second controller joins a graph that has one, so often.
    SecondController(u32),
    /// Two graphs of one user at once.
    SecondLauncher,
    /// Plant and controller on two hosts, and the cable between them pulled for so long each \[ms\].
    Partition(Vec<u64>),
    /// Launches on machines with so much shared memory \[MiB\]: each drives as if there were no end of it, or is refused before the robot moves.
    LittleSharedMemory(Vec<u64>),
    /// So many damaged messages are offered to decoder and gate.
    Damaged(u64),
}

/// A launch with faults.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Launch {
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// In lock step, so that time does not count.
    pub lock_step: bool,
    /// Variants of the scenario, with a plus in front of each.
    pub variant: &'static str,
    /// A change of the scenario.
    pub change: &'static str,
    /// The file of faults but for its seed.
    pub faults: String,
    /// Whom the faults end or stop, who must be in use again.
    pub restarts: Option<Participant>,
    /// In so many periods the optimiser has no plan, and every period is answered by the controller, on whichever rung.
    pub answered: Option<u64>,
    /// Nobody whom the robot needs is touched: it must drive on fresh plans alone.
    pub undisturbed: bool,
    /// Of the machine, if it is not the one there is \[MiB\].
    pub shared_memory_mebibytes: Option<u64>,
}

/// One exercise.
#[derive(Debug, Clone, PartialEq)]
pub struct Exercise {
    /// The fault's name.
    pub fault: &'static str,
    /// To whom or on which link.
    pub target: &'static str,
    /// Over what.
    pub carrier: Carrier,
    /// What is done.
    pub task: Task,
}

/// How much of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// Seconds: a part of each.
    Quick,
    /// As long as it takes.
    Whole,
}

impl Extent {
    fn pick<T>(self, quick: T, whole: T) -> T {
        match self {
            Self::Quick => quick,
            Self::Whole => whole,
        }
    }
}

/// All exercises of an extent, in the order of the table.
pub fn exercises(extent: Extent) -> Vec<Exercise> {
    let mut all = Vec::new();
    kills(extent, &mut all);
    stops(extent, &mut all);
    all.extend(shared_fates(extent));
    messages(extent, &mut all);
    solvers(extent, &mut all);
    worlds(extent, &mut all);
    machine(extent, &mut all);
    all
}

/// SIGKILL, swept over the phase of the period, and every fifth time once more while the successor starts.
fn kills(extent: Extent, all: &mut Vec<Exercise>) {
    for (participant, every_s) in [(Controller, 0.9), (Plant, 1.3), (Learner, 2.5), (Recorder, 1.0), (Gateway, 1.0)] {
        let (quick, whole) = (if participant == Learner { 3 } else { 6 }, 210_u32);
        for carrier in [Carrier::SharedMemory, Carrier::Network] {
            if participant == Gateway && carrier == Carrier::Network
                || extent == Extent::Quick && carrier == Carrier::Network && !needed(participant)
            {
                continue;
            }
            let regular = extent.pick(quick, whole - whole / 5);
            let early = regular / 5;
            let mut faults = process("kill", participant, 1.5, every_s, regular, "");
            if early > 0 {
                faults += &process("kill", participant, 1.5 + 0.06, 5.0 * every_s, early, "");
            }
            let duration_s = 1.5 + f64::from(regular) * every_s + if participant == Learner { 4.0 } else { 2.0 };
            let launch = Launch { duration_s, faults, restarts: Some(participant), undisturbed: !needed(participant), ..Launch::default() };
            all.push(Exercise { fault: "kill", target: participant.text(), carrier, task: Task::Launch(launch) });
        }
    }
}

fn needed(participant: Participant) -> bool {
    crate::graph::is_needed(participant)
}

/// SIGSTOP for one period to ten seconds, then SIGCONT.
fn stops(extent: Extent, all: &mut Vec<Exercise>) {
    for participant in [Controller, Plant, Learner, Recorder, Gateway] {
        for carrier in [Carrier::SharedMemory, Carrier::Network] {
            if carrier == Carrier::Network && (participant == Gateway || extent == Extent::Quick) {
                continue;
            }
            let millis: &[u64] = extent.pick(&[20, 60, 1000], &[20, 40, 60, 100, 200, 350, 500, 1000, 4000, 10_000]);
            let (mut faults, mut at) = (String::new(), 1.5);
            for millis in millis {
                let rounds = extent.pick(1, 3);
                let every = *millis as f64 * 1e-3 + 2.0;
                faults += &process("stop", participant, at, every, rounds, &format!("millis = {millis}\n"));
                at += f64::from(rounds) * every;
            }
            let launch = Launch {
                duration_s: at + 2.0,
                faults,
                undisturbed: !needed(participant),
                restarts: Some(participant),
                ..Launch::default()
            };
            all.push(Exercise { fault: "stop", target: participant.text(), carrier, task: Task::Launch(launch) });
        }
    }
}

fn shared_fates(extent: Extent) -> Vec<Exercise> {
    let whole = extent == Extent::Whole;
    let of = |fault, target, carrier, task| Exercise { fault, target, carrier, task };
    let mut all = vec![
        of("kill all", "everybody", Carrier::SharedMemory, Task::KillAll(extent.pick(3, 100))),
        of("two controllers", "controller", Carrier::SharedMemory, Task::SecondController(extent.pick(3, 50))),
        of("two launchers", "launcher", Carrier::SharedMemory, Task::SecondLauncher),
        of("partition", "cable", Carrier::Network, Task::Partition(extent.pick(vec![1000], partitions()))),
        of(
            "shared memory",
            "launch",
            Carrier::SharedMemory,
            Task::LittleSharedMemory(extent.pick(vec![4, 64], (2..34).step_by(2).collect())),
        ),
        of("damaged bytes", "gate", Carrier::None, Task::Damaged(extent.pick(100_000, 1_000_000))),
    ];
    if whole {
        all.push(of("kill all", "everybody", Carrier::Network, Task::KillAll(100)));
        all.push(of("two controllers", "controller", Carrier::Network, Task::SecondController(50)));
    }
    all
}

/// Ten of each length \[ms\].
fn partitions() -> Vec<u64> {
    [60, 300, 1000, 3000, 10_000].into_iter().cycle().take(50).collect()
}

/// What the links do, in real time but for the models: windows of it, and clean time behind each.
fn messages(extent: Extent, all: &mut Vec<Exercise>) {
    const KINDS: [(&str, &str, &[&str]); 10] = [
        ("loss", "drop", &["probability = 0.01\n", "probability = 0.05\n", "probability = 0.2\n", "probability = 0.5\n"]),
        ("duplicates", "duplicate", &["probability = 0.5\n"]),
        ("reordering", "reorder", &["probability = 0.3\n", "messages = 3\nprobability = 0.3\n"]),
        ("delay", "delay", &["millis = 20\n", "millis = 60\n", "millis = 100\n"]),
        ("jitter", "jitter", &["millis = 100\nprobability = 0.5\n"]),
        ("corruption", "corrupt", &["probability = 0.5\n"]),
        ("truncation", "truncate", &["probability = 0.5\n"]),
        ("stale burst", "replay", &["messages = 20\nprobability = 0.5\n"]),
        ("nan", "nan", &["probability = 0.3\n"]),
        ("stuck", "freeze", &[""]),
    ];
    // From window to window, and the length of one [ticks of 20 ms].
    const STRIDE: u64 = 75;
    const WINDOW: u64 = 25;
    for (topic, participant, field) in [("command", Plant, "input"), ("state", Controller, "velocity")] {
        for carrier in [Carrier::SharedMemory, Carrier::Network] {
            if extent == Extent::Quick && (carrier == Carrier::Network) != (topic == "command") {
                continue;
            }
            let groups = extent.pick(vec![KINDS.to_vec()], KINDS.iter().map(|kind| vec![*kind]).collect());
            for kinds in groups {
                let rounds = extent.pick(1, 10);
                let (mut faults, mut from) = (String::new(), STRIDE);
                for (_, kind, levels) in &kinds {
                    for level in extent.pick(levels.get(levels.len() - 1..).unwrap_or_default(), levels) {
                        for _ in 0..rounds {
                            let named = if *kind == "nan" { format!("field = {field:?}\n") } else { String::new() };
                            faults += &message(topic, participant, kind, from, from + extent.pick(12, WINDOW), &format!("{level}{named}"));
                            from += extent.pick(STRIDE / 2, STRIDE);
                        }
                    }
                }
                let fault = if let [(only, ..)] = kinds.as_slice() { *only } else { "bad link" };
                let launch = Launch { duration_s: from as f64 * 0.02 + 2.0, faults, ..Launch::default() };
                all.push(Exercise { fault, target: topic, carrier, task: Task::Launch(launch) });
            }
        }
    }
    // In lock step, where models come often.
    for (fault, kind, keys) in [
        ("bad snapshot", "corrupt", "probability = 0.5\n"),
        ("bad snapshot", "truncate", "probability = 0.5\n"),
        ("bad snapshot", "nan", "field = \"points\"\nprobability = 0.5\n"),
        ("stale snapshot", "replay", "messages = 3\nprobability = 0.5\n"),
    ] {
        let faults = message("snapshot", Controller, kind, 50, 1_000_000, keys);
        let launch = Launch { duration_s: extent.pick(20.0, 400.0), lock_step: true, faults, undisturbed: true, ..Launch::default() };
        all.push(Exercise { fault, target: kind, carrier: Carrier::SharedMemory, task: Task::Launch(launch) });
    }
}

/// What the optimiser says, in lock step, in so many ticks in a row.
fn solvers(extent: Extent, all: &mut Vec<Exercise>) {
    for kind in ["infeasible", "out-of-iterations", "nan", "wrong"] {
        let ticks: u32 = extent.pick(100, 1000);
        let faults = format!("[[solver]]\nkind = {kind:?}\nfrom_tick = 100\nuntil_tick = {}\n", 100 + ticks);
        let duration_s = f64::from(200 + ticks) * 0.02;
        let launch = Launch { duration_s, lock_step: true, faults, answered: Some(u64::from(ticks)), ..Launch::default() };
        all.push(Exercise { fault: "solver", target: kind, carrier: Carrier::SharedMemory, task: Task::Launch(launch) });
    }
}

/// What the world does, in lock step: the robot drives on, and nothing unsafe comes of it.
fn worlds(extent: Extent, all: &mut Vec<Exercise>) {
    for (fault, variant, change) in [
        ("weak motor", "+weak-motor", ""),
        ("dead motor", "", "truth.faults=[{ wheel = \"front-right\", gain = 0.0, at_s = 5.0 }]"),
        ("slip", "+patch", ""),
        ("payload", "+payload", ""),
    ] {
        let launch =
            Launch { duration_s: extent.pick(20.0, 120.0), lock_step: true, variant, change, undisturbed: true, ..Launch::default() };
        all.push(Exercise { fault, target: "world", carrier: Carrier::SharedMemory, task: Task::Launch(launch) });
    }
    let stuck = message("state", Controller, "freeze", 200, 250, "");
    let launch = Launch { duration_s: 10.0, lock_step: true, faults: stuck, ..Launch::default() };
    all.push(Exercise { fault: "stuck sensor", target: "world", carrier: Carrier::SharedMemory, task: Task::Launch(launch) });
}

/// What the machine does.
fn machine(extent: Extent, all: &mut Vec<Exercise>) {
    let mut of = |fault, target, faults| {
        let launch = Launch { duration_s: extent.pick(6.0, 30.0), faults, undisturbed: true, ..Launch::default() };
        all.push(Exercise { fault, target, carrier: Carrier::SharedMemory, task: Task::Launch(launch) });
    };
    let hog = format!("[[process]]\nkind = \"hog\"\nfrom_s = 1.0\nmillis = {}\n", extent.pick(3000, 25_000));
    of("busy machine", "everybody", hog);
    of("no memory", "learner", process("memory", Learner, 1.0, 1.0, 1, "mebibytes = 1\n"));
    of("full disk", "recorder", process("disk", Recorder, 1.0, 1.0, 1, "mebibytes = 1\n"));
    // All of it taken by somebody else, and given back.
    let rounds = extent.pick(1, 10);
    let faults =
        format!("[[process]]\nkind = \"shared-memory\"\nmebibytes = 0\nmillis = 2000\nfrom_s = 1.5\nevery_s = 4.0\ntimes = {rounds}\n");
    let launch = Launch {
        duration_s: 2.5 + 4.0 * f64::from(rounds),
        faults,
        undisturbed: true,
        shared_memory_mebibytes: Some(64),
        ..Launch::default()
    };
    all.push(Exercise { fault: "shared memory", target: "running graph", carrier: Carrier::SharedMemory, task: Task::Launch(launch) });
    if extent == Extent::Whole {
        let faults = "[[process]]\nkind = \"hog\"\nfrom_s = 1.0\nmillis = 598000\n".to_owned();
        let launch = Launch { duration_s: 600.0, faults, undisturbed: true, ..Launch::default() };
        all.push(Exercise { fault: "ten minutes", target: "everybody", carrier: Carrier::SharedMemory, task: Task::Launch(launch) });
    }
}

fn process(kind: &str, participant: Participant, from_s: f64, every_s: f64, times: u32, keys: &str) -> String {
    let name = participant.text();
    let mut text = String::new();
    let _ = write!(
        text,
        "[[process]]\nkind = {kind:?}\nparticipant = {name:?}\nfrom_s = {from_s:.3}\nevery_s = {every_s:.3}\ntimes = {times}\n{keys}"
    );
    text
}

fn message(topic: &str, participant: Participant, kind: &str, from: u64, until: u64, keys: &str) -> String {
    let name = participant.text();
    format!(
        "[[fault]]\ntopic = {topic:?}\nat = \"reader\"\nparticipant = {name:?}\nkind = {kind:?}\nfrom_tick = {from}\nuntil_tick = {until}\n{keys}"
    )
}
