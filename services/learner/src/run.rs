//! The loop: it receives samples while the fit runs on a thread of its own.
//!
//! ```text
//! tick      nP ─────────────── nP + V ──── nP + D
//! learner   cut, fit begins     scored,     (controller) takes effect
//!                               published
//! ```
//! V = D − 1 samples after the cut score the snapshot; it was not trained on them. In lock step
//! every cut gives a snapshot, in order. In real time a cut during a running fit is skipped.

mod fitter;

use crate::data_set::{DataSet, fingerprint_of, fit_settings};
#[cfg(feature = "faults")]
use crate::fault_injector::SnapshotFaultInjector;
use crate::fit::{FitSettings, FittedModel};
use crate::held_out::HeldOut;
use crate::settings::Settings;
use crate::snapshot::{self, Label};
use crate::store;
use crate::tunable::TunableSettings;
use fitter::{Done, Job, fit_jobs};
use model::gp::dictionary::Outcome;
use model::gp::hyperparameters::Hyperparameters;
use model::gp::posterior::VarianceScratch;
use model::learned::{
    INPUTS, INPUTS_WITH_HEADING, INPUTS_WITH_HISTORY, INPUTS_WITH_PLACE, Learned, Residual,
    Uncertain,
};
use model::{AXES, Velocity};
use process::{Pace, Pulse, Stop};
use protocol::frame::DecodeError;
use protocol::message::{ModelSnapshot, Participant, Phase, ResidualSample};
use protocol::topic::Topic;
use std::collections::VecDeque;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::Duration;
use transport::{OpenError, Ports, ReceiveError, SendError, Since, Sink, Source};

/// Longest wait between two checks of the stop signals.
const PATIENCE: Duration = Duration::from_millis(20);
/// Why the learner ended before a stop was requested.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A port could not be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// A snapshot could not be sent.
    #[error(transparent)]
    Send(#[from] SendError),
    /// A snapshot could not be made.
    #[error(transparent)]
    Snapshot(#[from] DecodeError),
    /// The fitting thread ended.
    #[error("the fitting thread has ended unexpectedly")]
    Fitter,
}

/// Learns until a stop is requested.
///
/// # Errors
/// [`RunError`].
pub fn run(settings: &Settings, ports: &Ports, stop: &Stop) -> Result<(), RunError> {
    match settings.learner.layout.dimension() {
        INPUTS_WITH_HEADING => run_over::<INPUTS_WITH_HEADING>(settings, ports, stop),
        INPUTS_WITH_HISTORY => run_over::<INPUTS_WITH_HISTORY>(settings, ports, stop),
        INPUTS_WITH_PLACE => run_over::<INPUTS_WITH_PLACE>(settings, ports, stop),
        _ => run_over::<INPUTS>(settings, ports, stop),
    }
}

/// The same for a residual over D inputs.
fn run_over<const D: usize>(
    settings: &Settings,
    ports: &Ports,
    stop: &Stop,
) -> Result<(), RunError> {
    let tunable = TunableSettings::open(settings);
    let fit_settings = fit_settings::<D>(settings);
    let (jobs, inbox) = mpsc::channel::<Job<D>>();
    let (outbox, done) = mpsc::channel::<Done<D>>();
    thread::scope(|scope| {
        let mut learner = Learner::new(settings, ports, fit_settings, tunable, (jobs, done))?;
        let start = learner.start;
        scope.spawn(move || fit_jobs(fit_settings, start, &inbox, &outbox));
        learner.run(stop)
        // The job channel closes with `learner`, which ends the fitting thread.
    })
}

/// The receiving thread.
struct Learner<'a, const D: usize> {
    settings: &'a Settings,
    fingerprint: u64,
    fit_settings: FitSettings<D>,
    /// Settings that can change during the run.
    tunable: TunableSettings,
    samples: Source<ResidualSample>,
    snapshots: Sink<ModelSnapshot>,
    pulse: Pulse,
    data: DataSet<D>,
    /// Hyperparameters at which the first fit begins.
    start: [Hyperparameters<D>; AXES],
    /// Samples since the last cut that is published, for scoring.
    recent: VecDeque<ResidualSample>,
    held_out: HeldOut,
    /// The last published model, and the last tick that it was judged on.
    judged: Option<(Learned<D>, u64)>,
    scratch: VarianceScratch,
    /// Cuts under way, oldest first, and the result of the first.
    pending: VecDeque<u64>,
    finished: Option<Done<D>>,
    jobs: Sender<Job<D>>,
    done: Receiver<Done<D>>,
    version: u64,
    /// (plant epoch, tick) of the newest sample.
    newest: Option<(u64, u64)>,
    /// Number of the last cut; its tick is this number times P.
    last_cut: u64,
    /// The last published or resumed snapshot.
    last: Option<ModelSnapshot>,
    /// Whether the data of an earlier run is in the dictionary, and this run has not contradicted
    /// it.
    on_trial: bool,
    /// Whether the next fit begins from the initial hyperparameters.
    anew: bool,
    #[cfg(feature = "faults")]
    fault_injector: SnapshotFaultInjector,
}

impl<'a, const D: usize> Learner<'a, D> {
    fn new(
        settings: &'a Settings,
        ports: &Ports,
        fit_settings: FitSettings<D>,
        tunable: TunableSettings,
        (jobs, done): (Sender<Job<D>>, Receiver<Done<D>>),
    ) -> Result<Self, OpenError> {
        let since = if settings.run.restarted { Since::Joining } else { Since::First };
        let fingerprint = fingerprint_of(settings);
        let mut data = DataSet::new(settings, &fit_settings);
        let resumed = store::to_resume_from(settings, fingerprint);
        let start = resumed.as_ref().map_or_else(
            || fit_settings.hyperparameters(),
            |snapshot| store::resume(snapshot, &fit_settings, &mut data.dictionary),
        );
        Ok(Self {
            settings,
            fingerprint,
            fit_settings,
            tunable,
            samples: ports.source(since)?,
            snapshots: ports.sink()?,
            pulse: Pulse::new(ports, Participant::Learner)?.exposed(settings.run.exposure),
            data,
            start,
            recent: VecDeque::new(),
            held_out: HeldOut::default(),
            judged: None,
            scratch: VarianceScratch::new(settings.learner.points_max),
            pending: VecDeque::new(),
            finished: None,
            jobs,
            done,
            version: resumed.as_ref().map_or(0, |snapshot| snapshot.head.version),
            newest: None,
            last_cut: 0,
            on_trial: resumed.is_some(),
            last: resumed,
            anew: false,
            #[cfg(feature = "faults")]
            fault_injector: SnapshotFaultInjector::new(settings.snapshot_faults.clone()),
        })
    }

    fn run(&mut self, stop: &Stop) -> Result<(), RunError> {
        // The first wait opens the listener, so that no message published after "ready" is missed.
        self.samples.wait(Duration::ZERO)?;
        self.pulse.phase(Phase::Ready);
        while !stop.requested() {
            if self.may_publish() {
                match self.done.recv_timeout(PATIENCE) {
                    Ok(done) => self.finished = Some(done),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return Err(RunError::Fitter),
                }
            } else {
                self.samples.wait(PATIENCE)?;
            }
            while let Some(sample) = self.samples.next()? {
                self.process_sample(&sample)?;
            }
            self.publish_finished()?;
            self.tune();
            self.snapshots.refresh()?;
            self.report();
        }
        self.report();
        self.pulse.last_words(Phase::Finished, self.settings.run.pace);
        Ok(())
    }

    /// Whether the oldest cut waits only for its fit.
    fn may_publish(&self) -> bool {
        let oldest = self.pending.front();
        self.finished.is_none()
            && oldest.is_some_and(|cut| {
                self.newest.is_some_and(|(_, tick)| tick >= self.score_until(*cut))
            })
    }

    /// Last tick whose sample scores the snapshot of `cut`.
    fn score_until(&self, cut: u64) -> u64 {
        cut + self.settings.learner.delay_ticks - 1
    }

    fn process_sample(&mut self, sample: &ResidualSample) -> Result<(), RunError> {
        if sample.fingerprint != self.fingerprint {
            self.pulse
                .health()
                .set_last_error("samples of another robot, period or input layout are ignored");
            return Ok(());
        }
        let tick = sample.stamp.tick;
        if self.newest.is_none() {
            self.pulse.phase(Phase::Running);
        }
        let first = self.newest.is_none();
        if self.newest.is_some_and(|(epoch, _)| epoch != sample.plant_epoch) {
            self.recent.clear();
            self.judged = None;
            self.last_cut = 0;
        }
        self.newest = Some((sample.plant_epoch, tick));
        if first {
            self.join(sample)?;
        }
        if self.data.follow_dead_time(sample) {
            tracing::info!(tick, sample.dead_time_s, "another dead time: this run's samples go");
            self.recent.clear();
            self.held_out = HeldOut::default();
            self.anew = true;
        }
        if let Some(outcome) = self.data.add(sample) {
            if outcome == Outcome::Changed {
                tracing::info!(tick, "the robot has changed: older samples count less");
            }
            // A sample that is held back does not judge a model either.
            if outcome != Outcome::Held {
                self.recent.push_back(*sample);
            }
        }
        let cut = tick / self.tunable.every_ticks();
        let free = self.pending.is_empty() || self.settings.run.pace == Pace::LockStep;
        if cut > self.last_cut && free {
            self.last_cut = cut;
            let cut = cut * self.tunable.every_ticks();
            self.pending.push_back(cut);
            let job = Job {
                cut,
                observations: self.data.observations(),
                anew: std::mem::take(&mut self.anew),
                evaluations_max: self.tunable.evaluations_max(),
            };
            self.jobs.send(job).map_err(|_| RunError::Fitter)?;
        }
        Ok(())
    }

    fn publish_finished(&mut self) -> Result<(), RunError> {
        if self.finished.is_none() {
            self.finished = self.done.try_recv().ok();
        }
        let scored = |done: &Done<D>| {
            self.newest.is_some_and(|(_, tick)| tick >= self.score_until(done.0) || tick < done.0)
        };
        if !self.finished.as_ref().is_some_and(scored) {
            return Ok(());
        }
        let Some((cut, result)) = self.finished.take() else { return Ok(()) };
        self.pending.pop_front();
        let (epoch, _) = self.newest.unwrap_or_default();
        match result {
            Ok(fitted) => self.publish(fitted, cut, epoch)?,
            Err(error) => {
                tracing::warn!(cut, "no new model: {error}");
                self.pulse.health().set_last_error("a fit has failed; see the log");
                self.publish_again(cut, epoch)?;
            }
        }
        self.recent.retain(|sample| sample.stamp.tick > cut);
        Ok(())
    }

    /// Judges the previous model on samples that it has not been judged on, and returns the noise
    /// of the new model.
    fn hold_out(&mut self, until: u64, otherwise: &Velocity) -> Velocity {
        if let Some((learned, judged)) = &self.judged {
            for sample in self
                .recent
                .iter()
                .filter(|sample| sample.stamp.tick > *judged && sample.stamp.tick <= until)
            {
                let at = snapshot::moment(sample);
                let mean = learned.mean(&at);
                let error = std::array::from_fn(|axis| sample.residual[axis] - mean[axis]);
                self.held_out.push(
                    &error,
                    &learned.variance(&at, &mut self.scratch),
                    &learned.sample_variance,
                );
            }
        }
        self.forget_if_contradicted(until);
        self.held_out.noise(otherwise, &self.fit_settings.noise_floor())
    }

    /// Drops the data of an earlier run if this robot contradicts it. More noise on that data would
    /// not be enough: far from the samples of this run it would still bend the model.
    fn forget_if_contradicted(&mut self, tick: u64) {
        if self.on_trial && self.held_out.contradicted() {
            tracing::info!(
                tick,
                covered = ?self.held_out.covered(),
                "the robot contradicts the data of the earlier run: the data is dropped"
            );
            self.data.dictionary.forget_restored();
            self.held_out = HeldOut::default();
            (self.on_trial, self.anew) = (false, true);
        }
    }

    fn publish(
        &mut self,
        mut fitted: FittedModel<D>,
        cut: u64,
        plant_epoch: u64,
    ) -> Result<(), RunError> {
        let until = self.score_until(cut);
        fitted.learned.sample_variance = self.hold_out(until, &fitted.learned.sample_variance);
        let newer: Vec<ResidualSample> = self
            .recent
            .iter()
            .filter(|sample| sample.stamp.tick > cut && sample.stamp.tick <= until)
            .copied()
            .collect();
        self.version += 1;
        let label = Label {
            version: self.version,
            fingerprint: self.fingerprint,
            plant_epoch,
            trained_tick: cut,
            effective_tick: cut + self.settings.learner.delay_ticks,
        };
        let mut snapshot = snapshot::write(&fitted, &label, &newer)?;
        #[cfg(feature = "faults")]
        let mut bad = self.fault_injector.in_place_of(&snapshot, cut);
        #[cfg(not(feature = "faults"))]
        let mut bad: Option<ModelSnapshot> = None;
        self.snapshots.send(bad.as_mut().unwrap_or(&mut snapshot))?;
        if let Err(error) = store::save(&store::file_of(self.settings), &snapshot) {
            tracing::warn!("{error}");
            self.pulse.health().set_last_error("the snapshot could not be saved; see the log");
        }
        let head = &snapshot.head;
        tracing::info!(
            version = head.version,
            cut,
            points = head.points,
            evaluations = fitted.evaluations,
            log_likelihood = ?head.log_likelihood,
            jitter = ?head.jitter,
            learned = ?head.score_learned,
            main = ?head.score_main,
            covered = ?self.held_out.covered(),
            "published"
        );
        self.last = Some(snapshot);
        self.judged = Some((fitted.learned, until));
        Ok(())
    }

    /// Handles a cut without a model. In lock step the controller waits for one: it gets the last
    /// one again, or the prior.
    fn publish_again(&mut self, cut: u64, plant_epoch: u64) -> Result<(), RunError> {
        let Some(last) = &mut self.last else {
            if let Ok(nothing) = self.fit_settings.fit(&[], &self.start) {
                self.publish(nothing, cut, plant_epoch)?;
            }
            return Ok(());
        };
        last.head.effective_tick = cut + self.settings.learner.delay_ticks;
        last.head.plant_epoch = plant_epoch;
        self.snapshots.send(last)?;
        tracing::info!(
            version = last.head.version,
            points = last.head.points,
            cut,
            "published again"
        );
        Ok(())
    }

    /// Handles the first sample, which tells the present tick. Publishes the earlier model again:
    /// at once, and for every missed cut whose model is still due.
    fn join(&mut self, sample: &ResidualSample) -> Result<(), RunError> {
        let (every_ticks, delay_ticks) =
            (self.tunable.every_ticks(), self.settings.learner.delay_ticks);
        let tick = sample.stamp.tick;
        self.last_cut = tick / every_ticks;
        if tick == 0 && (self.last.is_some() || self.settings.learner.resume.is_some()) {
            return self.publish_again(0, sample.plant_epoch);
        }
        let first_due = (tick + 1).saturating_sub(delay_ticks).div_ceil(every_ticks).max(1);
        for cut in first_due..=self.last_cut {
            self.publish_again(cut * every_ticks, sample.plant_epoch)?;
        }
        Ok(())
    }

    /// Between two samples: a changed setting acts from the next sample on.
    fn tune(&mut self) {
        if self.tunable.poll(self.newest) {
            self.last_cut = self.newest.map_or(0, |(_, tick)| tick / self.tunable.every_ticks());
        }
    }

    fn report(&mut self) {
        self.pulse.count_source(Topic::Residual, self.samples.tally());
        self.pulse.count_sink(&self.snapshots);
        let (version, sent) = (self.version, self.snapshots.sent());
        let health = self.pulse.health();
        health.model_version = version;
        health.snapshots = sent;
        self.pulse.beat();
    }
}
