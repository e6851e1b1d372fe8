//! messages → events for an open page: first the present state, and then the news.

use super::answer::event;
use super::horizon::Horizon;
use super::logbook::Entry;
use super::round;
use super::rows::{History, PlanRow, StateRow};
use crate::comparison::{Comparison, Row, Standing};
use crate::settings::{About, Settings};
use process::requests::Settled;
use protocol::message::{
    Coded, FallbackLevel, Goal, Health, ModelSnapshot, Obstacles, Participant, Plan, PlantState,
    Reason,
};
use protocol::view::View;
use run_view::{Counter, Process, RunView, What};
use serde::Serialize;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Shortest time between two updates of the processes.
const PROCESSES_EVERY: Duration = Duration::from_millis(500);
/// Largest number of drawn points of the path without learning.
const POINTS_MAX: usize = 750;

/// The content of the page. Everything in it is bounded.
#[derive(Debug)]
pub(crate) struct Feed {
    robot: String,
    period_s: f64,
    about: About,
    run: RunView,
    states: History<StateRow>,
    plans: History<PlanRow>,
    model: Option<Model>,
    comparison: Comparison,
    news: Gathered,
}

/// Messages since the last event.
#[derive(Debug, Default)]
struct Gathered {
    states: Vec<StateRow>,
    plans: Vec<PlanRow>,
    horizon: Option<Horizon>,
    model: bool,
    goal: bool,
    obstacles: bool,
    entries_told: u64,
    processes_told: Option<Instant>,
}

/// The last published model.
#[derive(Debug, Clone, Serialize)]
struct Model {
    version: u64,
    points: u32,
    samples: u32,
    /// RMS one-step error on samples that were held out of the training \[m/s, m/s, rad/s\].
    learned: [f64; 3],
    /// The same of the main model alone.
    main: [f64; 3],
}

/// State of one process.
#[derive(Debug, Serialize)]
struct ProcessRow<'a> {
    who: &'static str,
    phase: &'static str,
    text: &'a str,
    pid: u32,
    starts: u32,
    silent: bool,
    /// Time since its last message \[s\].
    silence: f64,
    lost: u64,
    refused: u64,
    missed: u64,
    met: u64,
    /// Access of unauthenticated peers, by its code.
    exposure: u32,
}

#[derive(Serialize)]
struct Greeting<'a> {
    gateway: u32,
    robot: &'a str,
    period: f64,
    about: &'a About,
    fallback_levels: Vec<&'static str>,
    reasons: Vec<&'static str>,
    without: Vec<[f64; 4]>,
    states: &'a History<StateRow>,
    plans: &'a History<PlanRow>,
    #[serde(flatten)]
    standing: Stands<'a>,
}

#[derive(Serialize)]
struct News<'a> {
    states: &'a [StateRow],
    plans: &'a [PlanRow],
    #[serde(flatten)]
    standing: Stands<'a>,
}

/// The common part of both events.
#[derive(Serialize)]
struct Stands<'a> {
    /// Identity of the plant: writer and epoch.
    run: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    horizon: Option<&'a Horizon>,
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<&'a Model>,
    #[serde(skip_serializing_if = "Option::is_none")]
    goal: Option<View<'a, Goal>>,
    /// Velocity, radius and corners of each \[m/s, m/s, m, m, …\].
    #[serde(skip_serializing_if = "Option::is_none")]
    obstacles: Option<Vec<Vec<f64>>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    processes: Vec<ProcessRow<'a>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    entries: Vec<Entry>,
    #[serde(skip_serializing_if = "Option::is_none")]
    compared: Option<Standing>,
}

impl Feed {
    /// A feed without messages. `without` is the same run without learning.
    pub(super) fn new(settings: &Settings, without: Vec<Row>) -> Self {
        Self {
            robot: settings.telemetry.robot.clone(),
            period_s: settings.run.period_nanos as f64 * 1e-9,
            about: About { without_learning: None, ..settings.about.clone() },
            run: RunView::default(),
            states: History::new(),
            plans: History::new(),
            model: None,
            comparison: Comparison::new(without),
            news: Gathered::default(),
        }
    }

    fn seconds(&self, tick: u64) -> f64 {
        tick as f64 * self.period_s
    }

    /// Receives a measured state.
    pub(crate) fn receive_state(&mut self, state: &PlantState) {
        if self.run.receive_state(state) {
            self.states.clear();
            self.plans.clear();
            self.comparison.start_again();
            self.news = Gathered {
                model: self.news.model,
                entries_told: self.news.entries_told,
                ..Gathered::default()
            };
        }
        let row = StateRow::new(state, self.seconds(state.stamp.tick));
        self.states.push(row);
        self.news.states.push(row);
    }

    /// Receives a plan.
    pub(crate) fn receive_plan(&mut self, plan: &Plan) {
        // The answer to another epoch of the plant does not belong to this run.
        if self.run.state.as_ref().is_none_or(|state| state.stamp.epoch != plan.plant_epoch) {
            return;
        }
        let seconds = self.seconds(plan.stamp.tick);
        let row = PlanRow::new(plan, seconds);
        self.comparison.add(plan.stamp.tick, row.error);
        self.plans.push(row);
        self.news.plans.push(row);
        self.news.horizon = Some(Horizon::new(plan, seconds, self.period_s));
    }

    /// Receives a learned model.
    pub(crate) fn receive_snapshot(&mut self, snapshot: &ModelSnapshot) {
        let head = &snapshot.head;
        let rounded = |score: [f64; 3]| score.map(round);
        self.news.model = true;
        self.model = Some(Model {
            version: head.version,
            points: head.points,
            samples: head.score_samples,
            learned: rounded(head.score_learned),
            main: rounded(head.score_main),
        });
    }

    /// Receives the present goal, or the end of one.
    pub(crate) fn receive_goal(&mut self, goal: &Goal) {
        self.run.receive_goal(goal);
        self.news.goal = true;
    }

    /// Receives a list of obstacles.
    pub(crate) fn receive_obstacles(&mut self, list: &Obstacles, now: Instant) {
        self.run.receive_obstacles(list, now);
        self.news.obstacles = true;
    }

    /// Receives the health of a process.
    pub(crate) fn receive_health(&mut self, health: &Health, now: Instant) {
        self.run.receive_health(health, now);
    }

    /// Receives a change of the settings, or its refusal.
    pub(crate) fn receive_change(&mut self, settled: &Settled) {
        if let Some(who) = Participant::of_word(&settled.process) {
            self.run.note(who, What::Change(settled.to_string()));
        }
    }

    /// Reports processes that have become silent, and drops obstacles that are too old.
    pub(super) fn look_around(&mut self, now: Instant) {
        self.run.look_for_silence(now);
        self.news.obstacles |= self.run.drop_old_obstacles(now);
    }

    /// The present state and the last minute, for a new viewer.
    pub(super) fn greeting(&self, now: Instant) -> Arc<str> {
        let step = self.comparison.rows().len().div_ceil(POINTS_MAX).max(1);
        let without = self.comparison.rows().iter().step_by(step);
        let greeting = Greeting {
            gateway: std::process::id(),
            robot: &self.robot,
            period: self.period_s,
            about: &self.about,
            fallback_levels: FallbackLevel::ALL
                .iter()
                .map(|fallback_level| fallback_level.text())
                .collect(),
            reasons: Reason::ALL.iter().map(|reason| reason.text()).collect(),
            without: without
                .map(|row| [self.seconds(row.tick), row.x_m, row.y_m, row.error_m].map(round))
                .collect(),
            states: &self.states,
            plans: &self.plans,
            standing: self.stands(now, true, 0),
        };
        event_of("hello", &greeting)
    }

    /// The news, if there are any; clears them.
    pub(super) fn news(&mut self, now: Instant) -> Option<Arc<str>> {
        let news = std::mem::take(&mut self.news);
        let entries_told = self.run.noted();
        let processes = news
            .processes_told
            .is_none_or(|told| now.saturating_duration_since(told) >= PROCESSES_EVERY);
        self.news.entries_told = entries_told;
        self.news.processes_told = if processes { Some(now) } else { news.processes_told };
        let nothing = news.states.is_empty()
            && news.plans.is_empty()
            && !news.model
            && !news.goal
            && !news.obstacles
            && entries_told == news.entries_told;
        if nothing && !processes {
            return None;
        }
        let mut standing = self.stands(now, processes, news.entries_told);
        standing.horizon = news.horizon.as_ref();
        standing.model = standing.model.filter(|_| news.model);
        standing.goal = standing.goal.filter(|_| news.goal);
        standing.obstacles = standing.obstacles.filter(|_| news.obstacles);
        Some(event_of("news", &News { states: &news.states, plans: &news.plans, standing }))
    }

    /// Clears the news: no page is open.
    pub(super) fn forget_news(&mut self) {
        let entries_told = self.run.noted();
        self.news = Gathered { entries_told, ..Gathered::default() };
    }

    /// The obstacles of all sources.
    fn drawn_obstacles(&self) -> Vec<Vec<f64>> {
        let rows = self.run.obstacles.values().flat_map(|seen| seen.list.rows());
        rows.map(|row| row.iter().copied().map(round).collect()).collect()
    }

    fn stands(&self, now: Instant, processes: bool, entries_told: u64) -> Stands<'_> {
        let run = &self.run;
        let rows = run.processes.iter().map(|(&who, process)| process_row(who, process, now));
        let entries = run.events_since(entries_told);
        let plant = run.state.as_ref().map(|state| state.stamp);
        Stands {
            run: plant.map(|stamp| format!("{:x}-{}", stamp.writer, stamp.epoch)),
            horizon: self.news.horizon.as_ref(),
            model: self.model.as_ref(),
            goal: run.goal.as_ref().map(View),
            obstacles: Some(self.drawn_obstacles()),
            processes: if processes { rows.collect() } else { Vec::new() },
            entries: entries.filter_map(|event| Entry::of(event, self.period_s)).collect(),
            compared: self.comparison.standing(),
        }
    }
}

fn process_row(who: Participant, process: &Process, now: Instant) -> ProcessRow<'_> {
    let health = &process.health;
    ProcessRow {
        who: who.text(),
        phase: health.phase().text(),
        text: health.last_error(),
        pid: health.pid,
        starts: process.starts,
        silent: process.is_silent(now),
        silence: (now.saturating_duration_since(process.received).as_secs_f64() * 10.0).round()
            / 10.0,
        lost: Counter::Lost.of(health),
        refused: Counter::Malformed.of(health),
        missed: health.deadlines_missed,
        met: health.deadlines_met,
        exposure: health.exposure,
    }
}

/// Encodes an event. Serialisation cannot fail: numbers that are not finite become null.
fn event_of(name: &str, what: &impl Serialize) -> Arc<str> {
    event(name, &serde_json::to_string(what).unwrap_or_else(|_| "{}".to_owned())).into()
}
