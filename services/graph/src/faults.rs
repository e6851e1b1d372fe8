//! The file of faults: injections on the links, in the processes, in optimiser and learner, and in
//! the robot itself.

mod plant;

use controller::settings::{SolverFault, SolverFaults};
use learner::settings::{SnapshotFault, SnapshotFaults};
use plant_sim::obstacles::ObstacleSettings;
use plant_sim::truth::Truth;
use protocol::message::Participant;
use serde::Deserialize;
use settings::{Check, Impossible};
use std::time::Duration;
use transport::{Fault, Faults};

pub use plant::{PlantFault, PlantFaultKind};

/// Largest number of repetitions of one fault.
const TIMES_MAX: u32 = 100_000;
/// Longest time in a file of faults \[s\].
const SECONDS_MAX: f64 = 1e5;
/// Fraction of the golden ratio: any number of its multiples is spread evenly over the period.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Contents of a file of faults.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultsFile {
    /// Seed of all random choices.
    #[serde(default)]
    pub seed: u64,
    /// Faults of messages, on the links.
    #[serde(default)]
    pub fault: Vec<Fault>,
    /// Faults of processes.
    #[serde(default)]
    pub process: Vec<ProcessFault>,
    /// Faults of the controller's optimiser.
    #[serde(default)]
    pub solver: Vec<SolverFault>,
    /// Faults of the learner's snapshots.
    #[serde(default)]
    pub snapshot: Vec<SnapshotFault>,
    /// Faults of the robot, and of the floor under it.
    #[serde(default)]
    pub plant: Vec<PlantFault>,
}

/// A fault of a process.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessFault {
    /// Kind.
    pub kind: ProcessFaultKind,
    /// The affected role; absent for `hog` and `shared-memory`.
    #[serde(default)]
    pub participant: Option<Participant>,
    /// Time of the first injection after the first plan \[s\].
    pub from_s: f64,
    /// Interval between injections, if there are several \[s\]. Each one is delayed by another
    /// fraction of the control period.
    #[serde(default)]
    pub every_s: Option<f64>,
    /// Number of injections.
    #[serde(default = "once")]
    pub times: u32,
    /// For `stop`, `hog` and `shared-memory`: duration \[ms\].
    #[serde(default)]
    pub millis: Option<u64>,
    /// For `memory`, `disk` and `shared-memory`: the amount that is left \[MiB\].
    #[serde(default)]
    pub mebibytes: Option<u64>,
}

fn once() -> u32 {
    1
}

/// Kinds of faults of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProcessFaultKind {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, and SIGCONT after a time.
    Stop,
    /// All processors of the machine are kept busy for a time.
    Hog,
    /// Its address space is limited to this amount.
    Memory,
    /// The size of its files is limited to this amount, as on a full disk.
    Disk,
    /// Another process takes all shared memory of the machine except this amount, for a time.
    SharedMemory,
}

impl ProcessFaultKind {
    /// Name in files and logs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Kill => "kill",
            Self::Stop => "stop",
            Self::Hog => "hog",
            Self::Memory => "memory",
            Self::Disk => "disk",
            Self::SharedMemory => "shared-memory",
        }
    }
}

impl ProcessFault {
    /// Times of the injections after the first plan, for a control period of `period`. They sweep
    /// the phase of the period, from a start that depends on `seed`.
    pub fn times(&self, period: Duration, seed: u64) -> impl Iterator<Item = Duration> + use<> {
        let begin = (seed as f64 * GOLDEN).fract();
        let (from_s, every_s) = (self.from_s, self.every_s.unwrap_or(0.0));
        let at = move |time: u32| {
            let phase = (begin + f64::from(time) * GOLDEN).fract();
            Duration::from_secs_f64(from_s + f64::from(time) * every_s) + period.mul_f64(phase)
        };
        (0..self.times).map(at)
    }

    fn check(&self) -> Result<(), Impossible> {
        let kind = self.kind.name();
        let seconds = |key, value: f64, least: f64| {
            let possible = value.is_finite() && value >= least && value <= SECONDS_MAX;
            if possible {
                Ok(())
            } else {
                Err(Impossible::new(key, format!("{least} to {SECONDS_MAX} s")))
            }
        };
        let given = |key: &str, is: bool, wanted: bool, what: &str| match (is, wanted) {
            (true, false) => Err(Impossible::new(key, format!("no such key for {kind}"))),
            (false, true) => Err(Impossible::new(key, format!("it for {kind}: {what}"))),
            _ => Ok(()),
        };
        let of_nobody = matches!(self.kind, ProcessFaultKind::Hog | ProcessFaultKind::SharedMemory);
        given("participant", self.participant.is_some(), !of_nobody, "whose process")?;
        let lasts = of_nobody || self.kind == ProcessFaultKind::Stop;
        given("millis", self.millis.is_some(), lasts, "how long")?;
        let limits = matches!(
            self.kind,
            ProcessFaultKind::Memory | ProcessFaultKind::Disk | ProcessFaultKind::SharedMemory
        );
        given("mebibytes", self.mebibytes.is_some(), limits, "how much there is")?;
        if self.times > 1 {
            given("every_s", self.every_s.is_some(), true, "how far apart, for more than once")?;
        }
        if !(1..=TIMES_MAX).contains(&self.times) {
            return Err(Impossible::new("times", format!("1 to {TIMES_MAX}")));
        }
        seconds("from_s", self.from_s, 0.0)?;
        self.every_s.map_or(Ok(()), |every| seconds("every_s", every, 0.001))
    }
}

impl FaultsFile {
    /// Faults on the links.
    pub fn of_messages(&self) -> Faults {
        Faults { seed: self.seed, process: None, fault: self.fault.clone() }
    }

    /// Faults of the controller's optimiser.
    pub fn of_solver(&self) -> SolverFaults {
        SolverFaults { seed: self.seed, solver: self.solver.clone() }
    }

    /// Faults of the learner's snapshots.
    pub fn of_snapshots(&self) -> SnapshotFaults {
        SnapshotFaults { seed: self.seed, snapshot: self.snapshot.clone() }
    }

    /// The world of `truth`, with the faults of the robot in addition to its own. Without a
    /// simulator no fault of the robot can be injected.
    ///
    /// # Errors
    /// [`Impossible`] if both cannot be in one world.
    pub fn in_world(&self, truth: Option<&Truth>) -> Result<Option<Truth>, Impossible> {
        let Some(truth) = truth else {
            return if self.plant.is_empty() {
                Ok(None)
            } else {
                Err(Impossible::new(
                    "plant",
                    "nothing: only a scenario with [truth] has a simulator",
                ))
            };
        };
        let mut world = truth.clone();
        for (index, fault) in self.plant.iter().enumerate() {
            fault
                .happen_in(&mut world)
                .map_err(|impossible| impossible.under(&format!("plant.{index}")))?;
        }
        world.check().map_err(|impossible| {
            Impossible::new(impossible.key, impossible.expected).under("plant")
        })?;
        Ok(Some(world))
    }

    /// The obstacles of the world with these faults.
    ///
    /// # Errors
    /// [`Impossible`] if an obstacle appears to a robot without a sensor for it.
    pub fn among(
        &self,
        obstacles: Option<&ObstacleSettings>,
    ) -> Result<Option<ObstacleSettings>, Impossible> {
        let mut among = obstacles.cloned();
        for (index, fault) in self.plant.iter().enumerate() {
            fault
                .happen_among(among.as_mut())
                .map_err(|impossible| impossible.under(&format!("plant.{index}")))?;
        }
        if let Some(among) = &among {
            among.check().map_err(|impossible| impossible.under("plant"))?;
        }
        Ok(among)
    }

    /// Number of faults.
    pub fn count(&self) -> usize {
        self.fault.len()
            + self.process.len()
            + self.solver.len()
            + self.snapshot.len()
            + self.plant.len()
    }
}

impl From<Faults> for FaultsFile {
    /// Only faults of messages.
    fn from(faults: Faults) -> Self {
        Self { seed: faults.seed, fault: faults.fault, ..Self::default() }
    }
}

impl Check for FaultsFile {
    fn check(&self) -> Result<(), Impossible> {
        self.of_messages()
            .check()
            .map_err(|impossible| Impossible::new(impossible.key, impossible.expected))?;
        self.of_solver().check()?;
        self.of_snapshots().check()?;
        let mut plants = self.plant.iter().enumerate();
        plants.try_for_each(|(index, fault)| {
            fault.check().map_err(|impossible| impossible.under(&format!("plant.{index}")))
        })?;
        let mut processes = self.process.iter().enumerate();
        processes.try_for_each(|(index, fault)| {
            fault.check().map_err(|impossible| impossible.under(&format!("process.{index}")))
        })
    }
}

/// The same for a run in lock step.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
pub struct LockStepFaultsFile(pub FaultsFile);

impl Check for LockStepFaultsFile {
    fn check(&self) -> Result<(), Impossible> {
        let LockStepFaultsFile(file) = self;
        file.check()?;
        file.of_messages()
            .check_lock_step()
            .map_err(|impossible| Impossible::new(impossible.key, impossible.expected))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn refusal(text: &str) -> Option<String> {
        settings::parse::<FaultsFile>(text, Path::new("f.toml"))
            .err()
            .map(|error| error.to_string())
    }

    #[test]
    fn a_fault_of_a_process_has_the_keys_of_its_kind_and_no_others() {
        let refused = |fault: &str| {
            refusal(&format!("[[process]]\nfrom_s = 1.0\n{fault}")).unwrap_or_default()
        };
        assert_eq!(refused("kind = \"kill\"\nparticipant = \"controller\""), "");
        assert_eq!(
            refused(
                "kind = \"stop\"\nparticipant = \"plant\"\nmillis = 300\ntimes = 3\nevery_s = 1.5"
            ),
            ""
        );
        assert_eq!(refused("kind = \"hog\"\nmillis = 300"), "");
        assert_eq!(refused("kind = \"memory\"\nparticipant = \"learner\"\nmebibytes = 64"), "");
        assert_eq!(refused("kind = \"shared-memory\"\nmebibytes = 0\nmillis = 300"), "");
        for (fault, key) in [
            ("kind = \"kill\"", "participant"),
            ("kind = \"kill\"\nparticipant = \"plant\"\nmillis = 5", "millis"),
            ("kind = \"stop\"\nparticipant = \"plant\"", "millis"),
            ("kind = \"disk\"\nparticipant = \"recorder\"", "mebibytes"),
            ("kind = \"hog\"\nmillis = 5\nparticipant = \"plant\"", "participant"),
            ("kind = \"shared-memory\"\nmillis = 5", "mebibytes"),
            ("kind = \"shared-memory\"\nmebibytes = 5", "millis"),
            ("kind = \"kill\"\nparticipant = \"plant\"\ntimes = 3", "every_s"),
            ("kind = \"kill\"\nparticipant = \"plant\"\ntimes = 0", "times"),
            ("kind = \"kill\"\nparticipant = \"plant\"\ntimes = 2\nevery_s = 0.0", "every_s"),
        ] {
            assert!(
                refused(fault).contains(&format!("process.0.{key}")),
                "{fault}: {}",
                refused(fault)
            );
        }
        assert!(
            refusal("[[process]]\nfrom_s = -1.0\nkind = \"kill\"\nparticipant = \"plant\"")
                .is_some_and(|text| text.contains("from_s"))
        );
    }

    #[test]
    fn repeated_faults_sweep_the_phase_of_the_period() {
        let kills = ProcessFault {
            kind: ProcessFaultKind::Kill,
            participant: Some(Participant::Controller),
            from_s: 2.0,
            every_s: Some(1.0),
            times: 200,
            millis: None,
            mebibytes: None,
        };
        let period = Duration::from_millis(20);
        let phases = kills.times(period, 7).zip(0..).map(|(at, time)| {
            at.saturating_sub(Duration::from_secs(2 + time)).as_secs_f64() / 0.02
        });
        let mut tenths = [0; 10];
        for phase in phases {
            assert!((0.0..1.0).contains(&phase), "{phase}");
            tenths[(phase * 10.0) as usize] += 1;
        }
        assert!(tenths.iter().all(|&count| (18..=22).contains(&count)), "{tenths:?}");
        assert_ne!(kills.times(period, 7).next(), kills.times(period, 8).next());
    }
}
