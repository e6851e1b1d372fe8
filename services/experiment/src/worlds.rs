//! `coxswain experiment worlds`: to a goal among discs that stand or move, in seeded worlds.
//!
//! In each world the robot gets a goal at the start, and sees the discs within the range of its
//! sensor. A collision is an overlap of the true footprint with the true place of a disc. A world
//! has a way if A* finds one around the discs that stand.

use crate::in_process::{self, InProcessError};
use crate::{ExperimentError, Swept, parallel};
use controller::goal::Demand;
use controller::goal::schedule::Scheduled;
use graph::assembly::Assembly;
use graph::options::Options;
use graph::scenario::Scenario;
use model::wrap;
use motion::{Ground, route};
use plant_sim::obstacles::{Crowd, ImpossibleObstacle, Moving, ObstacleSettings};
use process::{Pace, Pulse, Stop};
use protocol::message::{Participant, Phase, PlantState, Truth};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use robot::{Obstacle, Point, Shape};
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;
use terminal::Terminal;
use transport::{OpenError, Ports, ReceiveError, Since, Source};

/// Time between two checks of the witness whether it must end.
const PATIENCE: Duration = Duration::from_millis(5);
/// Area of the discs, beyond the robot's start in x and to both sides in y \[m\].
const AREA_M: (f64, f64) = (7.0, 2.5);
/// Number of discs, and their radius \[m\].
const DISCS: (std::ops::RangeInclusive<usize>, std::ops::Range<f64>) = (3..=15, 0.15..0.45);
/// Speed of a disc that moves \[m/s\], and time after which it turns round \[s\].
const MOTION: (std::ops::Range<f64>, std::ops::Range<f64>) = (0.1..0.5, 2.0..8.0);
/// Room around start and goal without discs, beyond the circle around the robot \[m\].
const FREE_M: f64 = 0.3;
/// Range of the sensor \[m\].
const RANGE_M: f64 = 4.0;
/// Length of a run \[s\].
const DURATION_S: f64 = 40.0;
/// Distance from the goal within which the robot has reached it \[m\].
const REACHED_M: f64 = 0.05;
/// Speed towards a disc above which a collision is the robot's \[m/s\].
const OWN_MPS: f64 = 0.1;
/// Time for which the robot must have seen the disc for that \[s\].
const SEEN_S: f64 = 1.0;

/// Which worlds.
#[derive(Debug, Clone, clap::Args)]
pub struct WorldsOptions {
    /// Number of worlds: half of them have discs that stand, half have some that move.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 200,
        value_parser = clap::value_parser!(u64).range(1..=10_000)
    )]
    pub count: u64,
    /// Seed of the first world.
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    pub first: u64,
    /// Scenario of the robot, by its name beside that of the graph. Start and goal are those of
    /// each world.
    #[arg(long, value_name = "NAME", default_value = "goals")]
    pub scenario: String,
    /// Measure without noise.
    #[arg(long)]
    pub exact_sensors: bool,
    /// Change the scenario by a line of TOML; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub changes: Vec<String>,
    /// Write one JSON row per world to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Graph file whose robot is used.
    #[arg(long, value_name = "FILE", default_value = "deploy/graphs/local.toml")]
    pub graph: PathBuf,
}

/// What happened in one world.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorldRow {
    /// Seed of the world.
    pub seed: u64,
    /// Whether some discs move.
    pub moving: bool,
    /// Number of discs.
    pub discs: usize,
    /// Whether A* finds a way around those that stand.
    pub has_way: bool,
    /// Whether the robot stands at the goal at the end.
    pub reached: bool,
    /// Time after which it stayed there \[s\].
    pub reached_s: Option<f64>,
    /// True distance from the goal at the end \[m\].
    pub end_m: f64,
    /// True heading at the end, relative to the goal's \[rad\].
    pub end_rad: f64,
    /// Smallest distance of the true footprint from a disc \[m\].
    pub least_m: f64,
    /// The first collision, if there is one.
    pub collision: Option<Collision>,
    /// Share of the periods in which the gate slowed the robot.
    pub slowed_share: f64,
}

/// The first overlap of the robot with a disc.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Collision {
    /// Time since the start \[s\].
    pub at_s: f64,
    /// Speed of the robot towards the disc \[m/s\].
    pub towards_mps: f64,
    /// Time for which the disc had been in the range of the sensor \[s\].
    pub seen_s: f64,
}

impl Collision {
    /// Whether the robot ran into a disc that it could see.
    fn is_own(&self) -> bool {
        self.towards_mps > OWN_MPS && self.seen_s >= SEEN_S
    }
}

/// Why a world failed.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The loop failed.
    #[error(transparent)]
    Loop(#[from] InProcessError),
    /// The witness could not subscribe.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The witness could not receive.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// Its discs are impossible.
    #[error(transparent)]
    Obstacle(#[from] ImpossibleObstacle),
}

/// Drives in every world, and prints what happened.
///
/// # Errors
/// [`ExperimentError`]; no world runs if a setting is impossible.
pub fn worlds(options: &WorldsOptions) -> Result<(), ExperimentError> {
    let base = base(options)?;
    let mut json = options.json.as_deref().map(crate::create).transpose()?;
    let home = std::env::temp_dir().join(format!("coxswain-worlds-{}", std::process::id()));
    let swept = Swept(home.clone());
    let seeds: Vec<u64> = (0..options.count).map(|one| options.first.wrapping_add(one)).collect();
    let mut terminal = Terminal::new();
    let rows = parallel::run_all(
        &seeds,
        &mut terminal,
        "worlds",
        |index, &seed| {
            let folder = home.join(index.to_string());
            fs::create_dir_all(&folder)
                .map_err(|source| ExperimentError::File { path: folder.clone(), source })?;
            let row = drive(&base, seed, &folder);
            row.map_err(|source| ExperimentError::World { seed, source: Box::new(source) })
        },
        |row| match &mut json {
            Some((path, file)) => {
                let line = serde_json::to_string(row).map_err(io::Error::other);
                line.and_then(|line| writeln!(file, "{line}"))
                    .map_err(|source| ExperimentError::File { path: path.clone(), source })
            }
            None => Ok(()),
        },
    )?;
    drop(swept);
    terminal::print(rendered(&rows));
    Ok(())
}

/// The graph with its scenario, in lock step.
fn base(options: &WorldsOptions) -> Result<Assembly, ExperimentError> {
    let mut base = Assembly::read(&Options::of_graph(&options.graph))?;
    let own = options.graph.parent().unwrap_or(Path::new("")).join(&base.graph.scenario);
    let folder = own.parent().unwrap_or(Path::new(""));
    let noise = folder.join("variants/noise.toml").exists() && !options.exact_sensors;
    let name = format!("{}{}", options.scenario, if noise { "+noise" } else { "" });
    base.scenario = Scenario::named(folder, &name, None, &options.changes)?;
    base.graph.pace = Pace::LockStep;
    base.graph.processes.recorder.enabled = false;
    base.scenario.duration_s = DURATION_S;
    Ok(base)
}

/// The world of `seed`: its discs, and the goal.
fn world(seed: u64, circle_m: f64) -> (Vec<Moving>, [f64; 3]) {
    let mut generator = Pcg64Mcg::seed_from_u64(seed);
    let moves = seed.is_multiple_of(2);
    let (length, side) = AREA_M;
    let goal = [
        generator.random_range(0.75 * length..length),
        generator.random_range(-side..side),
        generator.random_range(-PI..PI),
    ];
    let count = generator.random_range(DISCS.0);
    let mut discs = Vec::with_capacity(count);
    while discs.len() < count {
        let radius_m = generator.random_range(DISCS.1);
        let centre = [
            generator.random_range(-0.5..length + 0.5),
            generator.random_range(-side - 0.5..side + 0.5),
        ];
        let (speed, direction) =
            (generator.random_range(MOTION.0), generator.random_range(0.0..TAU));
        let turns_after_s = generator.random_range(MOTION.1);
        let is_moving = moves && generator.random_bool(0.5);
        let room = |end: Point| {
            (centre[0] - end[0]).hypot(centre[1] - end[1]) - radius_m - circle_m - FREE_M
        };
        if room([0.0; 2]) < 0.0 || room([goal[0], goal[1]]) < 0.0 {
            continue;
        }
        let velocity = [speed * direction.cos(), speed * direction.sin()];
        discs.push(Moving {
            corners_m: vec![centre],
            radius_m,
            velocity_mps: if is_moving { velocity } else { [0.0; 2] },
            turns_after_s: is_moving.then_some(turns_after_s),
        });
    }
    (discs, goal)
}

fn drive(base: &Assembly, seed: u64, folder: &Path) -> Result<WorldRow, WorldError> {
    let footprint = base.robot.footprint();
    let circle_m = 0.5 * footprint.length_m.hypot(footprint.width_m);
    let (discs, goal) = world(seed, circle_m);
    let crowd =
        ObstacleSettings { range_m: RANGE_M, list: discs.clone(), ..ObstacleSettings::default() }
            .crowd()?;
    let stands: Vec<Obstacle> = crowd.at(0.0).filter(|one| one.velocity_mps == [0.0; 2]).collect();
    let ground = Ground {
        obstacles: &stands,
        fence: None,
        outer_m: circle_m + footprint.clearance_m,
        inner_m: 0.5 * footprint.length_m.min(footprint.width_m),
    };
    let has_way = route([0.0; 2], [goal[0], goal[1]], &ground).is_ok();
    let mut assembly = base.clone();
    assembly.scenario.seed = seed;
    assembly.scenario.obstacles = Some(ObstacleSettings {
        range_m: RANGE_M,
        list: discs.clone(),
        ..ObstacleSettings::default()
    });
    assembly.scenario.goals = vec![Scheduled {
        at_s: 0.1,
        goal: Demand::Pose { to: goal },
        limits: motion::limits::Stated::default(),
    }];
    let period_s = base.scenario.period_millis * 1e-3;
    let mut judge = Judge {
        crowd,
        shape: footprint.shape(),
        period_s,
        least_m: f64::INFINITY,
        collision: None,
        seen_since: vec![None; discs.len()],
        away_at: 0.0,
        goal,
        last: None,
        states: 0,
        slowed: 0,
    };
    in_process::drive(&assembly, folder, |ports, _, stop| witness(ports, stop, &mut judge))??;
    let at_end = judge.last.is_some_and(|truth| judge.is_at_goal(&truth));
    Ok(WorldRow {
        seed,
        moving: stands.len() < discs.len(),
        discs: discs.len(),
        has_way,
        reached: at_end,
        reached_s: at_end.then_some(judge.away_at),
        end_m: judge.last.map_or(f64::INFINITY, |truth| judge.distance_m(&truth)),
        end_rad: judge.last.map_or(PI, |truth| wrap(truth.pose[2] - goal[2])),
        least_m: judge.least_m,
        collision: judge.collision,
        slowed_share: judge.slowed as f64 / judge.states.max(1) as f64,
    })
}

/// Compares the true robot with the true discs.
struct Judge {
    crowd: Crowd,
    /// Footprint in the body.
    shape: Shape,
    period_s: f64,
    least_m: f64,
    collision: Option<Collision>,
    /// Time since which each disc is in range \[s\].
    seen_since: Vec<Option<f64>>,
    /// Last time at which the robot was not at the goal \[s\].
    away_at: f64,
    goal: [f64; 3],
    last: Option<Truth>,
    states: u64,
    slowed: u64,
}

impl Judge {
    fn distance_m(&self, truth: &Truth) -> f64 {
        (truth.pose[0] - self.goal[0]).hypot(truth.pose[1] - self.goal[1])
    }

    fn is_at_goal(&self, truth: &Truth) -> bool {
        self.distance_m(truth) <= REACHED_M
    }

    fn look(&mut self, truth: &Truth) {
        let now = truth.stamp.tick as f64 * self.period_s;
        if !self.is_at_goal(truth) {
            self.away_at = now;
        }
        self.last = Some(*truth);
        let robot = self.shape.placed(&truth.pose);
        let centre = Shape::rectangle(0.0, 0.0).placed(&truth.pose);
        for (disc, since) in self.crowd.at(now).zip(&mut self.seen_since) {
            let in_range = centre.separation(&disc.shape).distance_m <= RANGE_M;
            *since = if in_range { since.or(Some(now)) } else { None };
            let apart = robot.separation(&disc.shape);
            self.least_m = self.least_m.min(apart.distance_m);
            if apart.distance_m < 0.0 && self.collision.is_none() {
                self.collision = Some(Collision {
                    at_s: now,
                    towards_mps: towards(truth, &apart),
                    seen_s: since.map_or(0.0, |since| now - since),
                });
            }
        }
    }
}

/// Speed of the robot's nearest point towards a disc \[m/s\].
fn towards(truth: &Truth, apart: &robot::Separation) -> f64 {
    let (sin, cos) = truth.pose[2].sin_cos();
    let [forward, left, rate] = truth.velocity;
    let arm = [apart.nearest_m[0] - truth.pose[0], apart.nearest_m[1] - truth.pose[1]];
    let x = cos * forward - sin * left - rate * arm[1];
    let y = sin * forward + cos * left + rate * arm[0];
    x * apart.normal[0] + y * apart.normal[1]
}

/// Subscribes in place of the recorder.
fn witness(ports: &Ports, stop: &Stop, judge: &mut Judge) -> Result<(), WorldError> {
    let mut pulse = Pulse::new(ports, Participant::Recorder)?;
    let mut states: Source<PlantState> = ports.source(Since::First)?;
    let mut truths: Source<Truth> = ports.source(Since::First)?;
    pulse.phase(Phase::Ready);
    loop {
        let ending = stop.requested();
        while let Some(state) = states.next()? {
            judge.states += 1;
            judge.slowed += u64::from(state.reason().is_slowed());
        }
        while let Some(truth) = truths.next()? {
            judge.look(&truth);
        }
        if ending {
            return Ok(());
        }
        truths.wait(PATIENCE)?;
    }
}

/// The figures of worlds whose discs stand, and of those with discs that move.
fn rendered(rows: &[WorldRow]) -> String {
    let mut text = String::from(
        "worlds        with a way   reached      collisions   of them own   least       time     \
         slowed\n",
    );
    for (name, moving) in [("all stand", false), ("some move", true)] {
        let rows: Vec<&WorldRow> = rows.iter().filter(|row| row.moving == moving).collect();
        let way = rows.iter().filter(|row| row.has_way).count();
        let reached = rows.iter().filter(|row| row.has_way && row.reached).count();
        let collisions: Vec<Collision> = rows.iter().filter_map(|row| row.collision).collect();
        let own = collisions.iter().filter(|collision| collision.is_own()).count();
        let least = rows.iter().map(|row| row.least_m).fold(f64::INFINITY, f64::min);
        let times: Vec<f64> = rows.iter().filter_map(|row| row.reached_s).collect();
        let mean = times.iter().sum::<f64>() / times.len().max(1) as f64;
        let slowed =
            rows.iter().map(|row| row.slowed_share).sum::<f64>() / rows.len().max(1) as f64;
        let share = 100.0 * reached as f64 / way.max(1) as f64;
        let _ = writeln!(
            text,
            "{:>3} {name}  {way:>10}   {reached:>3} ({share:>5.1} %) {:>10}   {own:>11}   \
             {least:>7.3} m {mean:>6.1} s {:>6.1} %",
            rows.len(),
            collisions.len(),
            100.0 * slowed,
        );
    }
    let reached = || rows.iter().filter(|row| row.reached);
    let _ = writeln!(
        text,
        "where the goal is reached, the robot ends at most {:.1} mm and {:.2}° from it",
        1e3 * reached().map(|row| row.end_m).fold(0.0, f64::max),
        reached().map(|row| row.end_rad.abs()).fold(0.0, f64::max).to_degrees(),
    );
    for row in rows.iter().filter(|row| row.collision.is_some() || (row.has_way && !row.reached)) {
        let what = row.collision.map_or("not reached".to_owned(), |collision| {
            format!(
                "collision at {:.2} s, {:.2} m/s towards the disc, seen for {:.1} s",
                collision.at_s, collision.towards_mps, collision.seen_s
            )
        });
        let _ = writeln!(text, "seed {}: {what}", row.seed);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_gives_the_same_world_every_time_and_leaves_start_and_goal_free() {
        for seed in 1..50 {
            let (discs, goal) = world(seed, 0.3);
            assert_eq!(world(seed, 0.3), (discs.clone(), goal));
            assert!(DISCS.0.contains(&discs.len()));
            for disc in &discs {
                for end in [[0.0; 2], [goal[0], goal[1]]] {
                    let [x, y] = disc.corners_m[0];
                    assert!((x - end[0]).hypot(y - end[1]) >= disc.radius_m + 0.6);
                }
            }
            let moves = discs.iter().any(|disc| disc.turns_after_s.is_some());
            assert!(seed.is_multiple_of(2) || !moves, "odd seeds have discs that stand");
        }
    }
}
