//! Promises: a bag of ROS 2 gives the samples that its messages describe, in every container. One
//! that cannot be used becomes an error that names its place. All bags are written by the public
//! Python package `rosbags`.

use identify::log::bag::{BagError, MessageError, Topics};
use identify::log::{Log, LogError, Sample};
use promises::{Outcome, python, repository, text_of};
use serde_json::{Value, json};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

const ODOMETRY: &str = "nav_msgs/msg/Odometry";
pub(crate) const TWIST: &str = "geometry_msgs/msg/Twist";
pub(crate) const STAMPED: &str = "geometry_msgs/msg/TwistStamped";
const JOINTS: &str = "sensor_msgs/msg/JointState";

/// Time at which the bags begin \[ns\]: in 2026.
const START: i64 = 1_790_000_000_000_000_000;
pub(crate) const MS: i64 = 1_000_000;

pub(crate) fn home() -> std::io::Result<TempDir> {
    tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")
}

/// A bag that is to be written.
#[derive(Clone)]
pub(crate) struct Bag {
    pub(crate) storage: &'static str,
    pub(crate) compression: &'static str,
    pub(crate) encoding: &'static str,
    pub(crate) is_big_endian: bool,
    pub(crate) messages: Vec<Value>,
}

impl Bag {
    pub(crate) fn new(messages: &[Value]) -> Self {
        Self {
            storage: "mcap",
            compression: "none",
            encoding: "cdr",
            is_big_endian: false,
            messages: messages.to_vec(),
        }
    }
}

/// Writes `bags` into folders of `home`.
pub(crate) fn write(home: &Path, bags: &[Bag]) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let paths: Vec<PathBuf> =
        (0..bags.len()).map(|number| home.join(format!("bag{number}"))).collect();
    let listed: Vec<Value> = bags
        .iter()
        .zip(&paths)
        .map(|(bag, path)| {
            json!({
                "path": path, "storage": bag.storage, "compression": bag.compression,
                "encoding": bag.encoding, "is_big_endian": bag.is_big_endian,
                "messages": bag.messages,
            })
        })
        .collect();
    let list = home.join("bags.json");
    fs::write(&list, serde_json::to_vec(&listed)?)?;
    text_of(Command::new(python()?).arg(repository().join("tests/python/bags.py")).arg(&list))?;
    Ok(paths)
}

/// The one file of a bag.
fn file(bag: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let mut files = fs::read_dir(bag)?.flatten().map(|entry| entry.path());
    Ok(files.find(|path| !path.ends_with("metadata.yaml")).ok_or("no file")?)
}

/// A message that was recorded `late` after its time \[ns\].
pub(crate) fn message(nanos: i64, late: i64, topic: &str, kind: &str, numbers: &[f64]) -> Value {
    let nanos = START + nanos;
    json!([nanos + late, nanos, topic, kind, numbers, []])
}

pub(crate) fn odometry(nanos: i64, pose: [f64; 3], velocity: [f64; 3]) -> Value {
    let ([x, y, yaw], [u, v, w]) = (pose, velocity);
    let (sin, cos) = (0.5 * yaw).sin_cos();
    message(nanos, 2 * MS, "/odom", ODOMETRY, &[x, y, 0.0, 0.0, sin, cos, u, v, w])
}

/// Four seconds: odometry at about 20 Hz, commands at 15 Hz, joints at 40 Hz.
fn short() -> Vec<Value> {
    let mut messages = Vec::new();
    for step in -1..160_i64 {
        let time = 25 * MS * step;
        let seconds = time as f64 * 1e-9;
        let mut joints =
            message(time + MS, 0, "/joints", JOINTS, &[4.0 * seconds, 1.0, 2.0, 3.0, 9.0]);
        joints[5] = json!(["left", "right", "rear", "front", "arm"]);
        messages.push(joints);
        if step % 2 == 0 {
            let time = time + MS * [0, 2, 2, 0, 0][step as usize / 2 % 5];
            messages.push(odometry(time, [seconds, 0.0, 3.0 * seconds], [1.0, -0.5, 3.0]));
        }
    }
    for step in -1..60_i64 {
        let numbers = [1.0 + 0.01 * step as f64, -0.5, 3.0];
        messages.push(message(67 * MS * step, 0, "/cmd_vel", TWIST, &numbers));
    }
    messages.push(json!([START, 0, "/chatter", "std_msgs/msg/String", [], ["hello"]]));
    messages.sort_by_key(|message| message[0].as_i64());
    messages
}

fn with_wheels() -> Topics {
    let wheel_joints = ["front", "left", "rear", "right"].map(str::to_owned).to_vec();
    Topics { wheel_joints, ..Topics::default() }
}

/// The error of a bag with these `messages`.
fn refused(messages: &[Value], topics: &Topics) -> Result<LogError, Box<dyn Error>> {
    let home = home()?;
    let paths = write(home.path(), &[Bag::new(messages)])?;
    Log::read(&paths, topics).err().ok_or_else(|| "read".into())
}

#[test]
fn every_container_and_byte_order_gives_the_same_log_bit_by_bit() -> Outcome {
    let home = home()?;
    let mcap = Bag::new(&short());
    let sqlite = Bag { storage: "sqlite3", ..mcap.clone() };
    let zstd = Bag { compression: "storage", ..mcap.clone() };
    let big = Bag { is_big_endian: true, ..sqlite.clone() };
    let mut backwards = sqlite.clone();
    backwards.messages.reverse();
    let bags = write(home.path(), &[mcap, sqlite, zstd, big, backwards])?;
    let first = Log::read(&bags[..1], &with_wheels())?;
    assert_eq!(first.period_s, 50e6 * 1e-9);
    assert_eq!(first.stretches.len(), 1);
    assert!(first.len() >= 75, "{}", first.len());
    assert_eq!(first.notes, Vec::<String>::new());
    for bag in &bags {
        for path in [bag.clone(), file(bag)?] {
            let log = Log::read(&[path], &with_wheels())?;
            assert_eq!(log.stretches, first.stretches, "{}", bag.display());
            assert_eq!(log.period_s, first.period_s);
        }
    }
    // A folder without metadata is a bag as well.
    fs::remove_file(bags[1].join("metadata.yaml"))?;
    assert_eq!(Log::read(&bags[1..2], &with_wheels())?.stretches, first.stretches);
    Ok(())
}

#[test]
fn samples_are_at_their_times_and_wheels_in_the_order_of_the_robot_file() -> Outcome {
    let home = home()?;
    let bags = write(home.path(), &[Bag::new(&short())])?;
    let log = Log::read(&bags, &with_wheels())?;
    for Sample { time_s, pose, velocity, input, wheel_speed } in log.stretches.iter().flatten() {
        // The odometry moves with 1 m/s, and its times deviate by up to 2 ms.
        assert!((pose[0] - time_s).abs() < 2.1e-3, "{time_s} {pose:?}");
        assert!((pose[2] - 3.0 * pose[0]).abs() < 1e-9, "a continuous heading: {pose:?}");
        assert_eq!(*velocity, [1.0, -0.5, 3.0]);
        // The mean of a rising command is that of the middle of its period, half a command late.
        let expected = 1.0 + 0.01 * (time_s - 0.025 - 0.0335) / 0.067;
        assert!((input[0] - expected).abs() < 5.1e-3, "{time_s} {input:?} {expected}");
        let wheels = wheel_speed.ok_or("no wheels")?;
        assert_eq!(wheels[0], 3.0);
        assert!((wheels[1] - 4.0 * (time_s - 1e-3)).abs() < 1e-6, "{time_s} {wheels:?}");
        assert_eq!(wheels[2..], [2.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }
    Ok(())
}

#[test]
fn without_one_topic_of_a_type_the_error_lists_them_all() -> Outcome {
    let mut messages = short();
    let other: Vec<Value> = messages
        .iter()
        .filter(|message| message[2] == "/odom")
        .map(|message| {
            let mut other = message.clone();
            other[2] = json!("/odometry/filtered");
            other
        })
        .collect();
    messages.extend(other);
    let home = home()?;
    let bags = write(home.path(), &[Bag::new(&messages)])?;
    match Log::read(&bags, &Topics::default()) {
        Err(LogError::Bag(BagError::Topic { count: 2, option: "odometry", topics, .. })) => {
            assert_eq!(topics.len(), 5, "{topics:?}");
        }
        other => return Err(format!("{other:?}").into()),
    }
    let odometry = Some("/odometry/filtered".to_owned());
    assert!(Log::read(&bags, &Topics { odometry, ..Topics::default() })?.len() > 70);
    let wrong = Topics { odometry: Some("/cmd_vel".to_owned()), ..Topics::default() };
    let error = Log::read(&bags, &wrong);
    assert!(matches!(error, Err(LogError::Bag(BagError::Topic { count: 0, .. }))), "{error:?}");
    Ok(())
}

#[test]
fn what_cannot_be_used_of_a_bag_is_left_out_and_named() -> Outcome {
    let mut messages = short();
    let mut odometry = messages.iter_mut().filter(|message| message[2] == "/odom");
    let mut next = |place| odometry.nth(place).ok_or("too few messages");
    let of_zero = next(9)?;
    (2..6).for_each(|place| of_zero[4][place] = json!(0.0));
    next(4)?[4][6] = Value::Null;
    let time = next(24)?[1].clone();
    next(0)?[1] = time;
    // No odometry for half a second.
    let gap = START + 2_500 * MS..START + 3_000 * MS;
    messages.retain(|message| {
        message[2] != "/odom" || message[1].as_i64().is_none_or(|time| !gap.contains(&time))
    });
    let home = home()?;
    let log = Log::read(&write(home.path(), &[Bag::new(&messages)])?, &Topics::default())?;
    for (place, what) in [
        ("message 10:", "quaternion"),
        ("message 15:", "not finite"),
        ("message 40:", "time of the next"),
        ("message 51:", "since the row before"),
    ] {
        let is_named = |note: &String| note.contains(place) && note.contains(what);
        assert!(log.notes.iter().any(is_named), "{place} {what}: {:?}", log.notes);
    }
    assert_eq!(log.stretches.len(), 1, "of the rest there is less than 2 s: {:?}", log.notes);
    Ok(())
}

#[test]
fn a_bag_that_cannot_be_used_is_refused_by_its_reason() -> Outcome {
    let good = short();
    let changed = |topic: &str, change: &dyn Fn(&mut Value)| {
        let mut messages = good.clone();
        if let Some(message) = messages.iter_mut().filter(|message| message[2] == topic).nth(19) {
            change(message);
        }
        messages
    };
    let plain = Topics::default();
    let error = refused(&changed("/cmd_vel", &|message| message[4][0] = Value::Null), &plain)?;
    let expected = matches!(
        &error,
        LogError::Bag(BagError::Message { topic, number: 20, source, .. })
            if topic == "/cmd_vel" && matches!(source, MessageError::NotFinite(_))
    );
    assert!(expected, "{error}");
    let error = refused(&changed("/odom", &|message| message[1] = json!(START)), &plain)?;
    assert!(matches!(error, LogError::Backwards { .. }), "{error}");
    let late: Vec<Value> = good
        .iter()
        .cloned()
        .map(|mut message| {
            message[0] = json!(message[0].as_i64().unwrap_or(0) + 2_000 * MS);
            message
        })
        .collect();
    let error = refused(&late, &plain)?;
    assert!(matches!(error, LogError::Bag(BagError::Clocks { .. })), "{error}");
    let strangers = Topics { wheel_joints: vec!["wheel".to_owned()], ..plain.clone() };
    let error = refused(&good, &strangers)?;
    assert!(matches!(&error, LogError::Bag(BagError::Joints { found, .. }) if found.len() == 5));
    let without: Vec<Value> =
        good.iter().filter(|message| message[2] != "/cmd_vel").cloned().collect();
    let error = refused(&without, &plain)?;
    assert!(matches!(error, LogError::Bag(BagError::Topic { option: "command", .. })), "{error}");
    Ok(())
}

#[test]
fn a_damaged_or_compressed_file_is_refused_or_read_as_far_as_it_goes() -> Outcome {
    let home = home()?;
    let mcap = Bag::new(&short());
    let sqlite = Bag { storage: "sqlite3", ..mcap.clone() };
    let bags = write(
        home.path(),
        &[
            mcap.clone(),
            sqlite.clone(),
            Bag { compression: "message", ..sqlite.clone() },
            Bag { compression: "file", ..sqlite.clone() },
            Bag { encoding: "json", ..mcap.clone() },
        ],
    )?;
    let read = |path: &Path| Log::read(&[path.to_owned()], &Topics::default());
    let cut = home.path().join("cut");
    for (bag, share) in [(&bags[0], 0.7), (&bags[1], 0.7), (&bags[1], 0.01)] {
        let bytes = fs::read(file(bag)?)?;
        fs::write(&cut, &bytes[..(share * bytes.len() as f64) as usize])?;
        match read(&cut) {
            Ok(log) => assert!(log.notes.iter().any(|note| note.ends_with("ends early"))),
            Err(LogError::Bag(BagError::Database { path, .. })) => assert_eq!(path, cut),
            Err(other) => return Err(other.into()),
        }
    }
    let error = read(&bags[2]);
    let source = matches!(
        error,
        Err(LogError::Bag(BagError::Message { source: MessageError::Compressed, .. }))
    );
    assert!(source, "{error:?}");
    let error = read(&bags[3]);
    assert!(matches!(error, Err(LogError::Bag(BagError::Compressed(_)))), "{error:?}");
    let error = read(&bags[4]);
    assert!(matches!(error, Err(LogError::Bag(BagError::Encoding { .. }))), "{error:?}");
    Ok(())
}

/// ```sh
/// cargo test -p promises --test promises bags:: -- --ignored
/// ```
#[test]
#[ignore = "writes the seeds of the fuzzer"]
fn seeds_of_the_fuzzer() -> Outcome {
    let home = home()?;
    let end = START + 2_400 * MS;
    let messages: Vec<Value> = short()
        .into_iter()
        .filter(|message| message[0].as_i64().is_some_and(|time| time < end))
        .collect();
    let mcap = Bag::new(&messages);
    let sqlite = Bag { storage: "sqlite3", ..mcap.clone() };
    let bags = write(home.path(), &[mcap, sqlite])?;
    let folder = repository().join("tests/fuzz/corpus/bag");
    fs::create_dir_all(&folder)?;
    fs::copy(file(&bags[0])?, folder.join("typical.mcap"))?;
    fs::copy(file(&bags[1])?, folder.join("typical.db3"))?;
    Ok(())
}
