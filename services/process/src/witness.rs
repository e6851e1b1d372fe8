//! Detects stalls of the machine.

use crate::Stop;
use crate::priority;
use protocol::clock::monotonic_nanos;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Interval between two checks of the clock.
const LOOK: Duration = Duration::from_millis(1);

/// A check that is later than this was stalled \[ns\].
const LATE_NANOS: u64 = 2_000_000;

/// A time in which a thread above all processes of a graph did not run on one of the processors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Last check before it, on the monotonic clock \[ns\].
    pub from_nanos: u64,
    /// First check after it \[ns\].
    pub to_nanos: u64,
}

/// Checks every allowed processor for [`Gap`]s: time that another process, or the host of a virtual
/// machine, has taken.
///
/// Its threads have a higher priority than those of a graph, if permitted, so that a slow graph
/// causes no gap. Without permission, everything that stalls a graph causes one.
pub struct Witness {
    stop: Stop,
    looking: Vec<JoinHandle<Vec<Gap>>>,
}

impl Witness {
    /// Starts the checks.
    pub fn begin() -> Self {
        let stop = Stop::new();
        let allowed = sched_getaffinity(None).ok();
        let processors = (0..CpuSet::MAX_CPU)
            .filter(|&one| allowed.as_ref().is_some_and(|allowed| allowed.is_set(one)));
        let look = |processor| {
            let stop = stop.clone();
            thread::spawn(move || look(processor, &stop))
        };
        let looking = processors.map(look).collect();
        Self { stop, looking }
    }

    /// Stops the checks, and returns the gaps of all processors in the order of time.
    pub fn end(self) -> Vec<Gap> {
        self.stop.request();
        let mut gaps: Vec<Gap> =
            self.looking.into_iter().flat_map(|thread| thread.join().unwrap_or_default()).collect();
        gaps.sort_by_key(|gap| gap.from_nanos);
        gaps
    }
}

/// Checks the clock on one processor until a stop is requested.
fn look(processor: usize, stop: &Stop) -> Vec<Gap> {
    let mut one = CpuSet::new();
    one.set(processor);
    // If the thread cannot be pinned, it checks the processor that it runs on.
    let _ = sched_setaffinity(None, &one);
    priority::go_before_everything();
    let mut gaps = Vec::new();
    let mut from_nanos = monotonic_nanos();
    while !stop.requested() {
        thread::sleep(LOOK);
        let to_nanos = monotonic_nanos();
        if to_nanos - from_nanos > LATE_NANOS + LOOK.as_nanos() as u64 {
            gaps.push(Gap { from_nanos, to_nanos });
        }
        from_nanos = to_nanos;
    }
    gaps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_exceed_the_late_limit_and_are_in_the_order_of_time() {
        let begin = monotonic_nanos();
        let witness = Witness::begin();
        thread::sleep(Duration::from_millis(300));
        let gaps = witness.end();
        let end = monotonic_nanos();
        assert!(
            gaps.iter().all(|gap| begin <= gap.from_nanos
                && gap.from_nanos + LATE_NANOS < gap.to_nanos
                && gap.to_nanos <= end),
            "{gaps:?}"
        );
        assert!(gaps.is_sorted_by_key(|gap| gap.from_nanos), "{gaps:?}");
    }
}
