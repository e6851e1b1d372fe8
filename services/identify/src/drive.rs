//! Drives the robot of a graph through the excitation, as a launch of its own.
//!
//! The motion is a reference of points, which feedforward and proportional feedback follow: no
//! model decides the input, and the feedback keeps the robot in the rectangle. If it is farther
//! from the motion than the rectangle has room, the gate stops it. The rectangle is also the border
//! of the area that the gate does not let the robot leave, unless the scenario's map has a border.

use crate::command::IdentifyOptions;
use crate::excitation::{self, Room};
use graph::assembly::{map_of, robot_of};
use graph::file::Graph;
use graph::options::Options;
use graph::scenario::Scenario;
use process::atomic_file;
use robot::{Map, Robot, TrackingLimit};
use settings::SettingsError;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::{fs, io};
use toml::{Table, Value};

/// Acceleration of the motion, per acceleration that the robot file allows: the feedback needs the
/// rest.
const STEEP: f64 = 0.8;

/// Largest planar speed if none is given \[m/s\].
pub const SPEED_MPS: f64 = 0.5;
/// Smallest: a slower robot hardly moves \[m/s\].
const SPEED_LEAST_MPS: f64 = 0.1;
/// Largest planar speed per acceleration that the robot file allows \[s\]. A robot with a long dead
/// time is up to this time behind a step, and the feedback asks for twice the distance as a change
/// of the input. It would swing if the limit of that change were reached.
const SPEED_PER_ACCELERATION_S: f64 = 0.25;

/// Why nothing was driven.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// A file cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The rectangle is too small for the robot.
    #[error("--area: expected at least {:.2}x{:.2}, room to turn and to move", least[0], least[1])]
    Area {
        /// The least length and width \[m\].
        least: [f64; 2],
    },
    /// A file cannot be written.
    #[error("{} cannot be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The scenario cannot be changed.
    #[error("{}: {what}", path.display())]
    Scenario {
        /// The scenario.
        path: PathBuf,
        /// The cause.
        what: String,
    },
}

/// A drive that can be launched.
#[derive(Debug, Clone)]
pub struct Drive {
    /// The launch.
    pub options: Options,
    /// The robot as its file states it.
    pub robot: Robot,
    /// That file.
    given: PathBuf,
    /// Hosts of the graph that run its processes.
    hosts: Vec<String>,
}

impl Drive {
    /// The commands that launch the drive on each host, and the one that identifies its record.
    pub(crate) fn instructions(&self) -> String {
        let Self { options, hosts, given, .. } = self;
        let path = |path: &Option<PathBuf>| {
            path.as_ref().map(|path| path.display().to_string()).unwrap_or_default()
        };
        let (graph, scenario) = (options.graph.display(), path(&options.scenario));
        let (robot, out) = (path(&options.robot), path(&options.out));
        let mut text = String::new();
        // A graph without hosts is one launch.
        let all = hosts.iter().map(|host| format!(" --host {host}"));
        let launches = if hosts.is_empty() { vec![String::new()] } else { all.collect() };
        for host in launches {
            let _ = writeln!(
                text,
                "coxswain launch {graph}{host} --scenario {scenario} --robot {robot} --learner off \
                 --out {out}"
            );
        }
        let _ = write!(
            text,
            "coxswain identify {out} --robot {} --out {out}-identified",
            given.display()
        );
        text
    }
}

/// Writes the files of a drive into `folder`: the motion, a scenario with it, and the robot with
/// its limits of the tracking error.
///
/// # Errors
/// [`DriveError`].
pub fn prepare(
    graph_file: &Path,
    wanted: &IdentifyOptions,
    folder: &Path,
) -> Result<Drive, DriveError> {
    let IdentifyOptions { changes, seed, duration: duration_s, .. } = wanted;
    let (seed, duration_s) = (*seed, *duration_s);
    let graph: Graph = settings::read(graph_file)?;
    let refused = |key: &str, expected: &str| SettingsError::Value {
        file: graph_file.to_owned(),
        line: None,
        key: key.to_owned(),
        value: None,
        expected: expected.to_owned(),
    };
    if !graph.hosts.is_empty() && !wanted.prepare {
        let expected = "a graph without hosts, or --prepare, which writes the files of a drive";
        return Err(refused("hosts", expected).into());
    }
    if !graph.processes.recorder.enabled {
        return Err(refused("processes.recorder", "a recorder: the record is identified").into());
    }
    let beside = graph_file.parent().unwrap_or(Path::new(""));
    let own = beside.join(&graph.scenario);
    let name = own.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let scenario_folder = own.parent().unwrap_or(Path::new("")).to_path_buf();
    let scenario = Scenario::named(&scenario_folder, &name, None, changes)?;
    let given = wanted.robot.clone().unwrap_or_else(|| beside.join(&graph.robot));
    let robot = robot_of(&given)?;
    let limits = &robot.limits;
    let planar = STEEP * limits.input_rate_mps2;
    let extent = robot.wheels.half_extent_m();
    let least = extent.map(|extent| least_side(&robot, extent));
    if wanted.area.iter().zip(&least).any(|(side, least)| side < least) {
        return Err(DriveError::Area { least });
    }
    let slow_enough =
        (SPEED_PER_ACCELERATION_S * limits.input_rate_mps2).clamp(SPEED_LEAST_MPS, SPEED_MPS);
    let room = Room {
        size_m: [0, 1].map(|side| room(&robot, extent[side], wanted.area[side])),
        speed_mps: wanted.speed.unwrap_or(slow_enough).min(limits.input_mps),
        yaw_rate_radps: wanted.yaw_rate.min(limits.yaw_input_radps),
        acceleration: [planar, planar, STEEP * limits.yaw_input_rate_radps2],
    };
    let text = Scenario::merged(&scenario_folder, &name, None, changes)?;
    let invalid = |what: String| DriveError::Scenario { path: own.clone(), what };
    let mut table: Table =
        text.parse().map_err(|error: toml::de::Error| invalid(error.message().to_owned()))?;
    let mut held = robot;
    let margin = 0.5 * excitation::UNUSED * room.size_m[0].min(room.size_m[1]);
    held.limits.tracking_error_m = TrackingLimit::At(margin);
    let held = toml::to_string(&held).map_err(|error| invalid(error.to_string()))?;
    let points = points(&room, duration_s, &scenario, seed);
    let mut map = scenario.map.as_deref().map(map_of).transpose()?.unwrap_or_default();
    if map.fence_m.is_empty() {
        map.fence_m = corners(&wanted.area, &scenario);
    }
    let map = toml::to_string::<Map>(&map).map_err(|error| invalid(error.to_string()))?;
    // Nothing can be refused from here on.
    let write = |file: &str, text: &str| {
        let path = folder.join(file);
        let written =
            fs::create_dir_all(folder).and_then(|()| atomic_file::write(&path, text.as_bytes()));
        written.map_err(|source| DriveError::Write { path: path.clone(), source })?;
        Ok::<_, DriveError>(path)
    };
    let points = write("motion.csv", &points)?;
    let map = write("map.toml", &map)?;
    excite(&mut table, &points, &map, duration_s, &scenario_folder);
    let scenario = write("drive.toml", &table.to_string())?;
    let held = write("driven-robot.toml", &held)?;
    let options = Options {
        scenario: Some(scenario),
        robot: Some(held),
        learner: Some(false),
        pace: wanted.pace,
        out: Some(folder.join("run")),
        seed: Some(seed),
        ..Options::of_graph(graph_file)
    };
    let with_processes = graph.hosts.iter().filter(|(_, host)| !host.processes.is_empty());
    let hosts = with_processes.map(|(name, _)| name.clone()).collect();
    Ok(Drive { options, robot, given, hosts })
}

/// Distance from the centre that the robot needs at any heading \[m\].
fn reach(robot: &Robot) -> f64 {
    let footprint = robot.footprint();
    let (_, radius_m) = footprint.shape().circle();
    radius_m + footprint.clearance_m
}

/// Room for the motion along a side of the rectangle, of this length. `extent` is the largest
/// distance of a wheel from the centre along it \[m\].
fn room(robot: &Robot, extent: f64, side: f64) -> f64 {
    (side - 2.0 * extent).min((side - 2.0 * reach(robot)) / (1.0 - excitation::UNUSED))
}

/// Least length of a side: there is as much room as between the wheels \[m\].
fn least_side(robot: &Robot, extent: f64) -> f64 {
    let room = 2.0 * extent;
    (room + 2.0 * extent).max((1.0 - excitation::UNUSED) * room + 2.0 * reach(robot))
}

/// Corners of the rectangle around the start of the scenario \[m\].
fn corners(area: &[f64; 2], scenario: &Scenario) -> Vec<robot::Point> {
    let [x, y, yaw] = scenario.start.pose;
    let (sin, cos) = yaw.sin_cos();
    [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]
        .map(|[ahead, side]| [0.5 * ahead * area[0], 0.5 * side * area[1]])
        .map(|[ahead, side]| [x + cos * ahead - sin * side, y + sin * ahead + cos * side])
        .to_vec()
}

/// The motion as a file of points, from the start pose of the scenario.
fn points(room: &Room, duration_s: f64, scenario: &Scenario, seed: u64) -> String {
    let [x, y, yaw] = scenario.start.pose;
    let (sin, cos) = yaw.sin_cos();
    let mut text = "time_s,x_m,y_m,yaw_rad\n".to_owned();
    let motion = excitation::motion(room, duration_s, scenario.period_millis * 1e-3, seed);
    for point in motion {
        let [ahead, side, turn] = point.pose;
        let [x, y] = [x + cos * ahead - sin * side, y + sin * ahead + cos * side];
        let _ = writeln!(text, "{:.4},{x:.6},{y:.6},{:.6}", point.time_s, yaw + turn);
    }
    text
}

/// Replaces reference, map, method and duration of a scenario.
fn excite(scenario: &mut Table, points: &Path, map: &Path, duration_s: f64, folder: &Path) {
    let points = Value::String(points.display().to_string());
    let file = Table::from_iter([("file".to_owned(), points)]);
    let path = Table::from_iter([("points".to_owned(), Value::Table(file))]);
    let reference = Table::from_iter([
        ("path".to_owned(), Value::Table(path)),
        ("heading".to_owned(), Value::String("given".to_owned())),
    ]);
    let description = "Steps and sines of velocity, to identify the robot.".to_owned();
    scenario.insert("description".to_owned(), Value::String(description));
    scenario.insert("reference".to_owned(), Value::Table(reference));
    scenario.insert("map".to_owned(), Value::String(map.display().to_string()));
    scenario.insert("duration_s".to_owned(), Value::Float(duration_s));
    scenario.remove("identified");
    if let Some(Value::Table(mpc)) = scenario.get_mut("mpc") {
        mpc.insert("method".to_owned(), Value::String("feedforward-p".to_owned()));
        mpc.remove("state_limits");
    }
    // The program of a world is named relative to its scenario, and this one is elsewhere.
    if let Some(Value::Table(world)) = scenario.get_mut("world")
        && let Some(Value::String(program)) = world.get_mut("program")
    {
        let path = folder.join(&*program);
        *program = std::path::absolute(&path).unwrap_or(path).display().to_string();
    }
}
