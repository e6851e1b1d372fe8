//! Settings that the launcher gives to every process.

use crate::Scheduling;
use crate::priority::{self, PRIORITY};
use protocol::message::Exposure;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::path::PathBuf;
use tracing_subscriber::EnvFilter;
use transport::Links;

/// Longest control period \[ns\]: 1000 s.
const PERIOD_NANOS_MAX: u64 = 1_000_000_000_000;

/// Settings that the launcher gives to every process: the table `[run]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Run directory: logs, record.
    pub folder: PathBuf,
    /// Log filter of `tracing`: a level, or `module=level,…`.
    pub log: String,
    /// Highest epoch that the launcher has seen or assigned for this role. A process starts in a
    /// higher one.
    pub epoch_floor: u64,
    /// Whether this role has already run in this run.
    pub restarted: bool,
    /// Control period \[ns\].
    pub period_nanos: u64,
    /// Source of the time.
    pub pace: Pace,
    /// Processors, memory and priority of the process.
    #[serde(default)]
    pub scheduling: Scheduling,
    /// Access of unauthenticated peers on the network that an operator has allowed.
    #[serde(default = "closed")]
    pub exposure: Exposure,
    /// Links of the graph.
    pub links: Links,
}

fn closed() -> Exposure {
    Exposure::Closed
}

/// Source of the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// The monotonic clock.
    RealTime,
    /// The slowest participant: the plant waits for the answer to each tick.
    LockStep,
}

impl Pace {
    /// Name in files and options.
    pub const fn name(self) -> &'static str {
        match self {
            Self::RealTime => "real-time",
            Self::LockStep => "lock-step",
        }
    }
}

impl Run {
    /// Settings of the first start in a run whose files are in `folder`. It is in lock step if its
    /// links are.
    pub fn new(folder: impl Into<PathBuf>, period_nanos: u64, links: Links) -> Self {
        Self {
            folder: folder.into(),
            log: "info".to_owned(),
            epoch_floor: 0,
            restarted: false,
            period_nanos,
            pace: if links.lock_step { Pace::LockStep } else { Pace::RealTime },
            scheduling: Scheduling::default(),
            exposure: Exposure::Closed,
            links,
        }
    }

    /// Locks the memory of a process on the control path, and sets its priority for opening its
    /// ports. Shared memory takes tens of milliseconds, so the process runs below a running control
    /// loop and above all others.
    pub fn go_first_to_open(&self) {
        if self.pace == Pace::RealTime {
            self.scheduling.lock_memory_if_permitted();
        }
        if self.priority().is_some() {
            priority::go_before_the_rest();
        }
    }

    /// The same when all ports are open: takes the full priority from now on.
    pub fn go_first_to_run(&self) {
        if let Some(priority) = self.priority() {
            priority::go_first(priority);
        }
    }

    /// Its real-time priority, if it gets one.
    fn priority(&self) -> Option<u8> {
        let asked = self.scheduling.real_time_priority.unwrap_or(PRIORITY);
        (self.pace == Pace::RealTime && asked > 0).then_some(asked)
    }
}

#[cfg(feature = "faults")]
impl Run {
    fn check_faults(&self) -> Result<(), Impossible> {
        let faults = &self.links.faults;
        let lock_step = if self.links.lock_step { faults.check_lock_step() } else { Ok(()) };
        faults
            .check()
            .and(lock_step)
            .map_err(|error| Impossible::new(error.key, error.expected).under("links.faults"))
    }
}

/// Settings with a table `[run]`.
pub trait HasRun {
    /// The table.
    fn run(&self) -> &Run;
}

impl Check for Run {
    fn check(&self) -> Result<(), Impossible> {
        if !(1..=PERIOD_NANOS_MAX).contains(&self.period_nanos) {
            return Err(Impossible::new(
                "period_nanos",
                format!("a period of 1 to {PERIOD_NANOS_MAX} ns"),
            ));
        }
        self.scheduling.check().map_err(|impossible| impossible.under("scheduling"))?;
        if self.links.lock_step != (self.pace == Pace::LockStep) {
            return Err(Impossible::new("links.lock_step", "true in lock step, else false"));
        }
        #[cfg(feature = "faults")]
        self.check_faults()?;
        if EnvFilter::try_new(&self.log).is_err() {
            return Err(Impossible::new(
                "log",
                "a level (error, warn, info, debug, trace) or a list of module=level",
            ));
        }
        Ok(())
    }
}
