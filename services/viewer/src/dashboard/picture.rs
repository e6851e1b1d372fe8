//! What was received → what is shown. This module uses no terminal and no clock: times are
//! arguments.

use super::trail::Trail;
use crate::presence::Presence;
use network::telemetry::{Heard, Word};
use protocol::message::{
    Exposure, FallbackLevel, Goal, GoalPhase, Health, ObstacleSource, Obstacles, Participant, Plan,
    PlantState, Reason,
};
use protocol::topic::Topic;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// How long its return is shown.
const WELCOME: Duration = Duration::from_secs(5);

/// Time over which the one-step errors are averaged \[s\].
pub const RECENT_S: f64 = 5.0;

/// Time after its validity for which a list of obstacles is still shown.
const SHOWN_AFTER: Duration = Duration::from_secs(1);

/// Largest number of stored events.
const EVENTS_MAX: usize = 50;

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

/// One process, as of its last Health.
#[derive(Debug, Clone, PartialEq)]
pub struct Process {
    /// Its last Health.
    pub health: Box<Health>,
    /// When the Health was received.
    pub heard: Instant,
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

/// The last list of obstacles of one source.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenObstacles {
    /// The list.
    pub list: Box<Obstacles>,
    /// When it was received.
    pub heard: Instant,
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
    /// Newest state.
    pub state: Option<Box<PlantState>>,
    /// Newest plan.
    pub plan: Option<Box<Plan>>,
    /// The present goal, or the last one.
    pub goal: Option<Goal>,
    /// Obstacles, by source.
    pub obstacles: BTreeMap<ObstacleSource, SeenObstacles>,
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
    /// Its processes.
    pub processes: BTreeMap<Participant, Process>,
    /// Events, with the time of the run \[s\]; oldest first.
    pub events: Vec<(f64, String)>,
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
            state: None,
            plan: None,
            goal: None,
            obstacles: BTreeMap::new(),
            path: Trail::default(),
            reference: Trail::default(),
            error: Trail::default(),
            one_step: Trail::default(),
            tick_nanos: Trail::default(),
            processes: BTreeMap::new(),
            events: Vec::new(),
            presence: Presence::default(),
            back: None,
        }
    }

    /// Processes a message received at `now`. Of several robots the first is shown.
    pub fn hear(&mut self, word: Word, now: Instant) {
        if *self.robot.get_or_insert_with(|| word.robot.clone()) != word.robot {
            return;
        }
        self.period_nanos = word.period_nanos;
        match word.said {
            Heard::State(state) => self.hear_state(state, now),
            Heard::Plan(plan) => self.hear_plan(plan),
            Heard::Health(health) => self.hear_health(health, now),
            Heard::Goal(goal) => self.hear_goal(*goal),
            Heard::Obstacles(list) => {
                self.obstacles.insert(list.source(), SeenObstacles { list, heard: now });
            }
        }
    }

    /// Lets time pass: a robot that has been silent for too long is lost, and old lists of
    /// obstacles are no longer shown.
    pub fn look(&mut self, now: Instant) {
        if self.presence.falls_silent(now) {
            self.note("lost: no message from the robot".to_owned());
        }
        self.obstacles.retain(|_, seen| {
            let valid = Duration::try_from_secs_f64(seen.list.valid_s).unwrap_or_default();
            now.saturating_duration_since(seen.heard) <= valid.saturating_add(SHOWN_AFTER)
        });
    }

    /// Target of the goal that the robot is on the way to, or stands at \[m\].
    pub fn target(&self) -> Option<[f64; 2]> {
        let goal = self
            .goal
            .as_ref()
            .filter(|goal| matches!(goal.phase(), GoalPhase::Active | GoalPhase::Reached))?;
        let [x, y, _] = goal.target;
        (x.is_finite() && y.is_finite()).then_some([x, y])
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

    /// The worst exposure that the processes report.
    pub fn exposure(&self) -> Exposure {
        self.processes
            .values()
            .map(|process| process.health.exposure())
            .max()
            .unwrap_or(Exposure::Closed)
    }

    /// Time of the run \[s\].
    pub fn seconds(&self) -> f64 {
        self.state.as_ref().map_or(0.0, |state| self.seconds_of(state.stamp.tick))
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
        let sum = |count: &dyn Fn(&Health) -> [u64; protocol::topic::TOPIC_COUNT]| {
            let of_topic = self
                .processes
                .values()
                .filter_map(|process| count(&process.health).get(topic.index()).copied());
            of_topic.fold(0, u64::saturating_add)
        };
        Losses {
            lost: sum(&|health| health.lost),
            refused: sum(&|health| health.refused),
            dropped: sum(&|health| health.dropped),
        }
    }

    fn seconds_of(&self, tick: u64) -> f64 {
        tick as f64 * self.period_nanos as f64 * 1e-9
    }

    fn hear_state(&mut self, state: Box<PlantState>, now: Instant) {
        let was_lost = self.presence.heard(now, self.period_nanos);
        if let Some(before) = &self.state
            && (before.stamp.epoch, before.stamp.writer) != (state.stamp.epoch, state.stamp.writer)
        {
            self.begin_anew();
            self.note(format!("plant has restarted, epoch {}", state.stamp.epoch));
        }
        if was_lost {
            self.back = Some(now);
            self.note_at(self.seconds_of(state.stamp.tick), "the robot is back".to_owned());
        }
        let before = self.state.as_ref().map(|before| (before.fallback_level(), before.cause()));
        let seconds = self.seconds_of(state.stamp.tick);
        if before.is_some_and(|before| before != (state.fallback_level(), state.cause())) {
            self.note_at(seconds, fallback_level_and_reason(state.fallback_level(), state.cause()));
        }
        let [x, y, _] = state.pose;
        if x.is_finite() && y.is_finite() {
            self.path.push(seconds, [x, y]);
        }
        self.state = Some(state);
    }

    fn hear_goal(&mut self, goal: Goal) {
        let before = self.goal.replace(goal).map(|before| (before.id, before.phase));
        if before != Some((goal.id, goal.phase)) {
            self.note(format!("goal {} ({}): {}", goal.id, goal.kind(), goal.phase()));
        }
    }

    fn hear_plan(&mut self, plan: Box<Plan>) {
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

    fn hear_health(&mut self, health: Box<Health>, now: Instant) {
        let Some(who) = health.participant() else { return };
        let (phase, error, epoch) =
            (health.phase(), health.last_error().to_owned(), health.stamp.epoch);
        let writer = health.stamp.writer;
        let before = self
            .processes
            .insert(who, Process { health, heard: now })
            .map(|process| process.health);
        let started = before.as_ref().is_some_and(|before| before.stamp.writer != writer);
        if started {
            self.note(format!("{who} has restarted, epoch {epoch}"));
        } else if before.as_ref().is_some_and(|before| before.phase() != phase) {
            self.note(format!("{who} is {phase}"));
        }
        if !error.is_empty() && before.is_none_or(|before| before.last_error() != error) {
            self.note(format!("{who}: {error}"));
        }
    }

    /// Clears the run, because a new one has begun.
    fn begin_anew(&mut self) {
        self.path.clear();
        self.reference.clear();
        self.error.clear();
        self.one_step.clear();
        self.tick_nanos.clear();
        self.obstacles.clear();
        self.plan = None;
    }

    fn note(&mut self, what: String) {
        self.note_at(self.seconds(), what);
    }

    fn note_at(&mut self, seconds: f64, what: String) {
        if self.events.len() == EVENTS_MAX {
            self.events.remove(0);
        }
        self.events.push((seconds, what));
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
        picture.hear(specimen::state(1), at(begin, 10_000));
        picture.look(at(begin, 10_900));
        assert_eq!(picture.contact(at(begin, 10_900)), Contact::Live);
        picture.look(at(begin, 12_000));
        assert_eq!(picture.contact(at(begin, 12_500)), Contact::Lost(Duration::from_millis(2500)));
        picture.hear(specimen::health(Participant::Gateway), at(begin, 12_600));
        assert!(
            matches!(picture.contact(at(begin, 12_600)), Contact::Lost(_)),
            "a process is not the robot"
        );
        picture.hear(specimen::state(2), at(begin, 13_000));
        assert_eq!(picture.contact(at(begin, 13_100)), Contact::Back);
        assert_eq!(picture.contact(at(begin, 19_000)), Contact::Live);
        let texts: Vec<&str> = picture.events.iter().map(|(_, what)| what.as_str()).collect();
        assert_eq!(texts, ["lost: no message from the robot", "the robot is back"]);
    }

    #[test]
    fn a_slow_robot_is_not_lost_within_three_periods_of_silence() {
        let begin = Instant::now();
        let mut picture = Picture::new("");
        picture.hear(Word { period_nanos: 1_000_000_000, ..specimen::state(1) }, begin);
        picture.look(at(begin, 2900));
        assert_eq!(picture.contact(at(begin, 2900)), Contact::Live);
    }

    #[test]
    fn the_first_robot_is_shown_and_no_other() {
        let begin = Instant::now();
        let mut picture = Picture::new("");
        picture.hear(specimen::state(1), begin);
        picture.hear(Word { robot: "another".into(), ..specimen::state(70) }, begin);
        assert_eq!(picture.state.map(|state| state.stamp.tick), Some(1));
        assert_eq!(picture.robot.as_deref(), Some(specimen::ROBOT));
    }

    #[test]
    fn errors_before_and_after_learning_are_averaged_over_the_recent_past()
    -> Result<(), &'static str> {
        let mut picture = Picture::new("");
        picture.period_nanos = 100_000_000;
        assert_eq!(picture.recent_one_step(), None);
        for tick in 0..200 {
            picture.hear(specimen::plan(tick), Instant::now());
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
        if let Heard::State(state) = &mut first.said {
            (state.stamp.epoch, state.stamp.writer) = (2, 99);
        }
        picture.hear(first, begin);
        assert_eq!(
            (picture.path.all().count(), picture.error.all().count(), picture.plan.is_none()),
            (1, 0, true)
        );
        assert!(
            picture.events.iter().any(|(_, what)| what == "plant has restarted, epoch 2"),
            "{:?}",
            picture.events
        );
    }

    #[test]
    fn obstacles_are_shown_until_their_list_is_too_old() {
        let begin = Instant::now();
        let mut picture = Picture::new("");
        picture.hear(specimen::state(1), begin);
        picture.hear(specimen::obstacles(), begin);
        picture.look(at(begin, 1400));
        assert_eq!(picture.obstacles.len(), 1);
        picture.look(at(begin, 1600));
        assert!(picture.obstacles.is_empty());
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
        if let (Heard::State(state), Heard::Plan(plan)) = (&mut state.said, &mut plan.said) {
            (state.pose[0], plan.predicted[0][0], plan.reference[0][1], plan.residual[2]) =
                (f64::NAN, f64::NAN, f64::INFINITY, f64::NAN);
        }
        let mut picture = Picture::new("");
        picture.hear(state, Instant::now());
        picture.hear(plan, Instant::now());
        let points = [
            picture.path.all().count(),
            picture.reference.all().count(),
            picture.error.all().count(),
            picture.one_step.all().count(),
        ];
        assert_eq!(points, [0; 4]);
    }
}
