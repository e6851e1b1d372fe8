//! Priority of threads.

use rustix::process::setpriority_process;
use thread_priority::unix::{
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};
use thread_priority::{
    Error, NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority,
    ThreadPriorityValue, ThreadSchedulePolicy,
};

/// Priority among the real-time threads of the machine, from 1 to 99: above all threads without
/// real-time priority, below those that serve hardware.
pub const PRIORITY: u8 = 10;

/// Priority of the stall monitor, above all priorities that settings allow.
const PRIORITY_OF_WITNESS: u8 = 50;

/// Real-time threads of the same priority do not share time slices: each runs until it waits.
const FIFO: ThreadSchedulePolicy =
    ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);

/// Largest niceness.
const LAST: i32 = 19;

/// The crate's value for niceness 0.
const NICE_0: u8 = 48;

/// Gives the calling thread, and all threads that it starts later, the real-time priority
/// `priority` (`SCHED_FIFO`), above all threads without one.
///
/// It is for the threads on the path of a command, in real time. A kernel that is built for
/// throughput lets a busy thread finish its slice of some milliseconds first. On the network, a
/// state and its command pass through five threads, and each may wait for that.
///
/// Without permission nothing changes. That is logged, because it explains late commands.
pub fn go_first(priority: u8) {
    match set(priority, FIFO) {
        Ok(()) => tracing::info!(priority, "runs as a real-time thread"),
        Err(error) => {
            tracing::info!(
                %error,
                "runs without real-time priority: not permitted; \
                 see docs/how-to/real-time-priority.md"
            );
        }
    }
}

/// Places the calling thread below the threads of [`go_first`] and above all others, if permitted.
pub(crate) fn go_before_the_rest() {
    let _ = set(1, FIFO);
}

/// Places the calling thread above the threads of [`go_first`], if permitted: for threads that
/// stand for the machine, as the stall monitor and the cables of the fault drill.
pub fn go_before_everything() {
    let _ = set(PRIORITY_OF_WITNESS, FIFO);
}

/// Whether a thread may have the priority of [`go_first`] here.
pub fn may_go_first() -> bool {
    is_permitted(PRIORITY)
}

/// Whether a thread may have this real-time priority here.
pub(crate) fn is_permitted(priority: u8) -> bool {
    std::thread::spawn(move || set(priority, FIFO).is_ok()).join().unwrap_or(false)
}

/// Removes the real-time priority of the calling thread.
pub fn step_back() {
    if thread_schedule_policy() != Ok(FIFO) {
        return;
    }
    if let Err(error) = set(NICE_0, ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other))
    {
        tracing::warn!(%error, "a thread outside the control path keeps its real-time priority");
    }
}

/// Gives the calling thread the lowest priority of all threads without real-time priority: for work
/// that must not disturb a graph.
pub fn give_way() {
    // On Linux a niceness belongs to a thread. If it cannot be set, the thread keeps its own.
    let _ = setpriority_process(None, LAST);
}

fn set(priority: u8, policy: ThreadSchedulePolicy) -> Result<(), Error> {
    let priority =
        ThreadPriorityValue::try_from(priority).map_err(|_| Error::Priority("not from 0 to 99"))?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(priority),
        policy,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::process::getpriority_process;
    use std::thread;

    #[test]
    fn only_the_thread_that_gives_way_gets_the_largest_niceness() {
        let now = || getpriority_process(None).ok();
        let before = now();
        let given = thread::spawn(move || {
            give_way();
            now()
        });
        assert_eq!((given.join().ok().flatten(), now()), (Some(LAST), before));
    }

    #[test]
    fn a_started_thread_inherits_the_real_time_priority_until_it_steps_back() {
        let now = || (thread_schedule_policy().ok(), getpriority_process(None).ok());
        let before = now();
        let chain = thread::spawn(move || {
            go_first(PRIORITY);
            let started = thread::spawn(move || {
                let inherited = now();
                step_back();
                (inherited, now())
            });
            (now(), started.join().ok())
        });
        let (first, started) = chain.join().unwrap_or_default();
        assert_eq!(started, Some((first, before)), "a thread inherits it, and steps back alone");
        let permitted = thread::spawn(|| set(PRIORITY, FIFO).is_ok()).join().ok();
        assert_eq!(
            Some(first != before),
            permitted,
            "it has real-time priority where that is permitted, and only there"
        );
    }
}
