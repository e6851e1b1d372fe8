//! The monotonic clock that stamps carry.

use rustix::time::{ClockId, clock_gettime};

/// Nanoseconds on this machine's monotonic clock \[ns\].
///
/// All processes of one machine read the same clock. Two machines do not share it, so no decision
/// compares the stamps of two writers.
pub fn monotonic_nanos() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    let seconds = u64::try_from(now.tv_sec).unwrap_or(0);
    let nanos = u64::try_from(now.tv_nsec).unwrap_or(0);
    seconds * 1_000_000_000 + nanos
}
