//! Processors of a process, locking of its memory, and its real-time priority.

use crate::priority;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, sched_getaffinity, sched_setaffinity};
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};

/// Largest allowed priority: hardware interrupts have priorities from 50 on.
const PRIORITY_MAX: u8 = 49;

/// Settings of the scheduling. By default the system decides, except for the priority and the
/// memory of processes on the control path.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scheduling {
    /// Processors that it may run on, by the numbers of the system; all if the list is empty.
    pub processors: Vec<usize>,
    /// Whether all its memory, present and later, is loaded and locked. If absent: that of plant
    /// and controller in real time, where that is permitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lock_memory: Option<bool>,
    /// Real-time priority (`SCHED_FIFO`) of plant and controller in real time; 0 for none. If
    /// absent: 10, where that is permitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub real_time_priority: Option<u8>,
}

/// Why the system does not apply the settings.
#[derive(Debug, thiserror::Error)]
pub enum SchedulingError {
    /// There are no such processors, or the process may not run on them.
    #[error(
        "scheduling.processors = {asked:?}: expected some of {there:?}, which are allowed here"
    )]
    Processors {
        /// Processors of the settings.
        asked: Vec<usize>,
        /// Allowed processors.
        there: Vec<usize>,
    },
    /// Memory cannot be locked.
    #[error(
        "scheduling.lock_memory: not permitted, expected the capability CAP_IPC_LOCK, \
         or no limit of locked memory (`ulimit -l unlimited`; it is {})",
        .limit_kibibytes.map_or("none".to_owned(), |limit| format!("{limit} KiB"))
    )]
    Memory {
        /// Present limit.
        limit_kibibytes: Option<u64>,
    },
    /// A real-time priority is not permitted.
    #[error(
        "scheduling.real_time_priority = {asked}: not permitted, expected the capability \
         CAP_SYS_NICE, or a limit of at least that (`ulimit -r`)"
    )]
    Priority {
        /// Priority of the settings.
        asked: u8,
    },
}

impl Check for Scheduling {
    fn check(&self) -> Result<(), Impossible> {
        if let Some(index) = self.processors.iter().position(|&one| one >= CpuSet::MAX_CPU) {
            return Err(Impossible::new(
                format!("processors.{index}"),
                format!("a processor from 0 to {}", CpuSet::MAX_CPU - 1),
            ));
        }
        if self.real_time_priority.is_some_and(|priority| priority > PRIORITY_MAX) {
            return Err(Impossible::new(
                "real_time_priority",
                format!("0 for none, or 1 to {PRIORITY_MAX}"),
            ));
        }
        Ok(())
    }
}

impl Scheduling {
    /// Applies the settings to the calling process, before it starts threads that work. A priority
    /// is only checked here. The threads on the control path take it later.
    ///
    /// # Errors
    /// [`SchedulingError`] if the system refuses.
    pub fn apply(&self) -> Result<(), SchedulingError> {
        self.stay_on_processors()?;
        if self.lock_memory == Some(true) {
            keep_memory()?;
        }
        match self.real_time_priority {
            Some(asked) if asked > 0 && !priority::is_permitted(asked) => {
                Err(SchedulingError::Priority { asked })
            }
            _ => Ok(()),
        }
    }

    /// Locks the memory of a process on the control path, if its settings do not say whether to. A
    /// period that waits for a page of its program from a disk can last for a quarter of a second.
    ///
    /// Without permission nothing changes. That is logged, because it explains late commands.
    pub(crate) fn lock_memory_if_permitted(&self) {
        if self.lock_memory.is_some() {
            return;
        }
        if keep_memory().is_ok() {
            tracing::info!("all memory is locked");
        } else {
            tracing::info!(
                "memory is not locked: not permitted; see docs/how-to/real-time-priority.md"
            );
        }
    }

    fn stay_on_processors(&self) -> Result<(), SchedulingError> {
        if self.processors.is_empty() {
            return Ok(());
        }
        let allowed = sched_getaffinity(None).unwrap_or_default();
        let mut asked = CpuSet::new();
        self.processors.iter().for_each(|&one| asked.set(one));
        let all_there = self.processors.iter().all(|&one| allowed.is_set(one));
        if all_there && sched_setaffinity(None, &asked).is_ok() {
            return Ok(());
        }
        let there = (0..CpuSet::MAX_CPU).filter(|&one| allowed.is_set(one)).collect();
        Err(SchedulingError::Processors { asked: self.processors.clone(), there })
    }
}

/// Checks the limit first: under a limit the system locks the present memory, and later allocations
/// fail.
fn keep_memory() -> Result<(), SchedulingError> {
    let limit = getrlimit(Resource::Memlock).current;
    let may = limit.is_none()
        || capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    let refused = SchedulingError::Memory { limit_kibibytes: limit.map(|bytes| bytes / 1024) };
    if may && mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).is_ok() {
        Ok(())
    } else {
        Err(refused)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_error_names_a_setting_that_is_impossible_on_every_system() {
        let refused = |text: &str| {
            settings::parse::<Scheduling>(text, Path::new("s.toml"))
                .err()
                .map(|error| error.to_string())
        };
        assert_eq!(
            refused("processors = [0, 1]\nlock_memory = true\nreal_time_priority = 49\n"),
            None
        );
        for (text, parts) in [
            ("processors = [0, 4096]\n", ["s.toml:1: processors.1 = 4096", "0 to 1023"]),
            ("real_time_priority = 50\n", ["s.toml:1: real_time_priority = 50", "1 to 49"]),
            ("processors = [-1]\n", ["processors", "-1"]),
        ] {
            let message = refused(text).unwrap_or_default();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}
