//! What was received → what is shown. This module uses no terminal and no clock: times are
//! arguments.

use super::trail::Trail;
use crate::presence::Presence;
use network::telemetry::{Telemetry, TelemetryMessage};
use protocol::message::{FallbackLevel, Participant, Plan, PlantState, Reason};
use protocol::topic::Topic;
use run_view::{Event, RunView, What};
use std::time::{Duration, Instant};

/// How long its return is shown.
const WELCOME: Duration = Duration::from_secs(5);

/// Time over which the one-step errors are averaged \[s\].
pub const RECENT_S: f64 = 5.0;

/// Whether the robot is present.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// No message of it was received yet.
    Awaited,
    /// Its messages arrive.
    Live,
    /// Its messages arrive again, since a short time ago.
    Back,
    /// Its messages have been absent for this time.
    Lost(Duration),
}

/// One-step errors of the velocity \[m/s, m/s, rad/s\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OneStep {
    /// Of the main model alone: before learning.
    pub main: [f64; 3],
    /// Of the whole model: after learning.
    pub whole: [f64; 3],
}

/// Messages that did not arrive, from the counters of all processes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Losses {
    /// Lost on the way.
    pub lost: u64,
    /// Rejected as malformed.
    pub refused: u64,
    /// Dropped from a queue to the network.
    pub dropped: u64,
}

/// Everything that is known of one robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The endpoint at which it is watched.
    pub endpoint: String,
    /// Its name.
    pub robot: Option<String>,
    /// Control period \[ns\]; 0 if it is unknown.
    pub period_nanos: u64,
    /// Its present state, and the events.
    pub run: RunView,
    /// Newest plan.
    pub plan: Option<Box<Plan>>,
    /// Past positions \[m\].
    pub path: Trail<[f64; 2]>,
    /// Past reference positions \[m\].
    pub reference: Trail<[f64; 2]>,
    /// Distance from the reference \[m\].
    pub error: Trail<f64>,
    /// One-step errors.
    pub one_step: Trail<OneStep>,
    /// Time from the received state to the computed command \[ns\].
    pub tick_nanos: Trail<u64>,
    presence: Presence,
    back: Option<Instant>,
}

impl Picture {
    /// A picture without messages, of a robot that is watched at `endpoint`.
    pub fn new(endpoint: &str) -> Self {
        Self {
            endpoint: endpoint.to_owned(),
            robot: None,
            period_nanos: 0,
            run: RunView::default(),
            plan: None,
            path: Trail::default(),
            reference: Trail::default(),
            error: Trail::default(),
            one_step: Trail::default(),
            tick_nanos: Trail::default(),
            presence: Presence::default(),
            back: None,
        }
    }

    /// Processes a message received at `now`. Of several robots the first is shown.
    pub fn receive(&mut self, telemetry: Telemetry, now: Instant) {
        if *self.robot.get_or_insert_with(|| telemetry.robot.clone()) != telemetry.robot {
            return;
        }
        self.period_nanos = telemetry.period_nanos;
        match telemetry.message {
            TelemetryMessage::State(state) => self.receive_state(&state, now),
            TelemetryMessage::Plan(plan) => self.receive_plan(plan),
            TelemetryMessage::Health(health) => self.run.receive_health(&health, now),
            TelemetryMessage::Goal(goal) => self.run.receive_goal(&goal),
            TelemetryMessage::Obstacles(list) => self.run.receive_obstacles(&list, now),
        }
    }

    /// Lets time pass: a robot that has been silent for too long is lost, and old lists of
    /// obstacles are no longer shown.
    pub fn look(&mut self, now: Instant) {
        if self.presence.falls_silent(now) {
            self.run.note(Participant::Plant, What::Lost);
        }
        self.run.drop_old_obstacles(now);
    }

    /// The events with their times \[s\], oldest first.
    pub fn events(&self) -> impl DoubleEndedIterator<Item = (f64, String)> + '_ {
        let shown =
            self.run.events_since(0).filter(|event| !matches!(event.what, What::Refused(_)));
        shown.map(|event| (self.seconds_of(event.tick), event_text(event)))
    }

    /// Whether the robot is present at `now`.
    pub fn contact(&self, now: Instant) -> Contact {
        match self.presence.silent_for(now) {
            None => Contact::Awaited,
            Some(silent) if self.presence.is_lost() => Contact::Lost(silent),
            Some(_)
                if self.back.is_some_and(|back| now.saturating_duration_since(back) < WELCOME) =>
            {
                Contact::Back
            }
            Some(_) => Contact::Live,
        }
    }

    /// Time of the run \[s\].
    pub fn seconds(&self) -> f64 {
        self.seconds_of(self.run.tick())
    }

    /// Root mean square of the recent one-step errors, per axis; none before the first.
    pub fn recent_one_step(&self) -> Option<OneStep> {
        let (mut main, mut whole, mut count) = ([0.0; 3], [0.0; 3], 0.0);
        for (_, errors) in self.one_step.newest(RECENT_S) {
            count += 1.0;
            for axis in 0..3 {
                main[axis] += errors.main[axis].powi(2);
                whole[axis] += errors.whole[axis].powi(2);
            }
        }
        let mean = |sum: f64| (sum / count).sqrt();
        (count > 0.0).then(|| OneStep { main: main.map(mean), whole: whole.map(mean) })
    }

    /// Longest of the recent ticks \[ns\].
    pub fn longest_tick_nanos(&self) -> u64 {
        self.tick_nanos.newest(RECENT_S).map(|(_, nanos)| nanos).max().unwrap_or(0)
    }

    /// The losses of one topic.
    pub fn losses_of(&self, topic: Topic) -> Losses {
        let of = |counts: &[u64]| counts.get(topic.index()).copied().unwrap_or(0);
        let healths = self.run.processes.values().map(|process| &process.health);
        healths.fold(Losses::default(), |sum, health| Losses {
            lost: sum.lost.saturating_add(of(&health.lost)),
            refused: sum.refused.saturating_add(of(&health.refused)),
            dropped: sum.dropped.saturating_add(of(&health.dropped)),
        })
    }

    fn seconds_of(&self, tick: u64) -> f64 {
        tick as f64 * self.period_nanos as f64 * 1e-9
    }

    fn receive_state(&mut self, state: &PlantState, now: Instant) {
        let was_lost = self.presence.receive(now, self.period_nanos);
        if self.run.receive_state(state) {
            self.begin_anew();
        }
        if was_lost {
            self.back = Some(now);
            self.run.note(Participant::Plant, What::Back);
        }
        let seconds = self.seconds();
        let [x, y, _] = state.pose;
        if x.is_finite() && y.is_finite() {
            self.path.push(seconds, [x, y]);
        }
    }

    fn receive_plan(&mut self, plan: Box<Plan>) {
        let seconds = self.seconds_of(plan.stamp.tick);
        if self.error.last().is_some_and(|(last, _)| seconds < last) {
            // The answer belongs to a former plant, or it is one of the first answers to a new one.
            self.begin_anew();
        }
        let [now, ..] = plan.reference;
        if now.iter().all(|number| number.is_finite()) {
            self.reference.push(seconds, [now[0], now[1]]);
        }
        if plan.position_error().is_finite() {
            self.error.push(seconds, plan.position_error());
        }
        if plan.residual.iter().chain(&plan.innovation).all(|number| number.is_finite()) {
            self.one_step.push(seconds, OneStep { main: plan.residual, whole: plan.innovation });
        }
        self.tick_nanos.push(seconds, plan.tick_nanos);
        self.plan = Some(plan);
    }

    /// Clears the run, because a new one has begun.
    fn begin_anew(&mut self) {
        self.path.clear();
        self.reference.clear();
        self.error.clear();
        self.one_step.clear();
        self.tick_nanos.clear();
        self.plan = None;
    }
}

/// The text of an event. Events of the robot have no name before them.
fn event_text(Event { who, what, .. }: &Event) -> String {
    match what {
        What::Level(_, to, cause) => fallback_level_and_reason(*to, *cause),
        What::Goal(_) | What::Lost | What::Back => what.to_string(),
        what => format!("{who}: {what}"),
    }
}

/// The fallback level and its reason, in words.
pub fn fallback_level_and_reason(fallback_level: FallbackLevel, reason: Reason) -> String {
    match reason {
        Reason::None => fallback_level.to_string(),
        reason => format!("{fallback_level}: {reason}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::specimen;
    use super::*;

    fn at(begin: Instant, millis: u64) -> Instant {
        begin + Duration::from_millis(millis)
    }

    #[test]
    fn the_robot_is_awaited_then_live_then_lost_then_back() {
        let begin = Instant::now();
        let mut picture = Picture::new("tcp/127.0.0.1:1");
        picture.look(at(begin, 9000));
        assert_eq!(picture.contact(at(begin, 9000)), Contact::Awaited);
        picture.receive(specimen::state(1), at(begin, 10_000));
        picture.look(at(begin, 10_900));
        assert_eq!(picture.contact(at(begin, 10_900)), Contact::Live);
        picture.look(at(begin, 12_000));
        assert_eq!(picture.contact(at(begin, 12_500)), Contact::Lost(Duration::from_millis(2500)));
        picture.receive(specimen::health(Participant::Gateway), at(begin, 12_600));
        assert!(
            matches!(picture.contact(at(begin, 12_600)), Contact::Lost(_)),
            "a process is not the robot"
        );
        picture.receive(specimen::state(2), at(begin, 13_000));
        assert_eq!(picture.contact(at(begin, 13_100)), Contact::Back);
        assert_eq!(picture.contact(at(begin, 19_000)), Contact::Live);
        let events = picture.run.events_since(0).map(|event| event.what.clone());
        assert_eq!(events.collect::<Vec<_>>(), [What::Lost, What::Back]);
    }

    #[test]
    fn a_slow_robot_is_not_lost_within_three_periods_of_silence() {
        let begin = Instant::now();
        let mut picture = Picture::new("");
        picture.receive(Telemetry { period_nanos: 1_000_000_000, ..specimen::state(1) }, begin);
        picture.look(at(begin, 2900));
        assert_eq!(picture.contact(at(begin, 2900)), Contact::Live);
    }

    #[test]
    fn the_first_robot_is_shown_and_no_other() {
        let begin = Instant::now();
        let mut picture = Picture::new("");
        picture.receive(specimen::state(1), begin);
        picture.receive(Telemetry { robot: "another".into(), ..specimen::state(70) }, begin);
        assert_eq!(picture.run.state.map(|state| state.stamp.tick), Some(1));
        assert_eq!(picture.robot.as_deref(), Some(specimen::ROBOT));
    }

    #[test]
    fn errors_before_and_after_learning_are_averaged_over_the_recent_past()
    -> Result<(), &'static str> {
        let mut picture = Picture::new("");
        picture.period_nanos = 100_000_000;
        assert_eq!(picture.recent_one_step(), None);
        for tick in 0..200 {
            picture.receive(specimen::plan(tick), Instant::now());
        }
        let recent = picture.recent_one_step().ok_or("nothing was averaged")?;
        for axis in 0..3 {
            assert!((recent.main[axis] - specimen::RESIDUAL[axis].abs()).abs() < 1e-12);
            assert!((recent.whole[axis] - specimen::INNOVATION[axis].abs()).abs() < 1e-12);
        }
        Ok(())
    }

    #[test]
    fn a_new_run_begins_with_an_empty_map() {
        let begin = Instant::now();
        let mut picture = specimen::picture(begin);
        assert!(picture.path.all().count() > 100);
        let mut first = specimen::state(0);
        if let TelemetryMessage::State(state) = &mut first.message {
            (state.stamp.epoch, state.stamp.writer) = (2, 99);
        }
        picture.receive(first, begin);
        assert_eq!(
            (picture.path.all().count(), picture.error.all().count(), picture.plan.is_none()),
            (1, 0, true)
        );
        assert!(
            picture.run.events_since(0).any(|event| event.what == What::NewRun(2)),
            "{:?}",
            picture.run
        );
    }

    #[test]
    fn obstacles_are_shown_until_their_list_is_too_old() {
        let begin = Instant::now();
        let mut picture = Picture::new("");
        picture.receive(specimen::state(1), begin);
        picture.receive(specimen::obstacles(), begin);
        picture.look(at(begin, 1400));
        assert_eq!(picture.run.obstacles.len(), 1);
        picture.look(at(begin, 1600));
        assert!(picture.run.obstacles.is_empty());
    }

    #[test]
    fn losses_are_summed_over_the_processes() {
        let picture = specimen::picture(Instant::now());
        assert_eq!(
            picture.losses_of(Topic::State),
            Losses { lost: 2 * specimen::LOST, refused: 0, dropped: 0 }
        );
        assert_eq!(picture.losses_of(Topic::Plan), Losses::default());
    }

    #[test]
    fn non_finite_numbers_reach_no_chart() {
        let (mut state, mut plan) = (specimen::state(1), specimen::plan(1));
        if let (TelemetryMessage::State(state), TelemetryMessage::Plan(plan)) =
            (&mut state.message, &mut plan.message)
        {
            (state.pose[0], plan.predicted[0][0], plan.reference[0][1], plan.residual[2]) =
                (f64::NAN, f64::NAN, f64::INFINITY, f64::NAN);
        }
        let mut picture = Picture::new("");
        picture.receive(state, Instant::now());
        picture.receive(plan, Instant::now());
        let points = [
            picture.path.all().count(),
            picture.reference.all().count(),
            picture.error.all().count(),
            picture.one_step.all().count(),
        ];
        assert_eq!(points, [0; 4]);
    }
}
