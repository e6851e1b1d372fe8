//! The loop around [`Controller`]: the only place with a clock, a stop signal and threads.

mod attendant;
mod change_requests;
mod exchange;
mod lists;
mod scenario_goals;
#[cfg(test)]
mod tests;

use crate::adopt::{Event, Handover};
use crate::complaints::{Complaints, Sentence};
use crate::control::tuning::RULES;
use crate::control::{Controller, ControllerError};
use crate::identified;
use crate::settings::Settings;
use attendant::attend;
use lists::Lists;
use model::foresight::Foresight;
use process::requests::{changed_before, earlier_goal};
use process::{Pace, Pulse, Seat, Stop, step_back};
use protocol::clock::monotonic_nanos;
use protocol::message::{
    Command, Goal, GoalPhase, Participant, Phase, Plan, PlantState, ResidualSample,
};
use protocol::topic::Topic;
use scenario_goals::ScenarioGoals;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;
use transport::{Identity, OpenError, Ports, ReceiveError, SendError, Since, Sink, Source};

/// Longest wait before stop signals are checked.
const PATIENCE: Duration = Duration::from_millis(20);

/// Time between rehearsal and expected state, in multiples of the last answer's time,
const REHEARSAL_TICKS: u64 = 4;
/// and its minimum, since sleeping is exact to a millisecond \[ns\].
const REHEARSAL_LEAST: u64 = 2_000_000;

/// In lock step: a state that repeats this long after its answer has not received it. A state that
/// repeats sooner is an echo on the link \[ns\].
const UNANSWERED_NANOS: u64 = 500_000_000;

/// The controller ended before it was stopped.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// It could not be set up.
    #[error(transparent)]
    Setup(#[from] ControllerError),
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A port could not be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// A message could not be sent.
    #[error(transparent)]
    Send(#[from] SendError),
    /// The gate obeys a controller with a higher epoch, and will never obey this one again.
    #[error("a controller of epoch {theirs} has taken over from this one of epoch {ours}")]
    Replaced {
        /// Our epoch.
        ours: u64,
        /// Highest epoch that the gate has accepted.
        theirs: u64,
    },
    /// No controller could ever replace one that has the last epoch.
    #[error(
        "epoch {highest} is the last one there is: no controller can take over; restart the plant"
    )]
    NoEpochLeft {
        /// Highest epoch so far.
        highest: u64,
    },
    /// The attendant thread ended with a panic.
    #[error("the thread that prepares models has died")]
    Attendant,
}

/// Answers states until `stop` is requested. `connect` opens the ports of one thread.
///
/// # Errors
/// [`RunError`].
pub fn run(
    settings: &Settings,
    connect: impl Fn(Identity) -> Result<Ports, OpenError> + Sync,
    stop: &Stop,
) -> Result<(), RunError> {
    run_foreseeing(settings, None, connect, stop)
}

/// The same with a source of the true dynamics.
///
/// # Errors
/// [`RunError`].
pub fn run_foreseeing(
    settings: &Settings,
    foresight: Option<Box<dyn Foresight>>,
    connect: impl Fn(Identity) -> Result<Ports, OpenError> + Sync,
    stop: &Stop,
) -> Result<(), RunError> {
    let settings = &told(settings);
    let handover = Handover::default();
    let identity = Identity::new(settings.run.epoch_floor);
    let done = Stop::new();
    let control_thread = thread::current();
    thread::scope(|scope| {
        // Spawned before this thread raises its priority, so that the attendant does not inherit
        // it.
        let attendant =
            scope.spawn(|| attend(settings, &connect, identity, &handover, &done, &control_thread));
        settings.run.go_first_to_open();
        let ports = connect(identity).map_err(RunError::from);
        let result =
            ports.and_then(|ports| Loop::new(settings, foresight, &ports, &handover)?.run(stop));
        step_back();
        done.request();
        attendant.join().map_err(|_| RunError::Attendant)??;
        result
    })
}

/// The launcher's settings, with the changes that this run has accepted since.
fn told(settings: &Settings) -> Settings {
    match changed_before(settings, Participant::Controller, &RULES) {
        Ok((settings, 0)) => settings,
        Ok((settings, changes)) => {
            tracing::info!(changes, "the earlier changes are restored");
            settings
        }
        Err(error) => {
            tracing::warn!("the earlier changes are lost: {error}");
            settings.clone()
        }
    }
}

/// The control thread's ports and memory.
struct Loop<'a> {
    settings: &'a Settings,
    handover: &'a Handover,
    controller: Controller,
    complaints: Complaints,
    states: Source<PlantState>,
    lists: Lists,
    commands: Sink<Command>,
    residuals: Sink<ResidualSample>,
    plans: Sink<Plan>,
    goals: Sink<Goal>,
    pulse: Pulse,
    /// Our epoch, once the first state has reported the used ones.
    epoch: Option<u64>,
    /// (plant epoch, tick) of the last answer.
    answered: Option<(u64, u64)>,
    /// Time of that answer, on the monotonic clock \[ns\].
    answered_at: u64,
    /// Number of repeated states at the last check.
    repeated: u64,
    /// The goal and the phase that were logged last.
    goal_told: Option<(u64, GoalPhase)>,
    /// Time of the next rehearsal, on the monotonic clock \[ns\].
    rehearse_at: Option<u64>,
    /// Held from the rehearsal to the answer.
    seat: Seat,
    /// In lock step, the goals of the scenario.
    scenario_goals: ScenarioGoals<'a>,
}

impl<'a> Loop<'a> {
    fn new(
        settings: &'a Settings,
        foresight: Option<Box<dyn Foresight>>,
        ports: &Ports,
        handover: &'a Handover,
    ) -> Result<Self, RunError> {
        let since = if settings.run.restarted { Since::Joining } else { Since::First };
        let mut controller = Controller::foreseeing(settings, foresight)?;
        identified::resume(&mut controller, settings);
        if settings.run.restarted && earlier_goal(&settings.run, Participant::Controller).is_some()
        {
            controller.hold_at_start();
        }
        Ok(Self {
            settings,
            handover,
            controller,
            complaints: Complaints::new(
                &settings.robot,
                settings.run.period_nanos as f64 * 1e-9,
                settings.run.pace,
            ),
            states: ports.source(since)?,
            lists: Lists::open(ports, since)?,
            commands: ports.sink()?,
            residuals: ports.sink()?,
            plans: ports.sink()?,
            goals: ports.sink()?,
            pulse: Pulse::new(ports, Participant::Controller)?.exposed(settings.run.exposure),
            epoch: None,
            answered: None,
            answered_at: 0,
            repeated: 0,
            goal_told: None,
            rehearse_at: None,
            seat: Seat::new(),
            scenario_goals: ScenarioGoals::new(settings),
        })
    }

    fn run(&mut self, stop: &Stop) -> Result<(), RunError> {
        // The first wait opens the listener, so that everything published after "ready" is
        // received.
        self.states.wait(Duration::ZERO)?;
        self.settings.run.go_first_to_run();
        self.pulse.phase(Phase::Ready);
        while !stop.requested() {
            let until_rehearsal = self
                .rehearse_at
                .map_or(PATIENCE, |at| Duration::from_nanos(at.saturating_sub(monotonic_nanos())));
            self.states.wait(until_rehearsal.min(PATIENCE))?;
            self.watch_attendant()?;
            let state = match self.settings.run.pace {
                Pace::RealTime => self.states.latest()?,
                Pace::LockStep => self.states.next()?,
            };
            if let Some(state) = state {
                self.step(&state, stop)?;
            } else if self.rehearse_at.is_some_and(|at| at <= monotonic_nanos()) {
                self.tune();
                self.seat.hold();
                self.controller.rehearse();
                self.rehearse_at = None;
            } else if self.settings.run.pace == Pace::LockStep {
                self.answer_again()?;
            } else if self.rehearse_at.is_some() || self.is_unemployed() {
                self.tune();
            }
            self.report();
        }
        self.report();
        identified::save(&self.controller, self.settings);
        self.pulse.last_words(Phase::Finished, self.settings.run.pace);
        Ok(())
    }

    /// Answers one state, publishes the residual and the plan, then adopts a new model.
    fn step(&mut self, state: &PlantState, stop: &Stop) -> Result<(), RunError> {
        let begin = monotonic_nanos();
        let (plant_epoch, tick) = (state.stamp.epoch, state.stamp.tick);
        if self.answered.is_some_and(|answered| answered >= (plant_epoch, tick)) {
            return Ok(());
        }
        if let Some(ours) = self.epoch.filter(|&ours| ours < state.controller_epoch) {
            return Err(RunError::Replaced { ours, theirs: state.controller_epoch });
        }
        let is_first = self.epoch.is_none();
        let epoch = self.claim_epoch(state)?;
        let mut sample = self.controller.observe(state, self.handover, epoch);
        let command = self.controller.answer(state, self.handover);
        let nanos = monotonic_nanos() - begin;
        self.commands.send(command)?;
        if is_first {
            self.pulse.phase(Phase::Running);
        }
        self.pulse.show_gate(state.gate(), state.stop());
        if let Some(fault) = self.controller.sensor_fault() {
            self.pulse.health().set_last_error(fault.text());
        } else if let Some(complaint) =
            self.complaints.look(state, &self.controller.limits_in_use())
        {
            self.handover.note(Event::Complaint { tick, complaint });
            self.pulse.health().set_last_error(Sentence::of(&complaint).text());
        }

        self.seat.release();
        let residual = self.residuals.send(&mut sample);
        self.beside_control(residual)?;
        let plan = self.plans.send(self.controller.explain(nanos));
        self.beside_control(plan)?;
        self.tell_goal(tick)?;
        self.count(plant_epoch, tick, nanos);
        self.look_around(plant_epoch, tick, stop)?;
        match self.settings.run.pace {
            Pace::RealTime => self.take_newest(tick),
            Pace::LockStep => {
                self.take_due(tick + 1, stop)?;
                if let Err(told) = self.scenario_goals.follow(&mut self.controller, tick + 1) {
                    tracing::warn!(tick, "{told}");
                    self.pulse.health().set_last_error(&told.to_string());
                }
            }
        }
        self.controller.prepare_next();
        self.tune();
        self.rehearse_at = self.time_to_rehearse(begin, nanos);
        Ok(())
    }

    /// Takes the lists of obstacles for the next plan. In lock step these are the lists up to that of
    /// `tick`, for which it waits; the next one may have arrived as well.
    fn look_around(&mut self, plant_epoch: u64, tick: u64, stop: &Stop) -> Result<(), RunError> {
        let in_step = self.settings.sees_obstacles && self.settings.run.pace == Pace::LockStep;
        while !in_step || !self.lists.has(plant_epoch, tick) {
            match self.lists.take(&mut self.controller)? {
                Some(Ok(())) => {}
                Some(Err(error)) => self.handover.note(Event::List { tick, error }),
                None if in_step && !stop.requested() => {
                    self.lists.wait(PATIENCE)?;
                    self.report();
                }
                None => return Ok(()),
            }
        }
        Ok(())
    }

    /// A plant that repeats its last state waits for a lost answer, and gets the same bytes. A
    /// receiver that already has them drops them as stale.
    fn answer_again(&mut self) -> Result<(), RunError> {
        let repeated = std::mem::replace(&mut self.repeated, self.states.tally().stale);
        let waits =
            self.repeated > repeated && monotonic_nanos() >= self.answered_at + UNANSWERED_NANOS;
        if waits && self.answered.is_some() {
            self.commands.send_stamped(self.controller.last_answer())?;
        }
        Ok(())
    }

    /// Real time: far enough ahead of the next state that the rehearsal is over when it arrives. If
    /// a tick takes much of the period, there is no rehearsal.
    fn time_to_rehearse(&self, begin: u64, tick_nanos: u64) -> Option<u64> {
        let (period, ahead) =
            (self.settings.run.period_nanos, (REHEARSAL_TICKS * tick_nanos).max(REHEARSAL_LEAST));
        (self.settings.run.pace == Pace::RealTime && 2 * ahead < period)
            .then_some(begin + period.saturating_sub(ahead))
    }

    /// Result of a send that the robot does not depend on: a message to the learner or to watchers.
    /// A failure ends a run in lock step, which loses nothing, but never a drive in real time.
    fn beside_control(&mut self, sent: Result<(), SendError>) -> Result<(), RunError> {
        match (sent, self.settings.run.pace) {
            (Err(error), Pace::LockStep) => Err(error.into()),
            (Err(_), Pace::RealTime) => {
                self.pulse
                    .health()
                    .set_last_error("a message to the learner or to watchers could not be sent");
                Ok(())
            }
            (Ok(()), _) => Ok(()),
        }
    }

    /// One more than the highest of all epochs: those that the gate has received, and those that
    /// the launcher has assigned.
    fn claim_epoch(&mut self, state: &PlantState) -> Result<u64, RunError> {
        if let Some(epoch) = self.epoch {
            return Ok(epoch);
        }
        let highest = state.controller_epoch.max(self.settings.run.epoch_floor);
        let epoch = highest.checked_add(1).ok_or(RunError::NoEpochLeft { highest })?;
        self.commands.set_epoch(epoch);
        self.residuals.set_epoch(epoch);
        self.plans.set_epoch(epoch);
        self.goals.set_epoch(epoch);
        self.pulse.set_epoch(epoch);
        self.epoch = Some(epoch);
        Ok(epoch)
    }

    /// Without the attendant no new model arrives. In lock step the run ends; in real time the
    /// robot drives on with its present model.
    fn watch_attendant(&mut self) -> Result<(), RunError> {
        if !self.handover.attendant_gone.load(Ordering::Relaxed) {
            return Ok(());
        }
        if self.settings.run.pace == Pace::LockStep {
            return Err(RunError::Attendant);
        }
        self.pulse.health().set_last_error("the thread that prepares models has ended");
        self.pulse.phase(Phase::Degraded);
        Ok(())
    }

    fn count(&mut self, plant_epoch: u64, tick: u64, nanos: u64) {
        let skipped = match self.answered {
            Some((epoch, answered)) if epoch == plant_epoch => tick.saturating_sub(answered + 1),
            _ => 0,
        };
        self.answered = Some((plant_epoch, tick));
        self.handover.tick.store(tick, Ordering::Relaxed);
        self.answered_at = monotonic_nanos();
        let late =
            self.settings.run.pace == Pace::RealTime && nanos > self.settings.run.period_nanos;
        let out_of_time = self.controller.ran_out_of_time();
        if late || skipped > 0 {
            self.handover.note(Event::Late { tick, nanos });
        } else if out_of_time {
            self.handover.note(Event::OutOfTime { tick, nanos });
        }
        let health = self.pulse.health();
        // A period whose optimiser was stopped has an answer, but not a fresh plan.
        let missed = late || out_of_time;
        health.deadlines_missed += skipped + u64::from(missed);
        health.deadlines_met += u64::from(!missed);
    }

    /// Whether no state has arrived yet, or none for two periods.
    fn is_unemployed(&self) -> bool {
        self.answered.is_none()
            || monotonic_nanos() > self.answered_at + 2 * self.settings.run.period_nanos
    }

    fn report(&mut self) {
        let (states, handover) = (self.states.tally(), self.handover);
        self.pulse.count_source(Topic::State, states);
        self.pulse.count_source(Topic::Obstacles, self.lists.tally());
        self.pulse.count_sink(&self.commands);
        self.pulse.count_sink(&self.residuals);
        self.pulse.count_sink(&self.plans);
        self.pulse.count_sink(&self.goals);
        let version = self.controller.model_version();
        let knowledge = self.controller.knowledge();
        let (learned_axes, models_left) = (knowledge.learned_axes(), knowledge.models_left());
        let health = self.pulse.health();
        health.model_version = version;
        (health.learned_axes, health.models_left) = (u64::from(learned_axes), models_left);
        health.snapshots_refused = handover.refused.load(Ordering::Relaxed);
        let [received, lost, refused] =
            [0, 1, 2].map(|i| handover.snapshots[i].load(Ordering::Relaxed));
        health.received[Topic::Snapshot.index()] = received;
        health.lost[Topic::Snapshot.index()] = lost;
        health.refused[Topic::Snapshot.index()] = refused;
        self.pulse.beat();
    }
}
