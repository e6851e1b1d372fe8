//! A goal on its way to the control thread: way ahead ▶ reference ▶ exchange.

use super::Refusal;
use crate::adopt::Handover;
use crate::goal::keeper::Keeper;
use crate::goal::{Course, Demand, GoalError, GoalRequest, OUTLOOK_POINTS, Outlook};
use crate::settings::Settings;
use model::Pose;
use process::requests::Request;
use std::time::{Duration, Instant};

/// Attempts to hand the reference over before its begin has passed.
const ATTEMPTS: u32 = 10;
/// Longest wait for a state of the plant.
const PATIENCE: Duration = Duration::from_secs(3);

/// A goal that the control thread does not follow yet.
pub(super) struct GoalUnderWay {
    /// None for a review: the keeper has it.
    request: Option<GoalRequest>,
    id: u64,
    origin: Origin,
    /// Time of its request since 1970, if an operator or a planner made one \[ns\].
    asked_unix_nanos: Option<u64>,
    /// Poses of the course that the control thread has.
    way: Vec<Pose>,
    taken_at_tick: u64,
    stage: Stage,
    attempts: u32,
    since: Instant,
}

/// Where a goal comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    /// An operator, who waits for an answer.
    Operator,
    /// The time before a restart of the controller.
    Earlier,
    /// The scenario.
    Schedule,
    /// The review of the way to the present goal.
    Review,
}

enum Stage {
    /// The way ahead has not been requested yet.
    New,
    /// It has.
    Outlook,
    /// The control thread has the reference.
    Exchange,
}

/// What has become of the goal.
pub(super) enum Progress {
    /// It still waits for the control thread.
    Waits,
    /// The way to the present goal stays as it is.
    Stays,
    /// The control thread follows it.
    Followed {
        /// Epoch of the plant.
        plant_epoch: u64,
        /// First tick.
        from: u64,
    },
}

impl GoalUnderWay {
    pub(super) fn new(request: &Request, id: u64, taken_at_tick: u64) -> Result<Self, GoalError> {
        let goal = GoalRequest::parse(&request.change)?;
        goal.check_age(request.age().as_secs_f64())?;
        let asked_unix_nanos = Some(request.asked_unix_nanos);
        Ok(Self { asked_unix_nanos, ..Self::of(goal, id, Origin::Operator, taken_at_tick) })
    }

    /// A goal of before a restart. A robot on the way to a pose drives there again. One on a path,
    /// or with a velocity, stands: what remains of it is not known.
    pub(super) fn again(request: &Request, id: u64) -> Option<Self> {
        let asked_unix_nanos = Some(request.asked_unix_nanos);
        let mut request = GoalRequest::parse(&request.change).ok()?;
        if !matches!(request.goal, Demand::Pose { .. }) {
            request.goal = Demand::Hold {};
        }
        Some(Self { asked_unix_nanos, ..Self::of(request, id, Origin::Earlier, 0) })
    }

    pub(super) fn of(request: GoalRequest, id: u64, origin: Origin, taken_at_tick: u64) -> Self {
        Self { request: Some(request), id, origin, ..Self::review(taken_at_tick) }
    }

    /// A review of the way to the present goal.
    pub(super) fn review(taken_at_tick: u64) -> Self {
        Self {
            request: None,
            id: 0,
            origin: Origin::Review,
            asked_unix_nanos: None,
            way: Vec::new(),
            taken_at_tick,
            stage: Stage::New,
            attempts: 0,
            since: Instant::now(),
        }
    }

    /// The course from `outlook` on; `None` if the present one stays.
    fn course(
        &self,
        outlook: &Outlook,
        settings: &Settings,
        keeper: &mut Keeper,
    ) -> Result<Option<Course>, GoalError> {
        let (robot, map) = (&settings.robot, &settings.surroundings());
        let period_s = settings.run.period_nanos as f64 * 1e-9;
        match &self.request {
            Some(request) => Course::new(request, self.id, outlook, robot, map, period_s).map(Some),
            None => keeper.review(outlook, robot, map, period_s),
        }
    }

    /// The control thread follows the course.
    fn followed(&mut self, keeper: &mut Keeper) {
        let way = std::mem::take(&mut self.way);
        match &self.request {
            Some(request) => keeper.keep(self.id, request, way),
            None => keeper.take_way(way),
        }
    }

    pub(super) fn origin(&self) -> Origin {
        self.origin
    }

    pub(super) fn asked_unix_nanos(&self) -> Option<u64> {
        self.asked_unix_nanos
    }

    pub(super) fn taken_at_tick(&self) -> u64 {
        self.taken_at_tick
    }

    /// One step further.
    pub(super) fn carry_on(
        &mut self,
        handover: &Handover,
        settings: &Settings,
        keeper: &mut Keeper,
    ) -> Result<Progress, Refusal> {
        match self.stage {
            Stage::New => {
                let outlook = Outlook::with_room(OUTLOOK_POINTS);
                drop(handover.outlook_wanted.force_push(Box::new(outlook)));
                self.stage = Stage::Outlook;
            }
            Stage::Outlook => match handover.outlook.pop() {
                Some(outlook) => {
                    let Some(mut course) = self.course(&outlook, settings, keeper)? else {
                        return Ok(Progress::Stays);
                    };
                    self.way = std::mem::take(&mut course.way);
                    drop(handover.course.push(Box::new(course)));
                    self.stage = Stage::Exchange;
                }
                // A goal of before a restart, or of the scenario, waits for the plant as long as it
                // takes.
                None if self.since.elapsed() > PATIENCE => match self.origin {
                    Origin::Operator => {
                        drop(handover.outlook_wanted.pop());
                        return Err(Refusal::NoState { waited_s: PATIENCE.as_secs_f64() });
                    }
                    Origin::Review => {
                        drop(handover.outlook_wanted.pop());
                        return Ok(Progress::Stays);
                    }
                    Origin::Earlier | Origin::Schedule => {}
                },
                None => {}
            },
            Stage::Exchange => {
                let Some((course, from)) = handover.followed.pop() else {
                    return Ok(Progress::Waits);
                };
                if let Some(from) = from {
                    self.followed(keeper);
                    return Ok(Progress::Followed { plant_epoch: course.goal.plant_epoch, from });
                }
                self.attempts += 1;
                if self.attempts == ATTEMPTS {
                    return Err(Refusal::Late { attempts: ATTEMPTS });
                }
                self.stage = Stage::New;
            }
        }
        Ok(Progress::Waits)
    }
}
