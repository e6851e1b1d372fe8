//! Rule h: how far the true robot may be from its reference.
//!
//! | here         | in docs/faults.md | what it is                                               |
//! |--------------|-------------------|----------------------------------------------------------|
//! | `error`      | e                 | distance of the true position from the reference \[m\]   |
//! | `reference`  | r                 | where the robot should be \[m\]                          |
//! | `fault_free` | B                 | bound where nothing is wrong \[m\]                       |
//! | `apart`      | Δv                | speed of the robot relative to the reference \[m/s\]     |
//! | `lag_s`      | τ                 | time in which the body follows its wheels \[s\]          |
//! | `pull`       | a                 | acceleration that is there to catch up \[m/s²\]          |
//!
//! docs/faults.md derives the bounds. Each plant epoch is walked through tick by tick:
//!
//! ```text
//!          no answer acts                       an answer acts
//! driving ───────────────▶ unanswered ─────────────────────────▶ catching up ──▶ driving
//! e ≤ B                    e ≤ B + e₀ + |r − r₀| + D             e ≤ P, and in time e ≤ B
//! ```

use super::oracle::{Limits, Rule, Ticks, Violation, by_epoch, commanded};
use super::record::{Message, Record};
use controller::reference::{PointsError, Reference, ReferenceSettings};
use graph::assembly::Assembly;
use model::main_model::MainModel;
use std::collections::BTreeMap;
use std::ops::Range;

/// How much more slowly the true body follows its wheels than the lighter body of the robot file.
const SLOWER: f64 = 2.0;
/// Along a diagonal two of four wheels push.
const DIAGONAL: f64 = 0.5;
/// Permitted time to return to the reference, as a multiple of the fastest one.
const UNHURRIED: f64 = 2.0;
/// Permitted error as a multiple of a twin's error: noise and random forces differ.
const TWINS: f64 = 2.0;

/// Largest distances from the reference in runs without faults \[m\].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twin {
    /// On fresh plans, including the cold start.
    pub fresh_m: f64,
    /// With an optimiser that has no plan.
    pub without_optimiser_m: f64,
}

/// The reference of a robot, and its ability to follow it.
#[derive(Debug, Clone)]
pub struct Course {
    reference: ReferenceSettings,
    start: [f64; 3],
    period_s: f64,
    brake_mps2: f64,
    lag_s: f64,
    twin: Twin,
}

/// Ticks in which the robot cannot follow its reference.
#[derive(Debug, Clone, Copy, Default)]
pub struct Windows<'a> {
    /// The controller gets wrong states, or other commands act than it sent.
    pub misled: &'a [Range<u64>],
    /// The floor does not permit the acceleration of the reference.
    pub slippery: &'a [Range<u64>],
}

/// Result of the judgement.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tracked {
    /// Where the robot was too far away.
    pub violations: Vec<Violation>,
    /// The largest distance from the reference, as a share of its bound.
    pub share: Option<f64>,
}

impl Course {
    /// The course of an assembled graph.
    pub fn of(assembly: &Assembly, twin: Twin) -> Self {
        let period_s = assembly.scenario.period_millis * 1e-3;
        let main = MainModel::new(&assembly.robot, period_s);
        Self {
            reference: assembly.scenario.reference.clone(),
            start: assembly.scenario.start.pose,
            period_s,
            brake_mps2: assembly.robot.limits.brake_mps2,
            lag_s: -SLOWER * period_s / main.decay[0].ln(),
            twin,
        }
    }

    /// The same course, with the results of its twins.
    #[must_use]
    pub fn with(self, twin: Twin) -> Self {
        Self { twin, ..self }
    }

    fn points(&self, ticks: u64) -> Result<Points, PointsError> {
        let ticks = ticks as usize + 1;
        let reference = Reference::new(&self.reference, &self.start, self.period_s, ticks)?;
        Ok(Points { reference, period_s: self.period_s })
    }

    fn pull(&self) -> f64 {
        DIAGONAL * self.brake_mps2
    }

    /// B: twice the error of a twin, and the distance of one period, since an answer may come that
    /// late.
    fn fault_free(&self, answer: Answer, points: &Points, tick: u64) -> f64 {
        let twin = match answer {
            Answer::WithoutOptimiser => self.twin.without_optimiser_m,
            Answer::Fresh | Answer::Missing { .. } => self.twin.fresh_m,
        };
        let [x, y] = points.velocity(tick);
        TWINS * twin + x.hypot(y) * self.period_s
    }
}

/// The reference, tick by tick.
struct Points {
    reference: Reference,
    period_s: f64,
}

impl Points {
    fn at(&self, tick: u64) -> [f64; 2] {
        let [x, y, _] = self.reference.at(tick).pose;
        [x, y]
    }

    fn velocity(&self, tick: u64) -> [f64; 2] {
        let (here, next) = (self.at(tick), self.at(tick + 1));
        [0, 1].map(|axis| (next[axis] - here[axis]) / self.period_s)
    }

    /// Largest acceleration of the reference in these ticks \[m/s²\].
    fn largest_acceleration(&self, ticks: Range<u64>) -> f64 {
        let of = |tick| distance(self.velocity(tick + 1), self.velocity(tick)) / self.period_s;
        ticks.map(of).fold(0.0, f64::max)
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The answer that the wheels got in the period before a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    /// A fresh plan.
    Fresh,
    /// The controller's answer, without a plan.
    WithoutOptimiser,
    /// No answer in time, or the brake.
    Missing { brakes: bool },
}

impl Answer {
    fn of(state: &Message) -> Self {
        match state.word("fallback_level") {
            "fresh plan" => Self::Fresh,
            "shifted plan" | "simple controller" => Self::WithoutOptimiser,
            fallback_level => {
                Self::Missing { brakes: matches!(fallback_level, "brake" | "latched stop") }
            }
        }
    }
}

/// The truth of one tick.
#[derive(Debug, Clone, Copy)]
struct Look {
    tick: u64,
    /// e \[m\].
    error: f64,
    /// r \[m\].
    reference: [f64; 2],
    /// Speed of the robot \[m/s\].
    speed: f64,
    /// Commanded speed of its wheels \[m/s\].
    commanded: f64,
    /// Δv \[m/s\].
    apart: f64,
}

impl Look {
    fn of(truth: &Message, points: &Points, limits: &Limits) -> Option<Self> {
        let tick = truth.stamp("tick");
        let [x, y, yaw] = truth.numbers("pose").try_into().ok()?;
        let [forward, left, _]: [f64; 3] = truth.numbers("velocity").try_into().ok()?;
        let (sin, cos) = yaw.sin_cos();
        let velocity = [cos * forward - sin * left, sin * forward + cos * left];
        let [commanded_forward, commanded_left, _] = commanded(truth, limits)?;
        let reference = points.at(tick);
        Some(Self {
            tick,
            error: distance([x, y], reference),
            reference,
            speed: forward.hypot(left),
            commanded: commanded_forward.hypot(commanded_left),
            apart: distance(velocity, points.velocity(tick)),
        })
    }
}

/// Phase of the walk through the record.
#[derive(Debug, Clone, Copy)]
enum Phase {
    Driving,
    /// Since a look: with the speed of wheels and body then, and the distance that the robot may
    /// have moved since.
    Unanswered {
        from: Look,
        wheels: f64,
        body: f64,
        way: f64,
    },
    /// Since a tick: at most `most` away, for half of `within_s` \[m, s\].
    CatchingUp {
        since: u64,
        most: f64,
        within_s: f64,
    },
    /// Since a look, on a slippery floor.
    Sliding {
        from: Look,
    },
    /// Not judged.
    Misled,
}

/// The walk through one plant epoch of a record.
struct Walk<'a> {
    course: &'a Course,
    points: &'a Points,
    windows: Windows<'a>,
    phase: Phase,
}

impl Walk<'_> {
    /// The bound on e at `look`, if there is one. `before` is the previous look.
    fn bound(&mut self, before: Option<&Look>, look: &Look, answer: Answer) -> Option<f64> {
        let adjacent = before.filter(|before| before.tick + 1 == look.tick);
        let within =
            |windows: &[Range<u64>]| windows.iter().any(|ticks| ticks.contains(&look.tick));
        if let Answer::Missing { brakes } = answer {
            return Some(self.unanswered(adjacent.unwrap_or(look), look, brakes));
        }
        if within(self.windows.misled) {
            self.phase = Phase::Misled;
            return None;
        }
        let Some(before) = adjacent else {
            // The events while no recorder was running are unknown.
            self.phase = self.catch_up(look);
            return None;
        };
        if within(self.windows.slippery) {
            return Some(self.sliding(before, look));
        }
        if !matches!(self.phase, Phase::Driving | Phase::CatchingUp { .. }) {
            self.phase = self.catch_up(before);
        }
        let fault_free = self.course.fault_free(answer, self.points, look.tick);
        let Phase::CatchingUp { since, most, within_s } = self.phase else {
            return Some(fault_free);
        };
        let gone = (look.tick - since) as f64 * self.course.period_s / within_s;
        if gone >= 1.0 {
            self.phase = Phase::Driving;
        }
        Some(fault_free.max(most * (2.0 * (1.0 - gone)).clamp(0.0, 1.0)))
    }

    /// B + e₀ + |r − r₀| + D: the reference goes on, and the robot comes to rest.
    fn unanswered(&mut self, before: &Look, look: &Look, brakes: bool) -> f64 {
        let (from, wheels, body, way) = match self.phase {
            Phase::Unanswered { from, wheels, body, way } => (from, wheels, body, way),
            _ => (*before, before.commanded.max(before.speed), before.speed, 0.0),
        };
        let course = self.course;
        let wheels = if brakes {
            (wheels - course.brake_mps2 * course.period_s).max(0.0)
        } else {
            wheels.max(look.commanded)
        };
        let kept = (-course.period_s / course.lag_s).exp();
        let body = wheels.max(kept * body + (1.0 - kept) * wheels);
        let way = way + body * course.period_s;
        self.phase = Phase::Unanswered { from, wheels, body, way };
        let fault_free = course.fault_free(Answer::Missing { brakes }, self.points, look.tick);
        let apart = distance(look.reference, from.reference);
        fault_free + from.error + apart + way
    }

    /// e₀ + Δv₀ t + ½ A t²: the floor gives nothing of the acceleration that the reference needs.
    fn sliding(&mut self, before: &Look, look: &Look) -> f64 {
        let from = if let Phase::Sliding { from } = self.phase { from } else { *before };
        self.phase = Phase::Sliding { from };
        let time = (look.tick - from.tick) as f64 * self.course.period_s;
        let needed = self.points.largest_acceleration(from.tick..look.tick);
        let still = self.course.fault_free(Answer::Fresh, self.points, look.tick);
        still.max(from.error + from.apart * time + 0.5 * needed * time * time)
    }

    /// The bound while the robot returns to its reference; the error of a twin is added.
    ///
    /// From its position the robot needs Δv/a to move with the reference, and is then at most
    /// Δv²/2a further away. From there a distance P takes 2 √(P/a) at least.
    fn catch_up(&self, from: &Look) -> Phase {
        let pull = self.course.pull();
        // Two periods until an answer acts and the wheels have followed it.
        let most = self.course.fault_free(Answer::Fresh, self.points, from.tick)
            + from.error
            + from.apart * 2.0 * self.course.period_s
            + from.apart * from.apart / (2.0 * pull);
        let within_s = UNHURRIED * (from.apart / pull + 2.0 * (most / pull).sqrt());
        Phase::CatchingUp { since: from.tick, most, within_s: within_s.max(self.course.period_s) }
    }
}

/// Largest distance from the reference in a record \[m\].
///
/// # Errors
/// If there is no such reference.
pub fn largest_error(
    record: &Record,
    limits: &Limits,
    course: &Course,
) -> Result<f64, PointsError> {
    let points = course.points(last_tick(record))?;
    let errors = record.of("truth").filter_map(|truth| Look::of(truth, &points, limits));
    Ok(errors.map(|look| look.error).fold(0.0, f64::max))
}

fn last_tick(record: &Record) -> u64 {
    record.of("truth").map(|truth| truth.stamp("tick")).max().unwrap_or(0)
}

/// Judges a whole record. A violation is the first tick of each time in which the robot is too far
/// away.
///
/// # Errors
/// If there is no such reference.
pub fn judge(
    record: &Record,
    limits: &Limits,
    course: &Course,
    windows: Windows<'_>,
) -> Result<Tracked, PointsError> {
    let points = course.points(last_tick(record))?;
    let (states, none) = (by_epoch(record, "state"), BTreeMap::new());
    let mut tracked = Tracked::default();
    for (&epoch, truths) in &by_epoch(record, "truth") {
        let walk = Walk { course, points: &points, windows, phase: Phase::Driving };
        let states = states.get(&epoch).unwrap_or(&none);
        judge_epoch(epoch, (truths, states), walk, limits, &mut tracked);
    }
    Ok(tracked)
}

fn judge_epoch(
    epoch: u64,
    (truths, states): (&Ticks<'_>, &Ticks<'_>),
    mut walk: Walk<'_>,
    limits: &Limits,
    tracked: &mut Tracked,
) {
    let (mut before, mut astray) = (None, false);
    for (&tick, truth) in truths {
        let Some(look) = Look::of(truth, walk.points, limits) else { continue };
        let Some(answer) = states.get(&tick).map(|state| Answer::of(state)) else { continue };
        let bound = walk.bound(before.as_ref(), &look, answer);
        before = Some(look);
        let Some(bound) = bound else { continue };
        tracked.share = Some(tracked.share.unwrap_or(0.0).max(look.error / bound));
        if look.error > bound && !astray {
            let found = format!("{:.3} m from the reference", look.error);
            let expected = format!("{bound:.3} m at most");
            tracked.violations.push(Violation {
                rule: Rule::Tracking,
                epoch,
                tick,
                found,
                expected,
            });
        }
        astray = look.error > bound;
    }
}
