//! When the machine let nobody run.

use crate::Stop;
use crate::priority;
use protocol::clock::monotonic_nanos;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// How often it looks at the clock.
const LOOK: Duration = Duration::from_millis(1);

/// A look that is later than this was kept from happening \[ns\].
const LATE_NANOS: u64 = 2_000_000;

/// A time in which a thread that goes before every process of a graph did not run on one of the processors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The last look before it, on the monotonic clock \[ns\].
    pub from_nanos: u64,
    /// The first look after it \[ns\].
    pub to_nanos: u64,
}

/// Watches every processor that it may use for [`Gap`]s: time that somebody else on the machine has taken, or the machine's own host.
///
/// Its threads go before those of a graph, where that is permitted, so that no slowness of the graph's own makes a gap. Where it is not,
/// everything that keeps a graph from running makes one.
pub struct Witness {
    stop: Stop,
    looking: Vec<JoinHandle<Vec<Gap>>>,
}

impl Witness {
    /// Begins to watch.
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

    /// Ends, and gives the gaps of all processors in the order of time.
    pub fn end(self) -> Vec<Gap> {
        self.stop.request();
        let mut gaps: Vec<Gap> =
            self.looking.into_iter().flat_map(|thread| thread.join().unwrap_or_default()).collect();
        gaps.sort_by_key(|gap| gap.from_nanos);
        gaps
    }
}

/// Looks at the clock on one processor until it is told to stop.
fn look(processor: usize, stop: &Stop) -> Vec<Gap> {
    let mut one = CpuSet::new();
    one.set(processor);
    // Where a thread may not choose, it watches wherever it runs.
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
    fn gaps_are_longer_than_what_is_late_and_in_the_order_of_time() {
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
