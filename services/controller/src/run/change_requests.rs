//! Requests of an operator ▶ parts for the control thread, and an answer: changes of the settings,
//! and goals.

mod goals;

use crate::adopt::Handover;
use crate::control::ControllerError;
use crate::control::tuning::{RULES, Tuned};
use crate::goal::GoalError;
use crate::goal::keeper::Keeper;
use crate::goal::schedule::Schedule;
use crate::settings::Settings;
use goals::{GoalUnderWay, Origin, Progress};
use process::Pace;
use process::requests::{Inbox, NotAsked, Outcome, Request, earlier_goal};
use protocol::message::Participant;
use settings::change::{Change, ChangeError, changed};
use std::sync::atomic::Ordering;

/// A request is refused.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    NotAsked(#[from] NotAsked),
    #[error(transparent)]
    Change(#[from] ChangeError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(transparent)]
    Goal(#[from] GoalError),
    #[error("the control thread did not take the goal in time, in {attempts} attempts")]
    Late { attempts: u32 },
    #[error("the robot has not driven for {waited_s:.0} s: expected a plant that sends states")]
    NoState { waited_s: f64 },
    #[error("the run ended before the change could take effect")]
    Over,
}

impl Refusal {
    /// Its kind, for programs.
    fn code(&self) -> &'static str {
        match self {
            Self::NotAsked(error) => error.code(),
            Self::Change(error) => error.code(),
            Self::Controller(_) => "value",
            Self::Goal(error) => error.code(),
            Self::Late { .. } => "late",
            Self::NoState { .. } => "no-state",
            Self::Over => "run-ended",
        }
    }
}

/// A request that the control thread has not put in use yet.
enum UnderWay {
    Change { settings: Box<Settings>, taken_at_tick: u64, ready_at_tick: u64 },
    Goal(GoalUnderWay),
}

/// Processes requests, one at a time.
pub(super) struct ChangeRequests {
    inbox: Inbox,
    /// Settings in use.
    settings: Settings,
    under_way: Option<UnderWay>,
    /// Time of the request of the last goal that was followed, since 1970 \[ns\].
    followed_unix_nanos: u64,
    /// In real time, the goals of the scenario.
    schedule: Schedule,
    /// In real time, the way to the present goal.
    keeper: Keeper,
    real_time: bool,
}

impl ChangeRequests {
    pub(super) fn open(settings: &Settings) -> Self {
        let earlier = settings.run.restarted.then(|| {
            let (number, request) = earlier_goal(&settings.run, Participant::Controller)?;
            GoalUnderWay::again(&request, number)
        });
        // In lock step the control thread follows the schedule itself.
        let real_time = settings.run.pace == Pace::RealTime;
        let goals = if real_time { settings.goals.as_slice() } else { &[] };
        Self {
            inbox: Inbox::open(&settings.run, Participant::Controller),
            settings: settings.clone(),
            under_way: earlier.flatten().map(UnderWay::Goal),
            followed_unix_nanos: 0,
            schedule: Schedule::new(goals, settings.run.period_nanos as f64 * 1e-9),
            keeper: Keeper::default(),
            real_time,
        }
    }

    /// Whether a request waits for the control thread, before it can be answered.
    pub(super) fn waits(&self) -> bool {
        self.under_way.is_some()
    }

    /// Answers the request that was put in use, and takes the next one.
    pub(super) fn poll(&mut self, handover: &Handover) {
        self.answer_exchanged(handover);
        self.carry_on_goal(handover);
        if self.under_way.is_some() {
            return;
        }
        let taken_at_tick = handover.tick.load(Ordering::Relaxed);
        if let Some((id, request)) = self.schedule.due(taken_at_tick) {
            let goal = GoalUnderWay::of(request, id, Origin::Schedule, taken_at_tick);
            self.under_way = Some(UnderWay::Goal(goal));
            return;
        }
        let Some(request) = self.inbox.take() else {
            let period_s = self.settings.run.period_nanos as f64 * 1e-9;
            if self.real_time && self.keeper.is_due(taken_at_tick, period_s) {
                self.under_way = Some(UnderWay::Goal(GoalUnderWay::review(taken_at_tick)));
            }
            return;
        };
        match self.take(request, taken_at_tick, handover) {
            Ok(under_way) => self.under_way = Some(under_way),
            Err(refusal) => self.refuse(&refusal),
        }
    }

    /// Ends the service: the control thread puts no more requests in use.
    pub(super) fn close(&mut self, handover: &Handover) {
        self.answer_exchanged(handover);
        self.carry_on_goal(handover);
        if self.under_way.take().is_some_and(|under_way| under_way.is_asked()) {
            self.refuse(&Refusal::Over);
        }
    }

    fn take(
        &self,
        request: Result<Request, NotAsked>,
        taken_at_tick: u64,
        handover: &Handover,
    ) -> Result<UnderWay, Refusal> {
        let request = request?;
        if request.is_goal() {
            // A planner that hung, or a slow network, can deliver it late.
            if let Some(by) = request.made_before(self.followed_unix_nanos) {
                return Err(GoalError::OutOfDate { by_s: by.as_secs_f64() }.into());
            }
            let goal = GoalUnderWay::new(&request, self.inbox.number(), taken_at_tick)?;
            return Ok(UnderWay::Goal(goal));
        }
        let change = Change::parse(&request.change)?;
        let settings = changed(&self.settings, &[change], &RULES)?;
        let tuned = Tuned::new(&settings, Some(&self.settings))?;
        // The slot is free: nothing else is under way.
        drop(handover.tuned.push(Box::new(tuned)));
        Ok(UnderWay::Change {
            settings: Box::new(settings),
            taken_at_tick,
            ready_at_tick: handover.tick.load(Ordering::Relaxed),
        })
    }

    fn refuse(&mut self, refusal: &Refusal) {
        self.inbox.answer(Outcome::refused(refusal.code(), refusal));
    }

    fn answer_exchanged(&mut self, handover: &Handover) {
        let Some(tuned) = handover.exchanged.pop() else { return };
        let (
            Some(UnderWay::Change { settings, taken_at_tick, ready_at_tick }),
            Some((plant_epoch, acts_from_tick)),
        ) = (self.under_way.take(), tuned.since)
        else {
            return;
        };
        self.settings = *settings;
        self.applied(plant_epoch, [taken_at_tick, ready_at_tick], acts_from_tick);
    }

    /// Takes the goal under way one step further.
    fn carry_on_goal(&mut self, handover: &Handover) {
        let Some(UnderWay::Goal(goal)) = &mut self.under_way else { return };
        let progress = goal.carry_on(handover, &self.settings, &mut self.keeper);
        let (origin, taken_at_tick) = (goal.origin(), goal.taken_at_tick());
        if let (Ok(Progress::Followed { .. }), Some(asked)) = (&progress, goal.asked_unix_nanos()) {
            self.followed_unix_nanos = asked;
        }
        match progress {
            Ok(Progress::Waits) => return,
            Ok(Progress::Stays) => {}
            Ok(Progress::Followed { plant_epoch, from }) => match origin {
                Origin::Operator => self.applied(plant_epoch, [taken_at_tick, from], from),
                Origin::Earlier => tracing::info!("the earlier goal is restored"),
                Origin::Schedule => tracing::info!(tick = from, "a goal of the scenario"),
                Origin::Review => tracing::info!(tick = from, "another way around obstacles"),
            },
            Err(refusal) => match origin {
                Origin::Operator => self.refuse(&refusal),
                Origin::Earlier => tracing::warn!("the earlier goal is lost: {refusal}"),
                Origin::Schedule => tracing::warn!("a goal of the scenario is refused: {refusal}"),
                Origin::Review => tracing::warn!("the way is not planned anew: {refusal}"),
            },
        }
        self.under_way = None;
    }

    fn applied(&mut self, plant_epoch: u64, ticks: [u64; 2], acts_from_tick: u64) {
        // A plant that has restarted meanwhile counts its ticks from zero.
        let [taken_at_tick, ready_at_tick] = ticks.map(|tick| tick.min(acts_from_tick));
        self.inbox.answer(Outcome::Applied {
            plant_epoch,
            taken_at_tick,
            ready_at_tick,
            acts_from_tick,
        });
    }
}

impl UnderWay {
    /// Whether an operator waits for an answer.
    fn is_asked(&self) -> bool {
        match self {
            Self::Change { .. } => true,
            Self::Goal(goal) => goal.origin() == Origin::Operator,
        }
    }
}
