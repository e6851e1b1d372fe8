//! The exercises: which faults, in whom, over what, and what must hold.

mod messages;

use protocol::message::Participant::{self, Controller, Gateway, Learner, Plant, Recorder};
use std::fmt::Write;
use std::ops::Range;

/// A graph of the drill.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
)]
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
    /// A second controller beside the launcher's, so often.
    Rivals(Rivalry, u32),
    /// Two launches that cannot both have what they want, so often.
    Compete(Prize, u32),
    /// Two launches of one user that have nothing to do with each other.
    SideBySide,
    /// Plant and controller on two hosts, and the cable between them pulled for so long each \[ms\].
    Partition(Vec<u64>),
    /// Launches on machines with so much shared memory \[MiB\]: each drives as if there were no end of it, or is refused before the robot moves.
    LittleSharedMemory(Vec<u64>),
    /// So many damaged messages are offered to the readers of all topics and to the gate.
    Damaged(u64),
}

/// What is between two controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rivalry {
    /// The second one's epoch is greater.
    GreaterEpoch,
    /// Both have claimed the same one.
    EqualEpochs,
    /// The second one's epoch is over when it is woken.
    OldEpoch,
}

/// What two launches want, and one gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Prize {
    /// The folder of the run.
    Folder,
    /// The address at which the robot's machine is to be found.
    Address,
}

impl Prize {
    /// Of whoever does not get it: 2 where a person said so, 1 where the system did.
    pub const fn exit_code(self) -> i32 {
        match self {
            Self::Folder => 2,
            Self::Address => 1,
        }
    }

    /// What that one says.
    pub const fn message(self) -> &'static str {
        match self {
            Self::Folder => "expected a new or empty folder",
            Self::Address => "a router at",
        }
    }
}

/// What must have been refused one for one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// Every message that was none any more, by whoever read it.
    Messages,
    /// Every bad snapshot, by the controller, which keeps the last good one.
    Snapshots,
}

/// A launch with faults.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Launch {
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// In lock step, so that time does not count.
    pub lock_step: bool,
    /// The file of faults but for its seed.
    pub faults: String,
    /// Whom the faults end or stop, who must be in use again.
    pub restarts: Option<Participant>,
    /// Ticks in which a link gives the gate other numbers than the controller said, sealed as valid, so that what acts is not what was said.
    pub misquoted: Vec<Range<u64>>,
    /// Ticks in which the controller gets an older state as the newest, from a link or a sensor that is stuck.
    pub misled: Vec<Range<u64>>,
    /// Ticks in which the floor does not give what the reference needs.
    pub slippery: Vec<Range<u64>>,
    /// Why the robot is known to leave its path: told in a note, and no violation.
    pub goes_astray: Option<&'static str>,
    /// What is compared with what was injected.
    pub refused: Option<Refused>,
    /// In so many periods the optimiser has no plan, and every period is answered by the controller, on whichever fallback level.
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

/// All exercises of an extent, in the order of the table. Of faults of messages, a quick drill does all those of one link in one launch, unless they
/// are wanted `apart`.
pub fn exercises(extent: Extent, apart: bool) -> Vec<Exercise> {
    let mut all = Vec::new();
    kills(extent, &mut all);
    stops(extent, &mut all);
    all.extend(shared_fates(extent));
    messages::on_control_links(extent, apart, &mut all);
    messages::of_other_versions(extent, &mut all);
    messages::snapshots(extent, &mut all);
    solvers(extent, &mut all);
    worlds(extent, &mut all);
    machine(extent, &mut all);
    all
}

/// The second of two kills that belong together comes so long after the first at most \[s\].
const EARLY_S: f64 = 0.3;

/// SIGKILL, swept over the phase of the period, and every fifth time once more: swept over the time in which the successor starts.
fn kills(extent: Extent, all: &mut Vec<Exercise>) {
    for (participant, every_s) in
        [(Controller, 0.9), (Plant, 1.3), (Learner, 2.5), (Recorder, 1.0), (Gateway, 1.0)]
    {
        let (quick, whole) = (if participant == Learner { 3 } else { 6 }, 210_u32);
        for carrier in [Carrier::SharedMemory, Carrier::Network] {
            if extent == Extent::Quick && carrier == Carrier::Network && !needed(participant) {
                continue;
            }
            let regular = extent.pick(quick, whole - whole / 5);
            let early = regular / 5;
            let mut faults = process("kill", participant, 1.5, every_s, regular, "");
            if early > 0 {
                let step = EARLY_S / f64::from(early);
                faults += &process(
                    "kill",
                    participant,
                    1.5 + 0.5 * step,
                    5.0 * every_s + step,
                    early,
                    "",
                );
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
                carrier,
                task: Task::Launch(launch),
            });
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
            if carrier == Carrier::Network && extent == Extent::Quick {
                continue;
            }
            let millis: &[u64] =
                extent.pick(&[20, 60, 1000], &[20, 40, 60, 100, 200, 350, 500, 1000, 4000, 10_000]);
            let (mut faults, mut at) = (String::new(), 1.5);
            for millis in millis {
                let rounds = extent.pick(1, 3);
                let every = *millis as f64 * 1e-3 + 2.0;
                faults += &process(
                    "stop",
                    participant,
                    at,
                    every,
                    rounds,
                    &format!("millis = {millis}\n"),
                );
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
                carrier,
                task: Task::Launch(launch),
            });
        }
    }
}

fn shared_fates(extent: Extent) -> Vec<Exercise> {
    let whole = extent == Extent::Whole;
    let of = |fault, target, carrier, task| Exercise { fault, target, carrier, task };
    let mut all = vec![
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
        of(
            "two launchers",
            "one folder",
            Carrier::SharedMemory,
            Task::Compete(Prize::Folder, extent.pick(2, 20)),
        ),
        of(
            "two launchers",
            "one address",
            Carrier::Network,
            Task::Compete(Prize::Address, extent.pick(2, 20)),
        ),
        of("two launchers", "side by side", Carrier::SharedMemory, Task::SideBySide),
        of(
            "partition",
            "cable",
            Carrier::Network,
            Task::Partition(extent.pick(vec![1000], partitions())),
        ),
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
    ];
    if whole {
        all.push(of("kill all", "everybody", Carrier::Network, Task::KillAll(100)));
        all.push(of(
            "two controllers",
            "greater epoch",
            Carrier::Network,
            Task::Rivals(Rivalry::GreaterEpoch, 50),
        ));
        all.push(of(
            "two controllers",
            "old epoch",
            Carrier::Network,
            Task::Rivals(Rivalry::OldEpoch, 50),
        ));
    }
    all
}

/// Ten of each length \[ms\].
fn partitions() -> Vec<u64> {
    [60, 300, 1000, 3000, 10_000].into_iter().cycle().take(50).collect()
}

/// What the optimiser says, in lock step, in so many ticks in a row.
fn solvers(extent: Extent, all: &mut Vec<Exercise>) {
    for kind in ["infeasible", "out-of-iterations", "nan", "wrong"] {
        let ticks: u32 = extent.pick(100, 1000);
        let faults =
            format!("[[solver]]\nkind = {kind:?}\nfrom_tick = 100\nuntil_tick = {}\n", 100 + ticks);
        let duration_s = f64::from(200 + ticks) * 0.02;
        let launch = Launch {
            duration_s,
            lock_step: true,
            faults,
            answered: Some(u64::from(ticks)),
            ..Launch::default()
        };
        all.push(Exercise {
            fault: "solver",
            target: kind,
            carrier: Carrier::SharedMemory,
            task: Task::Launch(launch),
        });
    }
}

/// Why a slippery floor throws the robot off its path, also when it is dry again.
const SLIP: &str = "known (issue 21, cause 1): the controller takes a slipping body for saturated \
                    motors, and what it learns meanwhile outlasts the slip";

/// What happens to the robot itself, in lock step, in windows of it: it drives on, but where it is blind, and nothing unsafe comes of it.
fn worlds(extent: Extent, all: &mut Vec<Exercise>) {
    const WHEELS: [&str; 4] = ["front-right", "front-left", "rear-left", "rear-right"];
    const SENSORS: [&str; 3] = ["pose", "velocity", "everything"];
    for (fault, kind) in [
        ("weak motor", "weak-motor"),
        ("dead motor", "dead-motor"),
        ("slip", "slip"),
        ("payload", "payload"),
        ("stuck sensor", "stuck-sensor"),
    ] {
        // A robot carries one load at most.
        let windows = if kind == "payload" { 1 } else { extent.pick(4, 24) };
        let (mut faults, mut ticks) = (String::new(), Vec::new());
        for window in 0..windows {
            let (wheel, sensor) = (WHEELS[window % WHEELS.len()], SENSORS[window % SENSORS.len()]);
            let keys = match kind {
                "weak-motor" => format!("wheel = {wheel:?}\ngain = 0.5\n"),
                "dead-motor" => format!("wheel = {wheel:?}\n"),
                "slip" => "grip = 0.4\n".to_owned(),
                "payload" => "mass_kg = 11.0\n".to_owned(),
                _ => format!("sensor = {sensor:?}\n"),
            };
            let _ = write!(
                faults,
                "[[plant]]\nkind = {kind:?}\nfrom_s = {}.0\nmillis = 2000\n{keys}",
                3 + 4 * window
            );
            let from = 50 * (3 + 4 * window as u64);
            ticks.push(from..from + 100);
        }
        let of = |this: &str| if kind == this { ticks.clone() } else { Vec::new() };
        let (misled, slippery) = (of("stuck-sensor"), of("slip"));
        let (duration_s, undisturbed) = (6.0 + 4.0 * windows as f64, kind != "stuck-sensor");
        let launch = Launch {
            duration_s,
            lock_step: true,
            faults,
            misled,
            slippery,
            goes_astray: (kind == "slip").then_some(SLIP),
            undisturbed,
            ..Launch::default()
        };
        all.push(Exercise {
            fault,
            target: "robot",
            carrier: Carrier::SharedMemory,
            task: Task::Launch(launch),
        });
    }
}

/// What the machine does.
fn machine(extent: Extent, all: &mut Vec<Exercise>) {
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
    // All of it taken by somebody else, and given back.
    let rounds = extent.pick(1, 10);
    let faults = format!(
        "[[process]]\nkind = \"shared-memory\"\nmebibytes = 0\nmillis = 2000\nfrom_s = 1.5\nevery_s = 4.0\ntimes = {rounds}\n"
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
        "[[process]]\nkind = {kind:?}\nparticipant = {name:?}\nfrom_s = {from_s:.3}\nevery_s = {every_s:.3}\ntimes = {times}\n{keys}"
    );
    text
}
