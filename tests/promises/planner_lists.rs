//! Promise: a planner's list of obstacles slows a robot that does not see them itself. A list that
//! is too old bounds the speed, also after a restart of the plant. In lock step the lists of a
//! scenario give the same bits on any hosts.

use coxswain::obstacles::{ObstacleLists, ObstaclesError};
use driver::{Listed, PlannerList};
use promises::{Launched, Message, Outcome, Record, binaries, python, repository, signal};
use robot::{Point, Robot, Shape};
use rustix::process::{Signal, getuid};
use std::error::Error;
use std::fs;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// Corners of a wall across the way of the robot, too long to drive around it.
fn wall(x_m: f64) -> Vec<Point> {
    let far = x_m + 0.2;
    vec![[x_m, -60.0], [far, -60.0], [far, 60.0], [x_m, 60.0]]
}

fn list(valid_s: f64, corners_m: Vec<Point>) -> PlannerList {
    let listed = Listed { corners_m, radius_m: 0.0, velocity_mps: [0.0; 2] };
    PlannerList { valid_s, age_s: 0.0, obstacles: vec![listed] }
}

fn launch() -> Result<Launched, Box<dyn Error>> {
    let launched = Launched::graph("local", &["--scenario", "goals", "--duration", "600"])?;
    launched.wait_for_controller(1)?;
    Ok(launched)
}

fn planner(launched: &Launched) -> Result<ObstacleLists, ObstaclesError> {
    let base = launched.home().join(format!("coxswain-{}", getuid().as_raw()));
    ObstacleLists::on_this_machine(None, &base)
}

fn coxswain(launched: &Launched, arguments: &[&str]) -> Result<Command, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.args(arguments).env("TMPDIR", launched.home());
    Ok(command)
}

/// Drives ahead with 0.5 m/s for a minute.
fn drive(launched: &Launched) -> Outcome {
    let arguments = ["drive", "0.5", "0", "0", "--for", "60", "--no-wait"];
    let output = coxswain(launched, &arguments)?.output()?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(())
}

/// x of the robot, and its speed ahead.
fn ahead(launched: &Launched) -> Option<(f64, f64)> {
    let output = coxswain(launched, &["status", "--json"]).ok()?.output().ok()?;
    let status: serde_json::Value = serde_json::from_slice(&output.stdout).ok()?;
    let robot = &status["robot"];
    Some((robot["pose"][0].as_f64()?, robot["velocity"][0].as_f64()?))
}

fn wait_for_speed(launched: &Launched, what: &str, is_so: impl Fn(f64) -> bool) -> Outcome {
    launched.wait_until(what, || ahead(launched).is_some_and(|(_, speed)| is_so(speed)))
}

fn moves(speed: f64) -> bool {
    speed > 0.4
}

fn stands(speed: f64) -> bool {
    speed.abs() < 0.01
}

fn end(launched: Launched) -> Result<Record, Box<dyn Error>> {
    signal(launched.pid(), Signal::TERM)?;
    let (_, home) = launched.end()?;
    Ok(Record::read(&home.path().join("run"))?)
}

fn footprint(truth: &Message) -> Result<Shape, Box<dyn Error>> {
    let pose: [f64; 3] = truth.numbers("pose").try_into().map_err(|_| "no pose")?;
    Ok(Robot::example().footprint().shape().placed(&pose))
}

/// Reasons of the gate while it slowed the robot, in order.
fn slowed(record: &Record) -> Vec<String> {
    let reasons = record.of("state").map(|state| state.word("reason").to_owned());
    let mut reasons: Vec<String> = reasons
        .filter(|reason| ["protective stop", "obstacles unknown"].contains(&reason.as_str()))
        .collect();
    reasons.dedup();
    reasons
}

#[test]
fn a_robot_slows_before_an_obstacle_that_only_a_planner_knows_and_when_the_planner_dies() -> Outcome
{
    let launched = launch()?;
    let mut lists = planner(&launched)?;
    let far = list(0.5, vec![[0.0, 50.0]]);
    lists.send(&far)?;
    drive(&launched)?;
    let stream = |lists: &mut ObstacleLists, list: &PlannerList, until: &dyn Fn() -> Outcome| {
        let ends = AtomicBool::new(false);
        thread::scope(|scope| -> Outcome {
            let sender = scope.spawn(|| {
                while !ends.load(Ordering::Relaxed) {
                    lists.send(list)?;
                    thread::sleep(Duration::from_millis(50));
                }
                Ok::<_, ObstaclesError>(())
            });
            let outcome = until();
            ends.store(true, Ordering::Relaxed);
            sender.join().map_err(|_| "a panic")??;
            outcome
        })
    };
    stream(&mut lists, &far, &|| wait_for_speed(&launched, "motion", moves))?;
    // The planner is silent.
    wait_for_speed(&launched, "standstill", stands)?;
    drive(&launched)?;
    stream(&mut lists, &far, &|| wait_for_speed(&launched, "motion again", moves))?;
    let (x, _) = ahead(&launched).ok_or("no pose")?;
    let before = x + 3.0;
    drive(&launched)?;
    stream(&mut lists, &list(0.5, wall(before)), &|| {
        launched.wait_until("standstill before the wall", || {
            ahead(&launched).is_some_and(|(x, speed)| x > before - 1.5 && stands(speed))
        })?;
        let bad = planner(&launched)?.send(&list(600.0, vec![]));
        assert!(matches!(bad, Err(ObstaclesError::List(_))), "{bad:?}");
        thread::sleep(Duration::from_secs(3));
        Ok(())
    })?;
    let record = end(launched)?;
    let wall = Shape::hull(&wall(before), 0.0)?;
    let mut nearest = f64::INFINITY;
    for truth in record.of("truth") {
        nearest = nearest.min(footprint(truth)?.separation(&wall).distance_m);
    }
    assert!(nearest > 0.0 && nearest < 0.5, "{nearest} m from the wall");
    assert!(slowed(&record).contains(&"obstacles unknown".to_owned()), "{:?}", slowed(&record));
    let is_of_planner = |list: &Message| list.word("source") == "planner";
    assert!(record.of("obstacles").all(is_of_planner) && record.of("obstacles").count() > 40);
    let health = record.health_of("plant").next_back().ok_or("no health")?;
    let received = health.fields["received"]["obstacles"].as_u64();
    assert!(received > Some(40), "Health of the plant counts the lists: {received:?}");
    Ok(())
}

#[test]
fn a_restarted_plant_stays_slow_until_the_planner_sends_again() -> Outcome {
    let launched = launch()?;
    let mut lists = planner(&launched)?;
    let far = list(600.0, vec![[0.0, 50.0]]);
    lists.send(&far)?;
    signal(launched.process("plant-sim", None)?, Signal::KILL)?;
    launched.wait_for_controller(2)?;
    drive(&launched)?;
    thread::sleep(Duration::from_secs(2));
    let (_, speed) = ahead(&launched).ok_or("no status")?;
    assert!(stands(speed), "{speed} m/s");
    // The same sender reaches the new plant.
    lists.send(&far)?;
    drive(&launched)?;
    wait_for_speed(&launched, "motion", moves)?;
    end(launched)?;
    Ok(())
}

/// The scenario `goals` with a goal, and with `lists` of a planner, in `folder`.
fn scenario(folder: &std::path::Path, lists: &str) -> Result<String, Box<dyn Error>> {
    let text = fs::read_to_string(repository().join("deploy/scenarios/goals.toml"))?;
    let goal = "[[goals]]\nat_s = 0.5\ngoal.pose.to = [4.0, 0.0, 0.0]\n";
    let file = folder.join("scenario.toml");
    fs::write(&file, format!("{text}\n{goal}\n{lists}"))?;
    Ok(file.display().to_string())
}

fn commands_of(graph: &str, host: &str, lists: &str) -> Result<Vec<String>, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let scenario = scenario(folder.path(), lists)?;
    let options = ["--scenario", &scenario, "--pace", "lock-step", "--duration", "8"];
    let (ended, home) = Launched::graph(graph, &options)?.end()?;
    assert!(ended.status.success(), "{graph}: {}", ended.text);
    let record = Record::read(&home.path().join("run").join(host))?;
    if !lists.is_empty() {
        let planned = record.of("obstacles").filter(|list| list.word("source") == "planner");
        let ticks: Vec<u64> = planned.map(|list| list.stamp("tick")).collect();
        assert_eq!(ticks, [20, 100], "each list at its tick");
        let disc = Shape::hull(&[[2.0, 0.1]], 0.3)?;
        for truth in record.of("truth") {
            assert!(footprint(truth)?.separation(&disc).distance_m > 0.0);
        }
    }
    Ok(record.of("command").map(|message| message.fields["input"].to_string()).collect())
}

#[test]
fn in_lock_step_the_lists_of_a_scenario_give_the_same_bits_on_one_host_and_on_two() -> Outcome {
    let lists = "[[lists]]\nat_s = 0.4\nlist.valid_s = 100.0\n\
        list.obstacles = [{ corners_m = [[2.0, 0.1]], radius_m = 0.3 }]\n\
        [[lists]]\nat_s = 2.0\nlist.valid_s = 100.0\n\
        list.obstacles = [{ corners_m = [[2.0, 0.1]], radius_m = 0.3 }, \
        { corners_m = [[3.0, -3.0]], radius_m = 0.3, velocity_mps = [0.0, 0.4] }]\n";
    let alone = commands_of("local", "", lists)?;
    assert_eq!(alone, commands_of("local", "", lists)?, "twice on one host");
    assert_eq!(alone, commands_of("two-hosts", "robot", lists)?, "on two hosts");
    assert_ne!(alone, commands_of("local", "", "")?, "the lists have an effect");
    Ok(())
}

#[test]
fn an_impossible_list_of_a_scenario_is_refused_before_anything_starts() -> Outcome {
    let folder = tempfile::tempdir()?;
    for list in ["valid_s = nan\nobstacles = []", "valid_s = 1.0\nobstacles = [{ corners_m = [] }]"]
    {
        let lists = format!("[[lists]]\nat_s = 0.0\n[lists.list]\n{list}\n");
        let scenario = scenario(folder.path(), &lists)?;
        let (ended, home) = Launched::graph("local", &["--scenario", &scenario])?.end()?;
        assert_eq!(ended.status.code(), Some(2), "{list}: {}", ended.text);
        assert!(!home.path().join("run").exists(), "{list}");
    }
    Ok(())
}

/// The examples that stream obstacles.
fn programs() -> Result<[Command; 2], Box<dyn Error>> {
    let mut script = Command::new(python()?);
    script.arg("-B").arg(repository().join("deploy/clients/python/obstacles.py"));
    Ok([Command::new(binaries()?.join("examples/obstacles")), script])
}

#[test]
fn short_programs_in_rust_and_python_stream_obstacles() -> Outcome {
    for file in ["services/coxswain/examples/obstacles.rs", "deploy/clients/python/obstacles.py"] {
        assert!(fs::read_to_string(repository().join(file))?.lines().count() <= 42, "{file}");
    }
    let launched = launch()?;
    let file = repository().join("deploy/clients/obstacles.json");
    let bad = launched.home().join("bad.json");
    fs::write(&bad, r#"{"valid_s": 1.0, "obstacles": [{"corners_m": []}]}"#)?;
    for mut program in programs()? {
        let output = program.arg(&file).arg("1.5").env("TMPDIR", launched.home()).output()?;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{program:?}: {errors}");
    }
    for mut program in programs()? {
        let output = program.arg(&bad).env("TMPDIR", launched.home()).output()?;
        assert_eq!((output.status.code(), output.stderr.is_empty()), (Some(1), false));
    }
    let record = end(launched)?;
    let lists: Vec<&Message> = record.of("obstacles").collect();
    assert!(lists.len() >= 20, "{} lists", lists.len());
    let y = |list: &Message| list.fields["obstacles"][1][4].as_f64();
    assert!(lists.iter().all(|list| y(list).is_some_and(|y| y <= 2.0 && y > 1.5)));
    for mut program in programs()? {
        assert_eq!(program.output()?.status.code(), Some(2), "{program:?}");
    }
    Ok(())
}
