//! Promise: a robot among known obstacles and discs that cross its way reaches its goals and
//! touches nothing, also where discs close in on it from two sides. It stays in its area, and keeps
//! the speed limits of zones. On two hosts it has the same bits. A bad map starts nothing.

use promises::{Launched, Message, Outcome, Record, binaries, repository, text_of};
use robot::{Map, Obstacle, Robot, Shape, Surroundings};
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Excess of a speed limit that the lag of the robot explains [m/s].
const ZONE_SLACK_MPS: f64 = 0.05;

fn hall() -> Result<Surroundings, Box<dyn Error>> {
    let text = fs::read_to_string(repository().join("deploy/maps/hall.toml"))?;
    let map: Map = toml::from_str(&text)?;
    Ok(map.surroundings()?)
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().into_iter().flatten().filter_map(serde_json::Value::as_f64).collect()
}

/// The obstacles of a list.
fn listed(list: &Message) -> Result<Vec<Obstacle>, Box<dyn Error>> {
    let rows = list.fields["obstacles"].as_array().ok_or("no obstacles")?;
    let obstacles = rows.iter().map(|row| {
        let row = numbers(row);
        let (corners, _) = row[3..].as_chunks::<2>();
        Ok(Obstacle { shape: Shape::hull(corners, row[2])?, velocity_mps: [row[0], row[1]] })
    });
    obstacles.collect()
}

fn runs_of(graph: &str, recorder: &str) -> Result<Record, Box<dyn Error>> {
    let options = ["--scenario", "obstacles", "--pace", "lock-step", "--duration", "36"];
    let (ended, home) = Launched::graph(graph, &options)?.end()?;
    assert!(ended.status.success(), "{graph}: {}", ended.text);
    Ok(Record::read(&home.path().join("run").join(recorder))?)
}

fn commands(record: &Record) -> Vec<String> {
    record.of("command").map(|message| message.fields["input"].to_string()).collect()
}

/// Checks the true motion of the robot against everything around it.
fn judge(record: &Record) -> Result<(), Box<dyn Error>> {
    let map = hall()?;
    let footprint = Robot::example().footprint().shape();
    let fence = map.fence.ok_or("the hall has a border")?;
    let lists: Vec<(u64, Vec<Obstacle>)> = record
        .of("obstacles")
        .map(|list| Ok((list.stamp("tick"), listed(list)?)))
        .collect::<Result<_, Box<dyn Error>>>()?;
    let truths: Vec<&Message> = record.of("truth").collect();
    assert_eq!(lists.len(), truths.len(), "one list per period");
    for (truth, (tick, list)) in truths.iter().zip(&lists) {
        assert_eq!(truth.stamp("tick"), *tick);
        let pose: [f64; 3] = numbers(&truth.fields["pose"]).try_into().map_err(|_| "a pose")?;
        let robot = footprint.placed(&pose);
        for obstacle in map.obstacles.iter().chain(list) {
            let apart = robot.separation(&obstacle.shape).distance_m;
            assert!(apart > 0.0, "tick {tick}: {apart} m");
        }
        for corner in robot.corners() {
            let point = Shape::hull(&[*corner], 0.0)?;
            assert!(fence.separation(&point).distance_m <= 0.0, "tick {tick}: outside");
        }
        let velocity = numbers(&truth.fields["velocity"]);
        for (zone, limit) in &map.zones {
            let speed = velocity[0].hypot(velocity[1]);
            let is_inside = robot.separation(zone).distance_m <= 0.0;
            assert!(!is_inside || speed <= limit + ZONE_SLACK_MPS, "tick {tick}: {speed} m/s");
        }
    }
    Ok(())
}

#[test]
fn the_robot_reaches_its_goals_and_touches_nothing_on_one_host_and_on_two() -> Outcome {
    let alone = runs_of("local", "")?;
    judge(&alone)?;
    let reached = alone.of("goal").filter(|goal| goal.word("phase") == "reached");
    let mut reached: Vec<u64> = reached.map(|goal| goal.count("id")).collect();
    reached.dedup();
    assert_eq!(reached, [1_000_001, 1_000_002]);
    let two = runs_of("two-hosts", "robot")?;
    let (two, alone) = (commands(&two), commands(&alone));
    assert_eq!(two.len(), alone.len());
    for (tick, (two, alone)) in two.iter().zip(&alone).enumerate() {
        assert_eq!(two, alone, "tick {tick}");
    }
    Ok(())
}

#[test]
fn discs_that_close_in_on_a_robot_from_two_sides_do_not_touch_it() -> Outcome {
    let folder = tempfile::tempdir()?;
    let rows = folder.path().join("rows.jsonl");
    for seed in ["70", "150"] {
        let mut command = Command::new(binaries()?.join("coxswain"));
        command.current_dir(repository()).args(["experiment", "worlds", "--count", "1"]);
        command.args(["--first", seed, "--json"]).arg(&rows);
        text_of(&mut command)?;
        let row: serde_json::Value = serde_json::from_str(&fs::read_to_string(&rows)?)?;
        assert!(row["collision"].is_null(), "seed {seed}: {row}");
        assert!(row["least_m"].as_f64().is_some_and(|least| least > 0.0), "seed {seed}: {row}");
    }
    Ok(())
}

#[test]
fn an_impossible_map_is_refused_by_its_key_before_anything_starts() -> Outcome {
    let folder = tempfile::tempdir()?;
    let scenario = |map: &str| -> Result<String, Box<dyn Error>> {
        fs::write(folder.path().join("map.toml"), map)?;
        let text = fs::read_to_string(repository().join("deploy/scenarios/obstacles.toml"))?;
        let file = folder.path().join("scenario.toml");
        fs::write(&file, text.replace("../maps/hall.toml", "map.toml"))?;
        Ok(file.display().to_string())
    };
    for (map, key) in [
        ("[[obstacles]]\ncorners_m = [[1.0, nan]]\n", "obstacles"),
        ("[[obstacles]]\ncorners_m = []\n", "obstacles"),
        ("fence_m = [[0.0, 0.0], [1.0, 0.0]]\n", "fence_m"),
        ("[[zones]]\ncorners_m = [[0.0, 0.0]]\nspeed_mps = -1.0\n", "zones"),
        ("wall = 3\n", "wall"),
    ] {
        let (ended, home) = Launched::graph("local", &["--scenario", &scenario(map)?])?.end()?;
        assert_eq!(ended.status.code(), Some(2), "{map}: {}", ended.text);
        assert!(ended.text.contains(key) && ended.text.contains("map.toml"), "{}", ended.text);
        assert!(!Path::new(&home.path().join("run")).exists(), "{map}");
    }
    Ok(())
}
