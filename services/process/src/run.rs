//! What the launcher tells every process.

use crate::Scheduling;
use crate::priority::{self, PRIORITY};
use protocol::message::Exposure;
use protocol::port::{Carrier, Links};
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::path::PathBuf;
use tracing_subscriber::EnvFilter;

/// Longest control period \[ns\]: 1000 s.
const PERIOD_NANOS_MAX: u64 = 1_000_000_000_000;

/// What the launcher tells every process: the table `[run]` of its settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Folder of the run: logs, record.
    pub folder: PathBuf,
    /// What is logged, as a filter of `tracing`: a level, or `module=level,…`.
    pub log: String,
    /// Highest epoch that the launcher has seen or given out for this role. A process starts in a higher one.
    pub epoch_floor: u64,
    /// Whether this role has run before in this run.
    pub restarted: bool,
    /// Control period \[ns\].
    pub period_nanos: u64,
    /// Whose time it is.
    pub pace: Pace,
    /// How the system is to treat it.
    #[serde(default)]
    pub scheduling: Scheduling,
    /// What strangers on the network can do, because a person has let them.
    #[serde(default = "closed")]
    pub exposure: Exposure,
    /// How the links of the graph run.
    pub links: Links,
}

fn closed() -> Exposure {
    Exposure::Closed
}

/// Whose time it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// The monotonic clock's.
    RealTime,
    /// The slowest participant's: the plant waits for the answer to each tick.
    LockStep,
}

impl Run {
    /// Of the first start in a run whose files are in `folder`, in lock step if its links are.
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

    /// For a process that commands wait for, before it opens its ports: shared memory takes tens of milliseconds, for which it goes behind a loop that
    /// runs already, and before everything else. But if there will be threads of the network it goes first, since they go as the one that opens them.
    pub fn go_first_to_open(&self) {
        if let Some(priority) = self.priority() {
            if self.has_threads() {
                priority::go_first(priority);
            } else {
                priority::go_before_the_rest();
            }
        }
    }

    /// For the same, when all is open and built: goes first from now on.
    pub fn go_first_to_run(&self) {
        if let Some(priority) = self.priority().filter(|_| !self.has_threads()) {
            priority::go_first(priority);
        }
    }

    /// Its real-time priority, if it is to have one.
    fn priority(&self) -> Option<u8> {
        let asked = self.scheduling.real_time_priority.unwrap_or(PRIORITY);
        (self.pace == Pace::RealTime && asked > 0).then_some(asked)
    }

    /// Whether ports come with threads.
    fn has_threads(&self) -> bool {
        self.links.carriers.uses(Carrier::Network)
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
            return Err(Impossible::new("links.lock_step", "true in lock step, and only there"));
        }
        let faults = &self.links.faults;
        let lock_step = if self.links.lock_step { faults.check_lock_step() } else { Ok(()) };
        faults
            .check()
            .and(lock_step)
            .map_err(|error| Impossible::new(error.key, error.expected).under("links.faults"))?;
        if EnvFilter::try_new(&self.log).is_err() {
            return Err(Impossible::new(
                "log",
                "a level (error, warn, info, debug, trace) or a list of module=level",
            ));
        }
        Ok(())
    }
}
