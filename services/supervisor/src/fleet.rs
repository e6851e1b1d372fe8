//! All processes of a graph: start in order, restart after a failure, stop in order.

mod event;

use crate::child::{Child, Ending, last_words};
use crate::processes_by_role::ProcessesByRole;
use crate::silence::Silence;
use crate::watch::View;
use graph::assembly::Assembly;
use graph::back_off::Restarts;
use graph::file::is_needed;
use graph::role::END_ORDER;
use process::{Pace, Run};
use protocol::message::{Participant, Phase};
use runs::epochs::{Epochs, unused_epoch};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};
use transport::Links;

pub use event::{Event, FleetError};

/// Longest time for a process to become ready.
const READY_WITHIN: Duration = Duration::from_mins(1);

/// Constants of a run.
#[derive(Debug)]
pub struct RunContext {
    /// Settings of each process.
    pub assembly: Assembly,
    /// Its links.
    pub links: Links,
    /// Directory of the binaries.
    pub programs: PathBuf,
    /// Run directory.
    pub folder: PathBuf,
}

/// All processes of one graph.
#[derive(Debug)]
pub struct Fleet<'a> {
    context: &'a RunContext,
    epochs: Epochs,
    members: BTreeMap<Participant, Member>,
    processes_by_role: ProcessesByRole,
    /// Time of the last round.
    tended: Option<Instant>,
}

/// One role, and its process.
#[derive(Debug, Default)]
struct Member {
    restarts: Restarts,
    state: State,
    silence: Silence,
}

#[derive(Debug, Default)]
enum State {
    #[default]
    Ended,
    Running(Child),
    /// Ended, with the time of its restart.
    Due(Instant),
}

impl<'a> Fleet<'a> {
    /// No process runs yet.
    ///
    /// # Errors
    /// If the epochs of the run cannot be read.
    pub fn new(context: &'a RunContext) -> io::Result<Self> {
        // A host that meets others uses epochs above those of any earlier launch, because the
        // others may know those.
        let meets = context.assembly.host.is_some();
        let since_1970 =
            SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let floor = if meets { since_1970.as_secs() } else { 0 };
        let mut epochs = Epochs::open(&context.folder.join("epochs.toml"), floor)?;
        if context.assembly.graph.pace == Pace::RealTime {
            epochs.observe(Participant::Plant, unused_epoch(since_1970))?;
        }
        Ok(Self {
            context,
            epochs,
            members: BTreeMap::new(),
            processes_by_role: ProcessesByRole::default(),
            tended: None,
        })
    }

    /// The process of each role.
    pub fn processes_by_role(&self) -> ProcessesByRole {
        self.processes_by_role.clone()
    }

    /// Number of restarts of all processes.
    pub fn restarts(&self) -> u64 {
        self.members.values().map(|member| member.restarts.total()).sum()
    }

    /// Process id and number of heartbeats of `role`; none before the first heartbeat.
    pub fn heartbeats(&mut self, role: Participant) -> Option<(u32, u64)> {
        let State::Running(child) = &mut self.members.get_mut(&role)?.state else { return None };
        Some((child.pid(), child.lifeline().beats())).filter(|(_, beats)| *beats > 0)
    }

    /// Starts the process of `role`, with new settings above all earlier epochs. Returns the
    /// highest of those.
    ///
    /// # Errors
    /// [`FleetError`].
    pub fn start(&mut self, role: Participant) -> Result<u64, FleetError> {
        let failed = |source| FleetError::System { role, source };
        let RunContext { assembly, links, programs, folder } = self.context;
        let epoch_floor = self.epochs.give(role).map_err(failed)?;
        let member = self.members.entry(role).or_default();
        let run = Run {
            folder: folder.clone(),
            log: assembly.log.clone(),
            epoch_floor,
            restarted: member.restarts.total() > 0,
            scheduling: assembly.graph.processes.of(role).scheduling.clone(),
            period_nanos: assembly.scenario.period_nanos(),
            pace: assembly.graph.pace,
            exposure: assembly.exposure(),
            #[cfg(feature = "faults")]
            links: Links {
                faults: assembly.faults.of_messages().in_process(role),
                ..links.clone()
            },
            #[cfg(not(feature = "faults"))]
            links: links.clone(),
        };
        let file = settings_file(folder, role);
        assembly.write_settings(role, run, &file)?;
        let program = programs.join(assembly.program(role));
        let child = Child::start(role, &program, &file, folder).map_err(failed)?;
        tracing::info!(%role, pid = child.pid(), epoch_floor, "started");
        self.processes_by_role.lock().insert(role, child.id());
        member.state = State::Running(child);
        member.silence = Silence::default();
        Ok(epoch_floor)
    }

    /// Whether the process of `role`, started at `since`, has reported that it is ready.
    ///
    /// # Errors
    /// [`FleetError`] if it has ended, or does not become ready in time.
    pub fn is_ready(&mut self, role: Participant, since: Instant) -> Result<bool, FleetError> {
        let Some(member) = self.members.get_mut(&role) else { return Ok(false) };
        let State::Running(child) = &mut member.state else { return Ok(false) };
        if let Some(ending) = bury(&self.processes_by_role, child)? {
            member.state = State::Ended;
            // A process that failed by itself fails again. One that was killed may become ready.
            let policy = self.context.assembly.graph.processes.of(role).restart_policy();
            if ending.is_kill() && member.restarts.after_death(&policy, Instant::now()).is_some() {
                tracing::warn!(%role, %ending, "ended before it was ready, and is restarted");
                self.start(role)?;
                return Ok(false);
            }
            return Err(FleetError::NeverReady {
                role,
                ending,
                last_words: last_words(&self.context.folder, role),
            });
        }
        let ready = child.lifeline().phase() != Phase::Starting;
        let processes = &self.context.assembly.graph.processes;
        let real_time = self.context.assembly.graph.pace == Pace::RealTime;
        if !ready && real_time && since.elapsed() > processes.hung_after(role) && child.is_stopped()
        {
            child.kill();
        }
        if !ready && since.elapsed() > READY_WITHIN {
            return Err(FleetError::TooSlow {
                role,
                last_words: last_words(&self.context.folder, role),
            });
        }
        Ok(ready)
    }

    /// Records the processes that have ended, and restarts those whose wait is over.
    ///
    /// # Errors
    /// [`FleetError`] if the run cannot continue.
    pub fn tend(&mut self, view: &View, now: Instant) -> Result<Vec<Event>, FleetError> {
        let mut events = Vec::new();
        let round = self
            .tended
            .replace(now)
            .map_or(Duration::ZERO, |before| now.saturating_duration_since(before));
        let real_time = self.context.assembly.graph.pace == Pace::RealTime;
        let has_finished =
            |role| view.health(role).is_some_and(|health| health.phase == Phase::Finished);
        for (&role, member) in &mut self.members {
            let State::Running(child) = &mut member.state else { continue };
            let Some(ending) = bury(&self.processes_by_role, child)? else {
                // In lock step a process that waits sends no heartbeat, and its own timeout ends
                // the run.
                let patience = self.context.assembly.graph.processes.hung_after(role);
                let beats = child.lifeline().beats();
                if real_time
                    && let Some(silence) =
                        member.silence.broken_by(beats, round, patience, || child.is_stopped())
                {
                    child.kill();
                    events.push(Event::Hung { role, silence });
                }
                continue;
            };
            member.state = State::Ended;
            // On a busy machine a plant that has finished may take so long to close its ports that
            // it counts as hung.
            if role == Participant::Plant && (ending.is_success() || has_finished(role)) {
                events.push(Event::Finished);
                continue;
            }
            let policy = self.context.assembly.graph.processes.of(role).restart_policy();
            // In lock step a bridge takes messages with it that no process sends again.
            let is_lost = role == Participant::Bridge && !real_time;
            let Some(wait) = member.restarts.after_death(&policy, now).filter(|_| !is_lost) else {
                // In lock step the other processes would wait forever for a learner or a recorder.
                if role == Participant::Gateway || real_time && !is_needed(role) {
                    events.push(Event::GivenUp { role, ending });
                    continue;
                }
                let last_words = last_words(&self.context.folder, role);
                return Err(FleetError::TooManyDeaths {
                    role,
                    ending,
                    per_minute: policy.per_minute,
                    last_words,
                });
            };
            member.state = State::Due(now + wait);
            events.push(Event::Died { role, ending, wait });
        }
        // The run ends with the plant, on whichever host it is; on a host that is not connected to
        // that one, with the controller.
        let finishes = self.context.assembly.finishes_with();
        if !self.members.contains_key(&finishes) && has_finished(finishes) {
            events.push(Event::Finished);
        }
        for role in self.due(now) {
            events.push(match self.start(role) {
                Ok(epoch_floor) => Event::Restarted { role, epoch_floor },
                Err(error) if real_time => self.postpone(role, error, now)?,
                Err(error) => return Err(error),
            });
        }
        Ok(events)
    }

    /// A process could not be restarted, for example on a full disk. The attempt counts as a
    /// failure: it is repeated as often as the restart policy allows.
    fn postpone(
        &mut self,
        role: Participant,
        error: FleetError,
        now: Instant,
    ) -> Result<Event, FleetError> {
        let policy = self.context.assembly.graph.processes.of(role).restart_policy();
        let Some(member) = self.members.get_mut(&role) else { return Err(error) };
        let wait = member.restarts.after_death(&policy, now);
        member.state = wait.map_or(State::Ended, |wait| State::Due(now + wait));
        if wait.is_none() && is_needed(role) {
            Err(error)
        } else {
            Ok(Event::NotStarted { role, trouble: error.to_string(), wait })
        }
    }

    /// Roles whose wait is over.
    fn due(&self, now: Instant) -> Vec<Participant> {
        let is_due = |member: &Member| matches!(member.state, State::Due(time) if time <= now);
        self.members.iter().filter(|(_, member)| is_due(member)).map(|(&role, _)| role).collect()
    }

    /// Stops all processes in order. Each group has the time `patience` to stop, then it is killed.
    /// `hurry` returns whether an operator requests an immediate end.
    ///
    /// Returns one sentence for each process that did not stop correctly.
    pub fn end(
        &mut self,
        patience: impl Fn(Participant) -> Duration,
        mut hurry: impl FnMut() -> bool,
    ) -> Vec<String> {
        let mut complaints = Vec::new();
        let mut hurried = false;
        for row in END_ORDER {
            let mut living: Vec<Child> =
                row.iter().filter_map(|role| self.release(*role)).collect();
            living.iter().for_each(Child::ask_to_end);
            let asked = Instant::now();
            while !living.is_empty() {
                living
                    .retain_mut(|child| still_lives(child, &self.context.folder, &mut complaints));
                hurried |= hurry();
                if let Some(slow) = living
                    .iter()
                    .position(|child| hurried || asked.elapsed() > patience(child.role()))
                {
                    let child = living.swap_remove(slow);
                    complaints.push(end_by_force(child));
                } else if !living.is_empty() {
                    std::thread::sleep(Duration::from_millis(5));
                }
            }
        }
        complaints
    }

    fn release(&mut self, role: Participant) -> Option<Child> {
        self.processes_by_role.lock().remove(&role);
        match self.members.remove(&role)?.state {
            State::Running(child) => Some(child),
            State::Due(_) | State::Ended => None,
        }
    }
}

/// How it ended, if it has. A reader of `processes_by_role` finds no process that has been reaped.
fn bury(
    processes_by_role: &ProcessesByRole,
    child: &mut Child,
) -> Result<Option<Ending>, FleetError> {
    let role = child.role();
    let mut processes_by_role = processes_by_role.lock();
    let ending = child.ended().map_err(|source| FleetError::System { role, source })?;
    if ending.is_some() {
        processes_by_role.remove(&role);
    }
    Ok(ending)
}

/// Settings file of a process.
pub fn settings_file(folder: &Path, role: Participant) -> PathBuf {
    folder.join("settings").join(format!("{}.toml", role.text()))
}

fn still_lives(child: &mut Child, folder: &Path, complaints: &mut Vec<String>) -> bool {
    match child.ended() {
        Ok(None) => return true,
        Ok(Some(ending)) if ending.is_clean() => {
            tracing::info!(role = %child.role(), %ending, "ended");
        }
        Ok(Some(ending)) => {
            complaints.push(format!(
                "{} ended with {ending} after the stop request{}",
                child.role(),
                last_words(folder, child.role())
            ));
        }
        Err(error) => complaints.push(format!("{}: {error}", child.role())),
    }
    false
}

fn end_by_force(mut child: Child) -> String {
    child.kill();
    let complaint = format!(
        "{} (process {}) did not end after the stop request, and was killed",
        child.role(),
        child.pid()
    );
    match child.wait() {
        Ok(_) => complaint,
        Err(error) => format!("{complaint}; {error}"),
    }
}
