//! What the keys request → goals and orders of a launch, and their replies.
//!
//! At most one goal waits for its reply. So a key acts within the time of one exchange, and a
//! controller that is restarted finds one goal at most.

use super::DriveError;
use super::way::{Awaited, Reply, Way};
use controller::goal::{Demand, GoalRequest};
use gate::Order;
use process::requests::Outcome;
use protocol::message::Participant;
use std::thread;
use std::time::{Duration, Instant};
use teleop::dead_man::{DeadMan, Speeds};
use teleop::keys::Key;
use teleop::steer::{Steer, SteerError};

/// Time after which a missing reply is shown.
const OVERDUE: Duration = Duration::from_secs(1);
/// Longest wait for the last replies at the end.
const ENDS_WITHIN: Duration = Duration::from_secs(1);
/// Interval between two looks for the last replies.
const LOOK: Duration = Duration::from_millis(2);

/// A request without a reply, since a time.
type Waiting = Option<(Awaited, Instant)>;

/// Drives the robot of a launch by keys.
pub(super) struct Steering {
    way: Way,
    dead_man: DeadMan,
    goal_asked: Waiting,
    stop_asked: Waiting,
    /// How long the last goal waited for its reply.
    reply_after: Option<Duration>,
    /// The last news, which is not repeated.
    told: Option<String>,
}

impl Steering {
    /// No key is pressed.
    pub(super) fn new(way: Way, dead_man: DeadMan) -> Self {
        Self { way, dead_man, goal_asked: None, stop_asked: None, reply_after: None, told: None }
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
                if self.stop_asked.is_none() && !self.way.is_stopped() {
                    let stop = Order::Stop.name().to_owned();
                    self.stop_asked = Some((self.way.ask(Participant::Plant, stop)?, now));
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
        self.way.look(now)?;
        let since = self.goal_asked.as_ref().map(|(_, since)| *since);
        let replies = (taken(&mut self.stop_asked), taken(&mut self.goal_asked));
        if let (Some(since), (_, Some(_))) = (since, &replies) {
            self.reply_after = Some(now.saturating_duration_since(since));
        }
        let news = match replies {
            (Some(Reply::Outcome(Outcome::Applied { .. })), _) => {
                Some("stopped; `coxswain resume` lets the robot drive again".to_owned())
            }
            (Some(Reply::Outcome(Outcome::Refused { reason, .. })), _) => {
                self.dead_man.stand();
                Some(format!("stop rejected: {reason}"))
            }
            (Some(Reply::Unknown(reason)), _) => {
                self.dead_man.stand();
                Some(format!("stop not confirmed: {reason}"))
            }
            (None, Some(Reply::Outcome(Outcome::Refused { reason, .. }))) => {
                Some(format!("goal rejected: {reason}"))
            }
            (None, Some(Reply::Unknown(reason))) => Some(format!("goal not confirmed: {reason}")),
            (None, Some(Reply::Outcome(Outcome::Applied { .. }))) => {
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

    /// The keys and the robot at `now`, in one line. From another machine the robot is not seen,
    /// but the time of the last reply.
    pub(super) fn line(&self, now: Instant) -> String {
        let keys = triple(self.dead_man.velocity(now));
        let seen = self.way.line().unwrap_or_else(|| match self.reply_after {
            Some(time) => format!("last reply after {} ms", time.as_millis()),
            None => "no goal yet".to_owned(),
        });
        let overdue = |asked: &Waiting| {
            asked.as_ref().is_some_and(|(_, since)| now.saturating_duration_since(*since) > OVERDUE)
        };
        let silent = match (overdue(&self.stop_asked), overdue(&self.goal_asked)) {
            (true, _) => "; the plant does not reply",
            (false, true) => "; the controller does not reply",
            (false, false) => "",
        };
        format!("keys {keys}; {seen}{silent}")
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
        while self.waits() && begin.elapsed() < ENDS_WITHIN && self.way.may_reply() {
            thread::sleep(LOOK);
            taken(&mut self.stop_asked);
            taken(&mut self.goal_asked);
        }
        Ok(())
    }

    fn give(&mut self, goal: Demand, now: Instant) -> Result<(), DriveError> {
        let goal = GoalRequest::of(goal);
        self.goal_asked = Some((self.way.ask(Participant::Controller, goal.text())?, now));
        Ok(())
    }

    fn speeds(&self) -> String {
        let Speeds { ground_mps, yaw_rate_radps } = self.dead_man.speeds();
        format!("speeds: {ground_mps:.2} m/s, {yaw_rate_radps:.2} rad/s")
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

/// The reply to a request, once it is there.
fn taken(waiting: &mut Waiting) -> Option<Reply> {
    let reply = waiting.as_ref()?.0.reply()?;
    *waiting = None;
    Some(reply)
}

/// A velocity (forward, left, yaw) as text.
pub(super) fn triple([forward, left, rate]: [f64; 3]) -> String {
    format!("{forward:+.2} {left:+.2} {rate:+.2}")
}
