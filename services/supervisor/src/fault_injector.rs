//! Injects the faults of a file into processes, and records the times.

use crate::memory_filler::MemoryFiller;
use crate::processes_by_role::ProcessesByRole;
use graph::faults::{ProcessFault, ProcessFaultKind};
use process::Stop;
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use rustix::process::{Pid, Resource, Rlimit, Signal, kill_process, prlimit};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Name of the record in the run directory, one JSON object per line.
pub const LIST: &str = "injected.jsonl";

/// Interval between two checks: precision of the times, and delay of the end.
const LOOK: Duration = Duration::from_micros(200);
/// Longest wait for a process that does not run: it is being restarted.
const ABSENT: Duration = Duration::from_secs(5);

/// One injected fault.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Injected {
    /// Its kind, by the name in the file of faults.
    pub kind: String,
    /// The affected role.
    pub participant: Option<Participant>,
    /// Its process.
    pub pid: Option<i32>,
    /// Time of the injection, on the monotonic clock \[ns\].
    pub nanos: u64,
    /// Duration, if it is limited \[ms\].
    pub millis: Option<u64>,
}

/// Injects faults on a thread of its own until it is dropped.
#[derive(Debug)]
pub struct FaultInjector {
    stop: Stop,
    thread: Option<JoinHandle<()>>,
}

/// One injection.
#[derive(Debug, Clone, Copy)]
struct Deed {
    at: Duration,
    kind: ProcessFaultKind,
    participant: Option<Participant>,
    lasts: Duration,
    bytes: u64,
}

impl FaultInjector {
    /// Starts with `faults` now, which is when the robot begins to drive, and creates the record in
    /// the run directory.
    ///
    /// # Errors
    /// If the record cannot be created.
    pub fn begin(
        faults: &[ProcessFault],
        seed: u64,
        period: Duration,
        processes_by_role: ProcessesByRole,
        folder: &Path,
    ) -> io::Result<Self> {
        let begin = Instant::now();
        let mut deeds: Vec<Deed> =
            faults.iter().flat_map(|fault| deeds(fault, period, seed)).collect();
        deeds.sort_by_key(|deed| deed.at);
        let list = File::create(folder.join(LIST))?;
        let stop = Stop::new();
        let work = Work { begin, processes_by_role, list, stop: stop.clone() };
        let thread = thread::Builder::new()
            .name("fault_injector".into())
            .spawn(move || work.work(&deeds))?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for FaultInjector {
    fn drop(&mut self) {
        self.stop.request();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn deeds(fault: &ProcessFault, period: Duration, seed: u64) -> impl Iterator<Item = Deed> + use<> {
    let (kind, participant, lasts) =
        (fault.kind, fault.participant, Duration::from_millis(fault.millis.unwrap_or(0)));
    let bytes = fault.mebibytes.unwrap_or(0) << 20;
    fault.times(period, seed).map(move |at| Deed { at, kind, participant, lasts, bytes })
}

struct Work {
    begin: Instant,
    processes_by_role: ProcessesByRole,
    list: File,
    stop: Stop,
}

impl Work {
    fn work(mut self, deeds: &[Deed]) {
        for deed in deeds {
            self.sleep_until(self.begin + deed.at);
            if self.stop.requested() {
                return;
            }
            self.commit(deed);
        }
    }

    fn commit(&mut self, deed: &Deed) {
        let Some(participant) = deed.participant else {
            if deed.kind == ProcessFaultKind::SharedMemory {
                self.take_shared_memory(deed);
            } else {
                self.note(deed, None);
                self.hog(deed.lasts);
            }
            return;
        };
        let deadline = Instant::now() + ABSENT;
        let mut struck = self.strike(participant, deed);
        while struck.is_none() && Instant::now() < deadline && !self.stop.requested() {
            thread::sleep(LOOK);
            struck = self.strike(participant, deed);
        }
        let victim = match struck {
            Some(Ok(victim)) => victim,
            Some(Err(error)) => {
                tracing::error!(
                    %participant,
                    kind = deed.kind.name(),
                    %error,
                    "a fault could not be injected"
                );
                return;
            }
            None => {
                tracing::error!(
                    %participant,
                    kind = deed.kind.name(),
                    "no process to inject a fault into for {ABSENT:?}"
                );
                return;
            }
        };
        self.note(deed, Some(victim));
        if deed.kind == ProcessFaultKind::Stop {
            self.sleep_until(Instant::now() + deed.lasts);
            let processes_by_role = self.processes_by_role.lock();
            if processes_by_role.get(&participant) == Some(&victim) {
                let _ = kill_process(victim, Signal::CONT);
            }
        }
    }

    /// The affected process, if one runs.
    fn strike(&self, participant: Participant, deed: &Deed) -> Option<rustix::io::Result<Pid>> {
        let processes_by_role = self.processes_by_role.lock();
        let victim =
            *processes_by_role.get(&participant).filter(|&&victim| !awaits_burial(victim))?;
        let limit = |resource| {
            let limit = Rlimit { current: Some(deed.bytes), maximum: Some(deed.bytes) };
            prlimit(Some(victim), resource, limit).map(drop)
        };
        let done = match deed.kind {
            ProcessFaultKind::Kill => kill_process(victim, Signal::KILL),
            ProcessFaultKind::Stop => kill_process(victim, Signal::STOP),
            ProcessFaultKind::Memory => limit(Resource::As),
            ProcessFaultKind::Disk => limit(Resource::Fsize),
            ProcessFaultKind::Hog | ProcessFaultKind::SharedMemory => Ok(()),
        };
        Some(done.map(|()| victim))
    }

    /// Fills the shared memory up to a remainder, for a time.
    fn take_shared_memory(&mut self, deed: &Deed) {
        match MemoryFiller::taking_all_but(deed.bytes) {
            Ok(_memory_filler) => {
                self.note(deed, None);
                self.sleep_until(Instant::now() + deed.lasts);
            }
            Err(error) => {
                tracing::error!(kind = deed.kind.name(), %error, "a fault could not be injected");
            }
        }
    }

    /// Keeps every processor busy.
    fn hog(&self, lasts: Duration) {
        let end = Instant::now() + lasts;
        let processors = thread::available_parallelism().map_or(1, usize::from);
        thread::scope(|scope| {
            for _ in 0..processors {
                scope.spawn(|| while Instant::now() < end && !self.stop.requested() {});
            }
        });
    }

    fn note(&mut self, deed: &Deed, victim: Option<Pid>) {
        let (kind, participant) = (deed.kind.name().to_owned(), deed.participant);
        let millis = (!deed.lasts.is_zero()).then_some(deed.lasts.as_millis() as u64);
        let injected = Injected {
            kind,
            participant,
            pid: victim.map(Pid::as_raw_pid),
            nanos: monotonic_nanos(),
            millis,
        };
        let line = serde_json::to_string(&injected).map_err(io::Error::other);
        if let Err(error) = line.and_then(|line| writeln!(self.list, "{line}")) {
            tracing::error!(%error, "an injected fault is not in the list");
        }
        tracing::warn!(
            kind = injected.kind,
            participant = ?injected.participant,
            pid = ?injected.pid,
            "fault injected"
        );
    }

    fn sleep_until(&self, at: Instant) {
        while !self.stop.requested() {
            let left = at.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            thread::sleep(left.min(Duration::from_millis(20)));
        }
    }
}

/// Whether a process is a zombie, which its parent has not reaped yet.
fn awaits_burial(process: Pid) -> bool {
    let stat =
        std::fs::read_to_string(format!("/proc/{}/stat", process.as_raw_pid())).unwrap_or_default();
    stat.rsplit_once(')').is_none_or(|(_, state)| state.trim_start().starts_with(['Z', 'X']))
}
