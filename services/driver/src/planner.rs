//! planner → gate: the lists of obstacles of planners on this machine, and of the scenario.
//!
//! ```text
//! socket ─▶ thread of each connection: check ── list ──▶ slot ──▶ control thread, once per period
//! planner ◀── accepted or rejected ──┘
//! ```
//! The newest list displaces an older one in the slot. The control thread neither locks nor
//! allocates, and frees nothing: it returns each list through a second slot.

use crate::{PlannerList, ScheduledList};
use crossbeam_queue::ArrayQueue;
use process::lists::{LINE_BYTES_MAX, Verdict, socket};
use process::{Pace, Run, step_back};
use protocol::clock::monotonic_nanos;
use protocol::message::Obstacles;
use std::fs;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use transport::Tally;

/// Interval between two looks for a new connection, or for the end of the run.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wait for a planner that does not read its replies.
const WRITES_WITHIN: Duration = Duration::from_secs(1);
/// Most planners at one time.
const PLANNERS_MAX: usize = 8;

/// Why a line is rejected.
#[derive(Debug, thiserror::Error)]
enum Rejection {
    #[error("expected lines of at most {LINE_BYTES_MAX} bytes")]
    TooLong,
    #[error("in lock step lists are in the scenario: the same settings give the same bits")]
    LockStep,
    #[error("this is no list of obstacles: {0}")]
    Json(#[from] serde_json::Error),
    #[error(transparent)]
    List(#[from] crate::ImpossiblePlannerList),
}

/// A checked list.
struct Arrived {
    list: Box<Obstacles>,
    /// Time of its arrival \[ns\].
    nanos: u64,
}

/// What the threads exchange.
struct Slot {
    newest: ArrayQueue<Arrived>,
    used: ArrayQueue<Box<Obstacles>>,
    accepted: AtomicU64,
    rejected: AtomicU64,
    done: AtomicBool,
}

/// The lists of planners.
pub(crate) struct Planner {
    /// Tick and list of each of the scenario, the next one last.
    scheduled: Vec<(u64, Box<Obstacles>)>,
    /// The list that acts, if it is one of the socket.
    acting: Option<Box<Obstacles>>,
    slot: Arc<Slot>,
    thread: Option<JoinHandle<()>>,
}

impl Planner {
    /// Opens the socket, if the run accepts requests.
    pub(crate) fn open(run: &Run, scheduled: &[ScheduledList]) -> Self {
        let period_s = run.period_nanos as f64 * 1e-9;
        let messages = scheduled.iter().filter_map(|one| {
            // They have been checked with the other settings.
            let list = one.list.message().ok()?;
            Some(((one.at_s / period_s).round() as u64, list))
        });
        let mut scheduled: Vec<_> = messages.collect();
        // Of two at one tick the later one wins.
        scheduled.sort_by_key(|(tick, _)| *tick);
        scheduled.reverse();
        let slot = Arc::new(Slot {
            newest: ArrayQueue::new(1),
            used: ArrayQueue::new(2 * PLANNERS_MAX),
            accepted: AtomicU64::new(0),
            rejected: AtomicU64::new(0),
            done: AtomicBool::new(false),
        });
        let thread = process::requests::are_welcome(&run.folder).then(|| listen(run, &slot));
        Self { scheduled, acting: None, slot, thread: thread.flatten() }
    }

    /// The list that acts from `tick` on, if there is a new one.
    pub(crate) fn due(&mut self, tick: u64) -> Option<&mut Obstacles> {
        let mut is_due = false;
        while self.scheduled.last().is_some_and(|(at, _)| *at <= tick) {
            self.give_back();
            self.acting = self.scheduled.pop().map(|(_, list)| list);
            is_due = true;
        }
        if let Some(Arrived { mut list, nanos }) = self.slot.newest.pop() {
            self.give_back();
            list.age_s += monotonic_nanos().saturating_sub(nanos) as f64 * 1e-9;
            self.acting = Some(list);
            is_due = true;
        }
        self.acting.as_deref_mut().filter(|_| is_due)
    }

    /// Lets another thread free the list that acts.
    fn give_back(&mut self) {
        if let Some(list) = self.acting.take()
            && let Err(list) = self.slot.used.push(list)
        {
            // The threads of the planners empty the slot with each list. If it were full, a leak is
            // better than freeing the list here.
            Box::leak(list);
        }
    }

    /// Numbers of accepted and rejected lists.
    pub(crate) fn tally(&self) -> Tally {
        let [received, refused] = [&self.slot.accepted, &self.slot.rejected]
            .map(|counter| counter.load(Ordering::Relaxed));
        Tally { received, refused, ..Tally::default() }
    }
}

impl Drop for Planner {
    fn drop(&mut self) {
        self.slot.done.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has logged the reason.
            let _ = thread.join();
        }
    }
}

/// Whether a planner has sent a list to this plant before it was restarted.
pub(crate) fn had_planner(run: &Run) -> bool {
    run.restarted && mark(&run.links.root).exists()
}

/// The file that stays when a planner has sent a list.
fn mark(root: &Path) -> PathBuf {
    root.join("has-planner")
}

/// Starts the thread that waits for planners; none if the socket cannot be made.
fn listen(run: &Run, slot: &Arc<Slot>) -> Option<JoinHandle<()>> {
    let (root, pace) = (run.links.root.clone(), run.pace);
    let listener = match bind(&socket(&root)) {
        Ok(listener) => listener,
        Err(error) => {
            tracing::warn!(%error, socket = %socket(&root).display(), "planners cannot connect");
            return None;
        }
    };
    let slot = Arc::clone(slot);
    Some(thread::spawn(move || {
        step_back();
        accept(&listener, &Planners { slot: &slot, root: &root, pace });
    }))
}

/// Takes the place of a plant that was killed.
fn bind(socket: &Path) -> io::Result<UnixListener> {
    if let Err(error) = fs::remove_file(socket)
        && error.kind() != io::ErrorKind::NotFound
    {
        return Err(error);
    }
    let listener = UnixListener::bind(socket)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

fn accept(listener: &UnixListener, planners: &Planners<'_>) {
    let connected = AtomicU64::new(0);
    thread::scope(|scope| {
        while !planners.slot.done.load(Ordering::Acquire) {
            let Ok((stream, _)) = listener.accept() else {
                thread::sleep(LOOK);
                continue;
            };
            if connected.fetch_add(1, Ordering::Relaxed) >= PLANNERS_MAX as u64 {
                connected.fetch_sub(1, Ordering::Relaxed);
                tracing::warn!("a planner was refused: {PLANNERS_MAX} are connected");
                continue;
            }
            let connected = &connected;
            scope.spawn(move || {
                if let Err(error) = planners.serve(&stream) {
                    tracing::debug!(%error, "a planner has gone");
                }
                connected.fetch_sub(1, Ordering::Relaxed);
            });
        }
    });
}

/// What the thread of each connection needs.
struct Planners<'a> {
    slot: &'a Slot,
    root: &'a Path,
    pace: Pace,
}

impl Planners<'_> {
    /// Replies to each line of one planner, until it closes the connection or the run ends.
    fn serve(&self, stream: &UnixStream) -> io::Result<()> {
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(LOOK))?;
        stream.set_write_timeout(Some(WRITES_WITHIN))?;
        let (mut reader, mut writer) = (BufReader::new(stream), stream);
        let mut line = Vec::new();
        loop {
            let room = (LINE_BYTES_MAX - line.len()) as u64;
            match reader.by_ref().take(room).read_until(b'\n', &mut line) {
                Ok(0) => return Ok(()),
                Ok(_) if line.ends_with(b"\n") => {
                    reply(&mut writer, &self.judge(self.take(&line)))?;
                    line.clear();
                }
                Ok(_) if line.len() == LINE_BYTES_MAX => {
                    return reply(&mut writer, &self.judge(Err(Rejection::TooLong)));
                }
                Ok(_) => {}
                Err(error) if is_idle(&error) && !self.slot.done.load(Ordering::Acquire) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Puts the list of a line into the slot.
    fn take(&self, line: &[u8]) -> Result<(), Rejection> {
        if self.pace == Pace::LockStep {
            return Err(Rejection::LockStep);
        }
        let list = serde_json::from_slice::<PlannerList>(line)?.message()?;
        if self.slot.accepted.load(Ordering::Relaxed) == 0
            && let Err(error) = fs::write(mark(self.root), "")
        {
            tracing::warn!(%error, "a restarted plant will not know that there is a planner");
        }
        while self.slot.used.pop().is_some() {}
        self.slot.newest.force_push(Arrived { list, nanos: monotonic_nanos() });
        Ok(())
    }

    /// Counts a list.
    fn judge(&self, outcome: Result<(), Rejection>) -> Verdict {
        let (counter, verdict) = match outcome {
            Ok(()) => (&self.slot.accepted, Verdict::Accepted),
            Err(error) => (&self.slot.rejected, Verdict::Rejected { reason: error.to_string() }),
        };
        counter.fetch_add(1, Ordering::Relaxed);
        verdict
    }
}

fn reply(writer: &mut impl Write, verdict: &Verdict) -> io::Result<()> {
    let mut line = serde_json::to_vec(verdict)?;
    line.push(b'\n');
    writer.write_all(&line)
}

/// Whether there is nothing to read now.
fn is_idle(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), Interrupted | TimedOut | WouldBlock)
}

#[cfg(test)]
mod tests {
    use super::*;
    use process::lists::Lists;
    use process::requests::welcome;
    use std::error::Error;
    use transport::Links;

    type Outcome = Result<(), Box<dyn Error>>;

    fn run(folder: &Path, lock_step: bool) -> Run {
        let links = Links::on_this_machine("planner", folder.to_owned(), lock_step, 0);
        Run::new(folder, 100_000_000, links)
    }

    fn list(valid_s: f64) -> String {
        format!("{{\"valid_s\": {valid_s},\n\"obstacles\": [{{\"corners_m\": [[1.0, 2.0]]}}]}}")
    }

    #[test]
    fn the_newest_list_acts_from_the_next_tick_on() -> Outcome {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let run = run(folder.path(), false);
        let mut planner = Planner::open(&run, &[]);
        assert!(planner.due(0).is_none());
        let mut lists = Lists::new(folder.path());
        for valid_s in [1.0, 2.0] {
            assert_eq!(lists.send(&list(valid_s))?, Verdict::Accepted);
        }
        let due = planner.due(1).ok_or("no list")?;
        assert_eq!((due.valid_s, due.count), (2.0, 1));
        assert!(due.age_s > 0.0, "the wait counts");
        assert!(planner.due(2).is_none());
        Ok(())
    }

    #[test]
    fn a_bad_list_is_rejected_and_the_connection_stays() -> Outcome {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let mut planner = Planner::open(&run(folder.path(), false), &[]);
        let mut lists = Lists::new(folder.path());
        for bad in ["stop", "{}", "", r#"{"valid_s": 1.0, "obstacles": [{"corners_m": []}]}"#] {
            let verdict = lists.send(bad)?;
            assert!(matches!(verdict, Verdict::Rejected { .. }), "{bad}: {verdict:?}");
        }
        assert!(planner.due(0).is_none());
        assert_eq!(lists.send(&list(1.0))?, Verdict::Accepted);
        assert_eq!((planner.tally().received, planner.tally().refused), (1, 4));
        Ok(())
    }

    #[test]
    fn a_line_without_end_is_rejected_and_ends_its_connection() -> Outcome {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let planner = Planner::open(&run(folder.path(), false), &[]);
        let mut stream = UnixStream::connect(socket(folder.path()))?;
        stream.write_all(&vec![b' '; LINE_BYTES_MAX])?;
        let mut reply = String::new();
        stream.read_to_string(&mut reply)?;
        assert!(matches!(serde_json::from_str(&reply)?, Verdict::Rejected { .. }), "{reply}");
        assert_eq!(planner.tally().refused, 1);
        assert_eq!(Lists::new(folder.path()).send(&list(1.0))?, Verdict::Accepted);
        Ok(())
    }

    #[test]
    fn in_lock_step_each_list_of_the_scenario_acts_at_its_tick_and_no_other_does() -> Outcome {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let of = |at_s, valid_s| -> Result<ScheduledList, serde_json::Error> {
            Ok(ScheduledList { at_s, list: serde_json::from_str(&list(valid_s))? })
        };
        let scheduled = [of(2.0, 5.0)?, of(1.0, 4.0)?, of(1.0, 3.0)?];
        let mut planner = Planner::open(&run(folder.path(), true), &scheduled);
        let verdict = Lists::new(folder.path()).send(&list(1.0))?;
        assert!(matches!(verdict, Verdict::Rejected { .. }), "{verdict:?}");
        let due: Vec<(u64, f64)> =
            (0..40).filter_map(|tick| planner.due(tick).map(|list| (tick, list.valid_s))).collect();
        assert_eq!(due, [(10, 3.0), (20, 5.0)]);
        Ok(())
    }

    #[test]
    fn a_restarted_plant_knows_that_there_is_a_planner() -> Outcome {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let restarted = Run { restarted: true, ..run(folder.path(), false) };
        assert!(!had_planner(&restarted));
        let planner = Planner::open(&restarted, &[]);
        Lists::new(folder.path()).send(&list(1.0))?;
        drop(planner);
        assert!(had_planner(&restarted));
        // The socket of the first one is still there.
        let _planner = Planner::open(&restarted, &[]);
        assert_eq!(Lists::new(folder.path()).send(&list(1.0))?, Verdict::Accepted);
        Ok(())
    }
}
