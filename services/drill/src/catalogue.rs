//! The exercises: which faults, in which process, over which carrier, and what must hold.

mod messages;
mod processes;

use protocol::message::Participant;
use std::fmt::Write;
use std::ops::Range;

/// Carrier of the links of a drill graph.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Carrier {
    /// All processes run on one host, and all links use shared memory.
    SharedMemory,
    /// Two hosts, with a bridge each.
    Hosts,
    /// The same, and the learner on a third host.
    ThreeHosts,
    /// No graph: the exercise calls one function.
    None,
}

impl Carrier {
    /// Name in the table and in the rows.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SharedMemory => "shared memory",
            Self::Hosts => "two hosts",
            Self::ThreeHosts => "three hosts",
            Self::None => "-",
        }
    }
}

/// What an exercise does.
#[derive(Debug, Clone, PartialEq)]
pub enum Task {
    /// Launches a graph with faults.
    Launch(Launch),
    /// Kills all processes at once and launches the graph again; number of rounds.
    KillAll(u32),
    /// Starts a second controller beside that of the launcher; number of rounds.
    Rivals(Rivalry, u32),
    /// Starts two launches that compete for one run directory; number of rounds.
    Compete(u32),
    /// Starts two independent launches of one user.
    SideBySide,
    /// Launches each host by itself, and lets something between them fail for a time; length of
    /// each failure \[ms\].
    Between(Failure, Vec<u64>),
    /// Gives goals to a robot while it drives; number of rounds.
    Goals(GoalFault, u32),
    /// Presses the emergency stop of a robot while it drives; number of presses.
    EmergencyStop(u32),
    /// Lets obstacles appear around a robot while it drives; number of obstacles.
    Appearing(u32),
    /// Lets a base at a serial port fail while it drives; number of failures.
    SerialBase(SerialFault, u32),
    /// Launches on machines with little shared memory; size for each launch \[MiB\]. Each launch
    /// drives normally, or is rejected before the robot moves.
    LittleSharedMemory(Vec<u64>),
    /// Offers damaged messages to the readers of all topics and to the gate; number of messages.
    Damaged(u64),
}

/// What fails between two hosts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// The cable between robot and controller is pulled.
    Cut,
    /// That cable carries this many bits per second.
    Slow(u64),
    /// Both bridges appear to each other as ones of another protocol version.
    OtherVersion,
    /// The certificates of both hosts expire. Then there are new ones, and the bridges are killed.
    Expiry,
    /// One bridge is killed: that of the robot and that of the controller in turn.
    KilledBridge,
    /// One of them is stopped, in turn. The launcher kills it when it finds it to hang.
    StoppedBridge,
    /// The controller's host is switched off, and on again.
    LostController,
    /// The learner's host is switched off, and on again.
    LostLearner,
}

impl Failure {
    /// Whether the robot drives on fresh plans all the time.
    pub const fn is_harmless(self) -> bool {
        match self {
            Self::Slow(bits_per_s) => bits_per_s >= ENOUGH_BITS_PER_S,
            Self::LostLearner => true,
            _ => false,
        }
    }
}

/// Rate of a cable that suffices for all messages.
const ENOUGH_BITS_PER_S: u64 = 100_000_000;

/// What is wrong with goals, or with the planner that gives them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalFault {
    /// No robot can do them.
    Absurd,
    /// They come without a pause.
    Flood,
    /// The planner is killed.
    KilledPlanner,
    /// Two planners give goals in turn, and hang.
    TwoPlanners,
}

/// What fails of a base at a serial port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SerialFault {
    /// Its driver is killed.
    KilledDriver,
    /// Its driver is stopped. The launcher kills it when it finds it to hang.
    StoppedDriver,
    /// Its firmware is killed, and starts again.
    KilledFirmware,
    /// Its cable is bad all the time. Driver and controller are killed in turn.
    BadCable,
}

/// The conflict between two controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rivalry {
    /// The second controller has the greater epoch.
    GreaterEpoch,
    /// Both controllers have claimed the same epoch.
    EqualEpochs,
    /// The epoch of the second controller is out of date when the controller continues.
    OldEpoch,
}

/// What must be rejected once per injected fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// Every malformed message, by each process that reads it.
    Messages,
    /// Every bad snapshot, by the controller, which keeps the last good one.
    Snapshots,
}

/// A launch with faults.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Launch {
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Whether the run is in lock step, where wall time does not count.
    pub lock_step: bool,
    /// The fault file, without its seed.
    pub faults: String,
    /// The participant that the faults end or stop. It must be in use again afterwards.
    pub restarts: Option<Participant>,
    /// Ticks in which a link changes the numbers of a command and seals it as valid. The acting
    /// command then differs from the one that the controller sent.
    pub misquoted: Vec<Range<u64>>,
    /// Ticks in which the controller gets an older state as the newest, from a stuck link or
    /// sensor.
    pub misled: Vec<Range<u64>>,
    /// Ticks in which the floor does not permit the acceleration of the reference.
    pub slippery: Vec<Range<u64>>,
    /// Why the robot is known to leave its path. This is reported as a note, not as a violation.
    pub goes_astray: Option<&'static str>,
    /// What must be rejected once per injected fault, if anything.
    pub refused: Option<Refused>,
    /// Number of periods in which the optimiser has no plan. The controller must still answer every
    /// period, on any fallback level.
    pub answered: Option<u64>,
    /// No process that the robot needs is disturbed: the robot must drive on fresh plans alone.
    pub undisturbed: bool,
    /// Shared memory of the machine, if it differs from the real size \[MiB\].
    pub shared_memory_mebibytes: Option<u64>,
    /// What drives.
    pub driven: Driven,
}

/// What drives in an exercise.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Driven {
    /// The simulator, which follows the figure eight.
    #[default]
    Simulator,
    /// The simulator, which stands and waits for goals, with a sensor for obstacles.
    WaitingForGoals,
    /// A simulated firmware at a serial port, which follows the figure eight.
    SerialBase,
}

/// One exercise.
#[derive(Debug, Clone, PartialEq)]
pub struct Exercise {
    /// Name of the fault.
    pub fault: &'static str,
    /// The process or the link that the fault affects.
    pub target: &'static str,
    /// Carrier of the links.
    pub carrier: Carrier,
    /// What is done.
    pub task: Task,
}

/// Extent of a drill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// A short form of each exercise, which takes seconds.
    Quick,
    /// All exercises at full length.
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
///
/// A quick drill runs all message faults of one link in one launch, unless `apart` is set.
pub fn exercises(extent: Extent, apart: bool) -> Vec<Exercise> {
    let mut all = Vec::new();
    processes::kills(extent, &mut all);
    processes::stops(extent, &mut all);
    all.extend(processes::shared_fates(extent));
    all.extend(between_hosts(extent));
    messages::on_control_links(extent, apart, &mut all);
    messages::of_other_versions(extent, &mut all);
    messages::snapshots(extent, &mut all);
    all.extend(around_goals(extent));
    all.extend(at_serial_port(extent));
    solvers(extent, &mut all);
    worlds(extent, &mut all);
    processes::machine(extent, &mut all);
    all
}

/// Faults between hosts.
fn between_hosts(extent: Extent) -> Vec<Exercise> {
    let of = |fault, target, failure, quick: &[u64], whole: &[u64], rounds: usize| {
        let carrier =
            if failure == Failure::LostLearner { Carrier::ThreeHosts } else { Carrier::Hosts };
        let millis = extent.pick(quick.to_vec(), whole.repeat(rounds));
        Exercise { fault, target, carrier, task: Task::Between(failure, millis) }
    };
    vec![
        of("partition", "cable", Failure::Cut, &[300, 3000], &[60, 300, 1000, 3000, 10_000], 10),
        of("slow link", "1 Mbit/s", Failure::Slow(1_000_000), &[3000], &[3000, 10_000], 10),
        of("slow link", "100 Mbit/s", Failure::Slow(ENOUGH_BITS_PER_S), &[5000], &[10_000], 10),
        of("other version", "bridge", Failure::OtherVersion, &[2000], &[1000, 4000], 10),
        of("certificate ends", "both hosts", Failure::Expiry, &[2000], &[2000], 10),
        of("kill", "one bridge", Failure::KilledBridge, &[0, 0], &[0, 0], 25),
        of(
            "stop",
            "one bridge",
            Failure::StoppedBridge,
            &[100, 1000],
            &[100, 300, 1000, 4000, 9000],
            6,
        ),
        of("lost host", "controller", Failure::LostController, &[1000], &[1000, 4000], 10),
        of("lost host", "learner", Failure::LostLearner, &[1000], &[1000, 4000], 10),
    ]
}

/// Faults of goals and planners, and of what a robot meets on the way.
fn around_goals(extent: Extent) -> Vec<Exercise> {
    let of = |fault, target, task| Exercise { fault, target, carrier: Carrier::SharedMemory, task };
    let goals = |fault, target, what, quick, whole| {
        of(fault, target, Task::Goals(what, extent.pick(quick, whole)))
    };
    vec![
        goals("absurd goals", "controller", GoalFault::Absurd, 22, 220),
        goals("goal flood", "controller", GoalFault::Flood, 20, 40),
        goals("planner killed", "path and velocity", GoalFault::KilledPlanner, 3, 60),
        goals("two planners", "controller", GoalFault::TwoPlanners, 6, 100),
        of("emergency stop", "robot", Task::EmergencyStop(extent.pick(1, 30))),
        of("obstacle appears", "robot", Task::Appearing(extent.pick(4, 60))),
    ]
}

/// Faults of a base at a serial port.
fn at_serial_port(extent: Extent) -> Vec<Exercise> {
    let of = |target, fault, quick, whole| Exercise {
        fault: "serial base",
        target,
        carrier: Carrier::SharedMemory,
        task: Task::SerialBase(fault, extent.pick(quick, whole)),
    };
    vec![
        of("driver killed", SerialFault::KilledDriver, 2, 60),
        of("driver hangs", SerialFault::StoppedDriver, 1, 30),
        of("firmware dies", SerialFault::KilledFirmware, 1, 30),
        of("bad cable", SerialFault::BadCable, 2, 60),
    ]
}

/// Results of the optimiser, in lock step, for several ticks in a row.
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

/// Why a slippery floor throws the robot off its path, even when the floor is dry again.
const SLIP: &str = "known (issue 21): while the wheels slip, inputs have little effect. The \
    controller identifies a small gain, asks for more, and the robot turns away";

/// Faults of the robot itself, in lock step and in windows of the run. The robot drives on, except
/// where it is blind, and nothing unsafe follows.
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
