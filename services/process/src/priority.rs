//! Who goes first when processors are short.

use rustix::process::setpriority_process;
use thread_priority::unix::{
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};
use thread_priority::{
    Error, NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority,
    ThreadPriorityValue, ThreadSchedulePolicy,
};

/// Priority among the real-time threads of the machine, from 1 to 99: before everything that has none, behind what serves hardware.
pub const PRIORITY: u8 = 10;

/// Of what watches all of them, beyond all that can be asked for.
const PRIORITY_OF_WITNESS: u8 = 50;

/// Real-time threads of the same priority take no turns: each runs until it waits.
const FIFO: ThreadSchedulePolicy =
    ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);

/// The greatest niceness.
const LAST: i32 = 19;

/// What the crate makes niceness 0 of.
const NICE_0: u8 = 48;

/// The calling thread, and every thread that it starts from now on, runs with `priority` before all that is no real-time thread (`SCHED_FIFO`).
///
/// For what a command waits for, in real time. A kernel that is built for throughput lets a busy thread finish its slice of some
/// milliseconds first, on each of the five threads through which a state and its command pass on the network.
///
/// Where the system does not permit it, nothing changes: that is logged, since it explains late commands.
pub fn go_first(priority: u8) {
    match set(priority, FIFO) {
        Ok(()) => tracing::info!(priority, "runs as a real-time thread"),
        Err(error) => {
            tracing::info!(%error, "runs among all others: a real-time priority is not permitted (see docs/how-to/real-time-priority.md)");
        }
    }
}

/// The calling thread goes behind those that go first, and before everything else, if that is permitted.
pub(crate) fn go_before_the_rest() {
    let _ = set(1, FIFO);
}

/// The calling thread goes before those that go first, if that is permitted.
pub(crate) fn go_before_everything() {
    let _ = set(PRIORITY_OF_WITNESS, FIFO);
}

/// Whether a thread may go first here.
pub fn may_go_first() -> bool {
    is_permitted(PRIORITY)
}

/// Whether a thread may have this real-time priority here.
pub(crate) fn is_permitted(priority: u8) -> bool {
    std::thread::spawn(move || set(priority, FIFO).is_ok()).join().unwrap_or(false)
}

/// The calling thread, if it goes first, runs among all others again.
pub fn step_back() {
    if thread_schedule_policy() != Ok(FIFO) {
        return;
    }
    if let Err(error) = set(NICE_0, ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other))
    {
        tracing::warn!(%error, "a thread that nothing waits for stays a real-time thread");
    }
}

/// The calling thread is served last of all that have no real-time priority: for work beside a graph that it must not disturb.
pub fn give_way() {
    // On Linux a niceness is a thread's own. Whoever may not even step back stays where it is.
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
    fn who_gives_way_is_served_last_and_nobody_else_is() {
        let now = || getpriority_process(None).ok();
        let before = now();
        let given = thread::spawn(move || {
            give_way();
            now()
        });
        assert_eq!((given.join().ok().flatten(), now()), (Some(LAST), before));
    }

    #[test]
    fn what_a_thread_that_goes_first_starts_goes_first_until_it_steps_back() {
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
            "where it is permitted, and only there, it goes first"
        );
    }
}
