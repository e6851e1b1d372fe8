//! Promise: robot files, maps and lists of planners mean what `protocol/vectors/surroundings.json`
//! says, as in the driver in Python.

use driver::PlannerList;
use protocol::message::OBSTACLE_NUMBERS;
use robot::{Map, Robot};
use serde::Deserialize;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

/// Largest difference of two numbers that are the same.
const SAME: f64 = 1e-9;

#[derive(Deserialize)]
struct File {
    version: u16,
    robots: Vec<RobotCase>,
    maps: Vec<MapCase>,
    lists: Vec<ListCase>,
}

#[derive(Deserialize)]
struct RobotCase {
    file: String,
    /// Length, width and clearance \[m\].
    footprint: [f64; 3],
    response_s: f64,
}

#[derive(Deserialize)]
struct MapCase {
    name: String,
    map: serde_json::Value,
    /// The first key that is wrong; empty if a key is unknown or missing.
    refused: Option<String>,
}

#[derive(Deserialize)]
struct ListCase {
    name: String,
    line: String,
    accepted: Option<Accepted>,
}

#[derive(Debug, PartialEq, Deserialize)]
struct Accepted {
    age_s: f64,
    valid_s: f64,
    rows: Vec<[f64; OBSTACLE_NUMBERS]>,
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn file() -> Result<File, Box<dyn Error>> {
    let text = fs::read_to_string(repository().join("protocol/vectors/surroundings.json"))?;
    let file: File = serde_json::from_str(&text)?;
    assert_eq!(file.version, protocol::VERSION);
    Ok(file)
}

#[test]
fn robot_files_have_the_footprint_and_the_response_of_the_vectors() -> Result<(), Box<dyn Error>> {
    for RobotCase { file, footprint, response_s } in file()?.robots {
        let robot: Robot = toml::from_str(&fs::read_to_string(repository().join(&file))?)?;
        let found = robot.footprint();
        let found = [found.length_m, found.width_m, found.clearance_m, robot.response_time_s()];
        let expected = [footprint[0], footprint[1], footprint[2], response_s];
        let is_same = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < SAME);
        assert!(is_same, "{file}: {found:?}, not {expected:?}");
    }
    Ok(())
}

#[test]
fn maps_are_accepted_and_refused_as_in_the_vectors() -> Result<(), Box<dyn Error>> {
    for MapCase { name, map, refused } in file()?.maps {
        let found = match serde_json::from_value::<Map>(map) {
            Ok(map) => map.surroundings().err().map(|error| error.key),
            Err(_) => Some(String::new()),
        };
        assert_eq!(found, refused, "{name}");
    }
    Ok(())
}

#[test]
fn lists_of_planners_are_accepted_and_rejected_as_in_the_vectors() -> Result<(), Box<dyn Error>> {
    for ListCase { name, line, accepted } in file()?.lists {
        let list = serde_json::from_slice::<PlannerList>(line.as_bytes());
        let found = list.ok().and_then(|list| list.message().ok()).map(|message| Accepted {
            age_s: message.age_s,
            valid_s: message.valid_s,
            rows: message.rows().to_vec(),
        });
        assert_eq!(found, accepted, "{name}");
    }
    Ok(())
}
