//! `Health` and `Plan` → state that the launcher uses.
//!
//! A thread of its own only receives, so that a slow terminal never delays the controller: in lock
//! step the link of the plans loses nothing.

use process::Stop;
use protocol::message::{FallbackLevel, Goal, GoalPhase, Health, Participant, Phase, Plan};
use std::collections::BTreeMap;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use transport::{HeldLinks, Identity, Links, OpenError, Ports, ReceiveError, Since, Source};

/// Longest sleep: interval between checks of the health and of the stop request.
const PATIENCE: Duration = Duration::from_millis(20);

/// Largest number of errors of the controller that are reported.
const COMPLAINTS_MAX: usize = 20;

/// Last received messages.
#[derive(Debug, Clone, Default)]
pub struct View {
    health: BTreeMap<Participant, HealthView>,
    plan: Option<PlanView>,
    /// Errors that the controller has reported, each once until its Health had no error.
    complaints: Vec<String>,
    /// Last goal, with its phase.
    goal: Option<(u64, GoalPhase)>,
    /// Changes of the goals that are not told yet.
    goals: Vec<String>,
    /// Whether its last Health had no error: an earlier error is then reported again.
    well: bool,
}

/// The used part of a Health.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HealthView {
    /// Phase in the last Health.
    pub phase: Phase,
}

/// The used part of a Plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanView {
    /// Tick that it answers.
    pub tick: u64,
    /// Distance of the measured position from the reference \[m\].
    pub position_error: f64,
    /// Version of the learned model in use; 0 is the main model alone.
    pub model_version: u64,
    /// Time from receiving the state to the computed command \[ns\].
    pub tick_nanos: u64,
    /// Fallback level of the controller.
    pub fallback_level: FallbackLevel,
}

/// Receives until it is dropped.
#[derive(Debug)]
pub struct Watch {
    view: Arc<Mutex<View>>,
    done: Stop,
    thread: Option<JoinHandle<()>>,
}

impl View {
    /// Health of a role, if there was any.
    pub fn health(&self, role: Participant) -> Option<HealthView> {
        self.health.get(&role).copied()
    }

    /// Last Plan.
    pub fn plan(&self) -> Option<PlanView> {
        self.plan
    }

    /// Errors that the controller has reported, each once, in the order of their reports.
    pub fn complaints(&self) -> &[String] {
        &self.complaints
    }

    /// Records a Goal. Each change of its phase is told.
    pub fn update_goal(&mut self, goal: &Goal) {
        let now = (goal.id, goal.phase());
        if self.goal.replace(now) != Some(now) && self.goals.len() < COMPLAINTS_MAX {
            self.goals.push(format!("goal {} ({}): {}", goal.id, goal.kind(), goal.phase()));
        }
    }

    /// Records a Health.
    pub fn update_health(&mut self, health: &Health) {
        if let Some(role) = health.participant() {
            self.health.insert(role, HealthView { phase: health.phase() });
            let error = health.last_error();
            if role == Participant::Controller {
                let was_well = std::mem::replace(&mut self.well, error.is_empty());
                let is_new = was_well || !self.complaints.iter().any(|before| before == error);
                if !error.is_empty() && is_new && self.complaints.len() < COMPLAINTS_MAX {
                    self.complaints.push(error.to_owned());
                }
            }
        }
    }
}

impl From<&Plan> for PlanView {
    fn from(plan: &Plan) -> Self {
        Self {
            tick: plan.stamp.tick,
            position_error: plan.position_error(),
            model_version: plan.model_version,
            tick_nanos: plan.tick_nanos,
            fallback_level: plan.fallback_level(),
        }
    }
}

impl Watch {
    /// Opens the graph's links and receives from now on.
    ///
    /// # Errors
    /// [`OpenError`] if the links cannot be opened.
    pub fn open(links: &Links) -> Result<Self, OpenError> {
        let (view, done) = (Arc::new(Mutex::new(View::default())), Stop::new());
        let (opened, outcome) = mpsc::channel();
        let thread = thread::spawn({
            let (view, done, links) = (Arc::clone(&view), done.clone(), links.clone());
            move || match Ears::open(&links) {
                Ok(sources) => sources.listen(&opened, &view, &done),
                Err(error) => drop(opened.send(Err(error))),
            }
        });
        let watch = Self { view, done, thread: Some(thread) };
        let silent = |_| {
            Err(OpenError::Join {
                graph: links.graph.clone(),
                reason: "the listening thread has died".into(),
            })
        };
        outcome.recv().unwrap_or_else(silent)?;
        Ok(watch)
    }

    /// Last received messages.
    pub fn view(&self) -> View {
        lock(&self.view).clone()
    }

    /// Changes of the goals since the last call, as text.
    pub fn goals(&self) -> Vec<String> {
        std::mem::take(&mut lock(&self.view).goals)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.done.request();
        if let Some(thread) = self.thread.take() {
            // A panic of that thread is in the log.
            let _ = thread.join();
        }
    }
}

/// Ports of the receiving thread.
struct Ears {
    health: Source<Health>,
    plans: Source<Plan>,
    goals: Source<Goal>,
    /// The launcher creates the links, so that no process that may be killed is their creator.
    _links: HeldLinks,
}

impl Ears {
    fn open(links: &Links) -> Result<Self, OpenError> {
        let ports = Ports::open(links, Identity::new(0))?;
        Ok(Self {
            _links: ports.hold_links()?,
            health: ports.source(Since::First)?,
            plans: ports.source(Since::First)?,
            goals: ports.source(Since::First)?,
        })
    }

    fn listen(mut self, opened: &Sender<Result<(), OpenError>>, view: &Mutex<View>, done: &Stop) {
        // The first wait opens the listener: only from then on no message is lost.
        let first = self.plans.wait(Duration::ZERO);
        if opened.send(Ok(())).is_err() {
            return;
        }
        let mut result = first.and_then(|_| self.round(view));
        while result.is_ok() && !done.requested() {
            result = self.round(view);
        }
        if let Err(error) = result {
            tracing::error!(%error, "the processes can no longer be watched");
        }
    }

    fn round(&mut self, view: &Mutex<View>) -> Result<(), ReceiveError> {
        self.plans.wait(PATIENCE)?;
        if let Some(plan) = self.plans.latest()? {
            lock(view).plan = Some(PlanView::from(&plan));
        }
        while let Some(health) = self.health.next()? {
            lock(view).update_health(&health);
        }
        while let Some(goal) = self.goals.next()? {
            lock(view).update_goal(&goal);
        }
        Ok(())
    }
}

/// A view is consistent even if its holder panicked, because each part is replaced as a whole.
fn lock(view: &Mutex<View>) -> MutexGuard<'_, View> {
    view.lock().unwrap_or_else(PoisonError::into_inner)
}
