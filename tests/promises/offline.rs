//! Promise: a model is trained from logs as the learner would, and a launch that begins with it
//! predicts better from the start. A model that cannot be used changes nothing.

use graph::assembly::Assembly;
use graph::options::Options;
use identify::log::Log;
use identify::log::bag::Topics;
use offline::periods::passages;
use process::Run;
use promises::{Launched, Outcome, Record, binaries, graph_file, repository};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use tempfile::TempDir;

fn home() -> std::io::Result<TempDir> {
    tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")
}

fn coxswain(home: &Path, arguments: &[&str]) -> Result<Output, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.current_dir(repository()).env("TMPDIR", home).args(arguments);
    Ok(command.output()?)
}

/// What the logs have: a motion that is not that of the graph.
const SCENARIO: [&str; 2] = ["--scenario", "figure-eight"];

/// The local graph with this scenario.
fn assembly() -> Result<Assembly, Box<dyn Error>> {
    let [_, scenario] = SCENARIO;
    let local = Options::of_graph(&graph_file("local"));
    Ok(Assembly::read(&Options { scenario: Some(scenario.into()), ..local })?)
}

/// `coxswain learn` from `log` for the local graph, into `to`.
fn learn(home: &Path, log: &Path, to: &Path, options: &[&str]) -> Result<Output, Box<dyn Error>> {
    let (graph, log, to) = (graph_file("local"), log.display(), to.display());
    let (graph, log, to) = (graph.display().to_string(), log.to_string(), to.to_string());
    let arguments = ["learn", "--graph", &graph, &log, "--to", &to];
    coxswain(home, &[arguments.as_slice(), options].concat())
}

/// Folder of a run without a learner, and the model that was trained from it.
type School = (TempDir, PathBuf);

/// One for the tests that run at the same time. Its folder goes with the last of them.
fn school() -> Result<Arc<School>, Box<dyn Error>> {
    static SCHOOL: Mutex<Weak<School>> = Mutex::new(Weak::new());
    let mut shared = SCHOOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(school) = shared.upgrade() {
        return Ok(school);
    }
    let drive = ["--pace", "lock-step", "--learner", "off"];
    let (ended, home) = Launched::new(&[drive.as_slice(), &SCENARIO].concat())?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let model = home.path().join("model.bin");
    let output = learn(home.path(), &home.path().join("run"), &model, &[])?;
    assert!(output.status.success(), "{output:?}");
    let school = Arc::new((home, model));
    *shared = Arc::downgrade(&school);
    Ok(school)
}

#[test]
fn the_samples_of_a_record_are_those_that_the_controller_sent() -> Outcome {
    let school = school()?;
    let (home, _) = &*school;
    let run = home.path().join("run");
    let assembly = assembly()?;
    let links = assembly.links("none", Path::new(""));
    let settings = assembly.controller(Run::new("", assembly.scenario.period_nanos(), links));
    let passages = passages(&Log::read(std::slice::from_ref(&run), &Topics::default())?, &settings);
    let ours: Vec<_> = passages.iter().flatten().map(|period| period.sample).collect();
    let record = Record::read(&run)?;
    let sent: Vec<_> = record.of("residual").filter(|it| it.count("usable") == 1).collect();
    assert!(sent.len() > 200, "{}", sent.len());
    for message in sent {
        let tick = message.stamp("tick");
        let sample = ours.iter().find(|sample| sample.stamp.tick == tick).ok_or("no sample")?;
        let told = message.fields["dead_time_s"].as_f64();
        assert_eq!(told, Some(sample.dead_time_s), "dead time at tick {tick}");
        for (name, numbers) in [
            ("velocity", sample.velocity),
            ("input", sample.input),
            ("input_before", sample.input_before),
            ("residual", sample.residual),
        ] {
            assert_eq!(message.numbers(name), numbers, "{name} at tick {tick}");
        }
    }
    Ok(())
}

#[test]
fn the_same_logs_give_the_same_bytes() -> Outcome {
    let school = school()?;
    let (home, model) = &*school;
    let again = home.path().join("again.bin");
    let output = learn(home.path(), &home.path().join("run"), &again, &[])?;
    assert!(output.status.success(), "{output:?}");
    assert!(fs::read(model)? == fs::read(again)?);
    Ok(())
}

/// RMS of the one-step error of the whole model in the first 5 s, planar \[m/s\], and the axes on
/// which the learned model was used.
fn first_seconds(options: &[&str]) -> Result<(f64, u64), Box<dyn Error>> {
    let common = ["--pace", "lock-step", "--duration", "5", "--seed", "7"];
    let (ended, home) = Launched::new(&[&common, options].concat())?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    let (mut squares, mut count, mut axes) = (0.0, 0.0, 0_u64);
    for plan in record.of("plan") {
        let innovation = plan.numbers("innovation");
        squares += innovation.iter().take(2).map(|error| error * error).sum::<f64>();
        axes |= plan.count("learned_axes");
        count += 1.0;
    }
    Ok(((squares / count).sqrt(), axes))
}

#[test]
fn a_launch_that_begins_with_the_model_predicts_better_in_its_first_seconds() -> Outcome {
    let school = school()?;
    let (_, model) = &*school;
    let (cold, _) = first_seconds(&[])?;
    let (warm, axes) = first_seconds(&["--model", &model.display().to_string()])?;
    assert!(warm < cold, "{warm} m/s with the model, {cold} m/s without");
    assert_eq!(axes & 1, 1, "the controller has used it");
    Ok(())
}

#[test]
fn a_launch_with_a_model_that_it_cannot_use_starts_nothing() -> Outcome {
    let school = school()?;
    let (home, model) = &*school;
    let good = fs::read(model)?;
    let damaged = home.path().join("damaged.bin");
    fs::write(&damaged, &good[..good.len() / 2])?;
    let (model, damaged) = (model.display().to_string(), damaged.display().to_string());
    let refused: [&[&str]; 4] = [
        &["--model", &model, "--robot", "deploy/robots/rosbot-xl.toml"],
        &["--model", &damaged],
        &["--model", "none.bin"],
        &["--model", &model, "--learner", "off"],
    ];
    for options in refused {
        let elsewhere = home.path().join("none");
        let out = elsewhere.display().to_string();
        let graph = graph_file("local").display().to_string();
        let launch = ["launch", graph.as_str(), "--out", &out, "--duration", "1"];
        let output = coxswain(home.path(), &[&launch, options].concat())?;
        assert_eq!(output.status.code(), Some(2), "{options:?}: {output:?}");
        assert!(!elsewhere.exists(), "{options:?}");
    }
    Ok(())
}

#[test]
fn logs_that_cannot_be_used_leave_no_snapshot() -> Outcome {
    let school = school()?;
    let (home, _) = &*school;
    let (run, to) = (home.path().join("run"), home.path().join("none.bin"));
    let refused: [(&Path, &[&str]); 3] = [
        (Path::new("none"), &[]),
        (&run, &["--scenario", "paper-20ms"]),
        (&run, &["--from", "none.bin"]),
    ];
    for (log, options) in refused {
        let output = learn(home.path(), log, &to, options)?;
        assert_eq!(output.status.code(), Some(2), "{options:?}: {output:?}");
        assert!(!to.exists(), "{options:?}");
    }
    Ok(())
}

#[test]
fn a_model_that_is_no_better_than_none_is_not_written() -> Outcome {
    let home = home()?;
    // The main model is the truth, and there is nothing to learn but noise.
    let table = home.path().join("log.csv");
    fs::write(&table, nothing_to_learn(600)?)?;
    let to = home.path().join("model.bin");
    let output = learn(home.path(), &table, &to, &[])?;
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(!to.exists());
    Ok(())
}

#[test]
fn a_table_becomes_a_model_too_also_with_an_earlier_one_as_prior() -> Outcome {
    let school = school()?;
    let (home, earlier) = &*school;
    let log = Log::read(&[home.path().join("run")], &Topics::default())?;
    let mut text = HEADER.to_owned();
    for sample in log.stretches.iter().flatten() {
        push_row(&mut text, sample.time_s, [&sample.pose, &sample.velocity, &sample.input]);
    }
    let table = home.path().join("run.csv");
    fs::write(&table, text)?;
    let earlier = earlier.display().to_string();
    for (name, options) in [("alone.bin", vec![]), ("joined.bin", vec!["--from", &earlier])] {
        let to = home.path().join(name);
        let output = learn(home.path(), &table, &to, &options)?;
        assert!(output.status.success() && to.is_file(), "{name}: {output:?}");
    }
    Ok(())
}

const HEADER: &str = "time_s,x_m,y_m,yaw_rad,velocity_forward_mps,velocity_left_mps,\
                      yaw_rate_radps,input_forward_mps,input_left_mps,input_yaw_radps\n";

/// Pose, velocity and input as a row of a table.
fn push_row(text: &mut String, time_s: f64, numbers: [&[f64; 3]; 3]) {
    let numbers = std::iter::once(&time_s).chain(numbers.into_iter().flatten());
    let cells: Vec<String> = numbers.map(f64::to_string).collect();
    text.push_str(&cells.join(","));
    text.push('\n');
}

/// A table of `rows` rows of a robot that follows the main model of the local graph, with noise.
fn nothing_to_learn(rows: usize) -> Result<String, Box<dyn Error>> {
    let assembly = assembly()?;
    let period = 1e-3 * assembly.scenario.period_millis;
    let main = model::main_model::MainModel::new(&assembly.robot, period);
    let mut text = HEADER.to_owned();
    let mut state = model::State::default();
    let mut random = 1_u64;
    let mut noise = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        0.02 * ((random >> 33) as f64 / f64::from(1_u32 << 31) - 0.5)
    };
    for row in 0..rows {
        let time = row as f64 * period;
        let wave = |rate: f64| (rate * time).sin() + (2.7 * rate * time).cos();
        let input = [0.4 * wave(0.9), 0.4 * wave(1.3), 0.5 * wave(1.1)];
        let belief = model::predict::Belief::of(&main);
        state = belief.predict(&state, &input);
        let velocity = state.velocity.map(|velocity| velocity + noise());
        push_row(&mut text, time, [&state.pose, &velocity, &input]);
    }
    Ok(text)
}

#[test]
fn a_model_is_shown_as_a_table_and_as_a_page() -> Outcome {
    let school = school()?;
    let (home, model) = &*school;
    let (model, page) = (model.display().to_string(), home.path().join("model.html"));
    let to = page.display().to_string();
    let output = coxswain(home.path(), &["model", "show", &model, "--to", &to])?;
    assert!(output.status.success(), "{output:?}");
    let html = fs::read_to_string(&page)?;
    // Six inputs, on each of three axes.
    assert_eq!(html.matches("<svg role=").count(), 18);
    let robot = ["model", "show", &model, "--robot", "deploy/robots/rosbot-xl.toml"];
    assert_eq!(coxswain(home.path(), &robot)?.status.code(), Some(2));
    Ok(())
}
