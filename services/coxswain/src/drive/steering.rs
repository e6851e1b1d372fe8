//! What the keys request → goals and orders of a launch, and their replies.
//!
//! At most one goal waits for its reply. So a key acts within the time of one exchange, and a
//! controller that is restarted finds one goal at most.

use super::DriveError;
use crate::joined::{JoinError, Joined};
use crate::set::request;
use controller::goal::{Demand, GoalRequest};
use gate::Order;
use process::requests::{Asked, Outcome};
use protocol::message::{GateState, Goal, Participant, PlantState};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};
use teleop::dead_man::{DeadMan, Speeds};
use teleop::keys::Key;
use teleop::steer::{Steer, SteerError};
use transport::Source;

/// Interval between two checks whether the launch still runs.
const CHECK: Duration = Duration::from_millis(200);
/// Time after which a missing reply is shown.
const OVERDUE: Duration = Duration::from_secs(1);
/// Longest wait for the last replies at the end.
const ENDS_WITHIN: Duration = Duration::from_secs(1);
/// Interval between two looks for the last replies.
const LOOK: Duration = Duration::from_millis(2);

/// A request without a reply, since a time.
type Waiting = Option<(Asked, Instant)>;

/// Drives the robot of a launch by keys.
pub(super) struct Steering {
    joined: Joined,
    goals: Source<Goal>,
    states: Source<PlantState>,
    goal: Option<Goal>,
    state: Option<PlantState>,
    dead_man: DeadMan,
    goal_asked: Waiting,
    stop_asked: Waiting,
    checked: Instant,
    /// The last news, which is not repeated.
    told: Option<String>,
}

impl Steering {
    /// Joins the launch in the run directory `run`, or the only one that runs, with the graphs of
    /// this machine in `base`.
    ///
    /// # Errors
    /// [`JoinError`].
    pub(super) fn new(
        run: Option<&Path>,
        base: &Path,
        dead_man: DeadMan,
        now: Instant,
    ) -> Result<Self, JoinError> {
        let joined = Joined::new(run, base)?;
        let (goals, states) = (joined.watcher()?, joined.watcher()?);
        Ok(Self {
            joined,
            goals,
            states,
            goal: None,
            state: None,
            dead_man,
            goal_asked: None,
            stop_asked: None,
            checked: now,
            told: None,
        })
    }

    /// Whether a request waits for its reply.
    pub(super) fn waits(&self) -> bool {
        self.goal_asked.is_some() || self.stop_asked.is_some()
    }

    /// Applies a key that was pressed at `now`. Returns what it changes, if that is worth a line.
    ///
    /// # Errors
    /// [`DriveError`] if the order to stop cannot be written.
    pub(super) fn press(&mut self, key: Key, now: Instant) -> Result<Option<String>, DriveError> {
        match key {
            Key::Drive(direction) => self.dead_man.drive(direction, now),
            Key::Stand | Key::End => self.dead_man.stand(),
            Key::Stop => {
                self.dead_man.stopped();
                if self.stop_asked.is_none() && self.gate() != Some(GateState::Stopped) {
                    let (folder, stop) = (&self.joined.folder, Order::Stop.name());
                    self.stop_asked = Some((request(folder, Participant::Plant, stop)?, now));
                }
            }
            Key::Faster => {
                self.dead_man.faster();
                return Ok(Some(self.speeds()));
            }
            Key::Slower => {
                self.dead_man.slower();
                return Ok(Some(self.speeds()));
            }
        }
        Ok(None)
    }

    /// Takes replies and messages, and gives the goal that is due at `now`. Returns what is new for
    /// the user: a rejection, or a stop.
    ///
    /// # Errors
    /// [`DriveError`] if the launch has ended or a request cannot be written.
    pub(super) fn step(&mut self, now: Instant) -> Result<Option<String>, DriveError> {
        if now.saturating_duration_since(self.checked) >= CHECK {
            self.joined.check()?;
            self.checked = now;
        }
        self.goal = self.goals.latest().map_err(JoinError::from)?.or(self.goal);
        self.state = self.states.latest().map_err(JoinError::from)?.or(self.state);
        let news = match (taken(&mut self.stop_asked), taken(&mut self.goal_asked)) {
            (Some(Outcome::Applied { .. }), _) => {
                Some("stopped; `coxswain resume` lets the robot drive again".to_owned())
            }
            (Some(Outcome::Refused { reason, .. }), _) => Some(format!("stop rejected: {reason}")),
            (None, Some(Outcome::Refused { reason, .. })) => {
                Some(format!("goal rejected: {reason}"))
            }
            (None, Some(Outcome::Applied { .. })) => {
                self.told = None;
                None
            }
            (None, None) => None,
        };
        if self.goal_asked.is_none()
            && let Some(goal) = self.dead_man.due(now)
        {
            self.give(goal, now)?;
        }
        // A held key is rejected many times.
        let news = news.filter(|news| self.told.as_ref() != Some(news));
        self.told = news.clone().or(self.told.take());
        Ok(news)
    }

    /// The keys and the robot at `now`, in one line.
    pub(super) fn line(&self, now: Instant) -> String {
        let triple =
            |[forward, left, rate]: [f64; 3]| format!("{forward:+.2} {left:+.2} {rate:+.2}");
        let keys = triple(self.dead_man.velocity(now));
        let robot = self.state.map_or_else(|| "unknown".to_owned(), |state| triple(state.velocity));
        let gate = self.gate().map_or("unknown", |gate| gate.text());
        let goal = self.goal.map_or_else(
            || "no goal".to_owned(),
            |goal| format!("goal {} {}", goal.id, goal.phase()),
        );
        let overdue = |asked: &Waiting| {
            asked.as_ref().is_some_and(|(_, since)| now.saturating_duration_since(*since) > OVERDUE)
        };
        let silent = match (overdue(&self.stop_asked), overdue(&self.goal_asked)) {
            (true, _) => "; the plant does not reply",
            (false, true) => "; the controller does not reply",
            (false, false) => "",
        };
        format!("keys {keys}; robot {robot}; {gate}; {goal}{silent}")
    }

    /// Lets the robot stand, if a goal of the keys still moves it, and waits for the last replies,
    /// for a bounded time.
    ///
    /// # Errors
    /// [`DriveError`] if a request cannot be written.
    pub(super) fn end(mut self) -> Result<(), DriveError> {
        let begin = Instant::now();
        if self.dead_man.is_moving(begin) {
            self.give(Demand::Hold {}, begin)?;
        }
        while self.waits() && begin.elapsed() < ENDS_WITHIN && self.joined.check().is_ok() {
            thread::sleep(LOOK);
            taken(&mut self.stop_asked);
            taken(&mut self.goal_asked);
        }
        Ok(())
    }

    fn give(&mut self, goal: Demand, now: Instant) -> Result<(), DriveError> {
        let goal = GoalRequest::of(goal);
        let asked = request(&self.joined.folder, Participant::Controller, &goal.text())?;
        self.goal_asked = Some((asked, now));
        Ok(())
    }

    fn speeds(&self) -> String {
        let Speeds { ground_mps, yaw_rate_radps } = self.dead_man.speeds();
        format!("speeds: {ground_mps:.2} m/s, {yaw_rate_radps:.2} rad/s")
    }

    fn gate(&self) -> Option<GateState> {
        self.state.as_ref().map(PlantState::gate)
    }
}

impl Steer for Steering {
    fn press(&mut self, key: Key, now: Instant) -> Result<Option<String>, SteerError> {
        Ok(self.press(key, now)?)
    }

    fn step(&mut self, now: Instant) -> Result<Option<String>, SteerError> {
        Ok(self.step(now)?)
    }

    fn line(&self, now: Instant) -> String {
        self.line(now)
    }

    fn end(self: Box<Self>) -> Result<(), SteerError> {
        Ok((*self).end()?)
    }
}

/// The outcome of a request, once it has a reply.
fn taken(waiting: &mut Waiting) -> Option<Outcome> {
    let settled = waiting.as_ref()?.0.answer()?;
    *waiting = None;
    Some(settled.answer.outcome)
}
