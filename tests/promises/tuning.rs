//! Promise: a setting changed by a person while the robot drives is soon in use and on record,
//! whole; or none of it is, and the person gets the reason.

use controller::control::tuning::RULES;
use controller::reference::Reference;
use coxswain::set::{SetError, set, understand};
use process::read_settings;
use process::requests::{Outcome as Came, Settled};
use promises::{Launched, Outcome, Record, binaries, graph_file, launch_command, signal};
use protocol::message::Participant;
use rustix::process::Signal;
use settings::change::{Change, changed};
use std::collections::BTreeMap;
use std::error::Error;
use std::io::{self, Write};
use std::path::Path;
use std::process::{Command, Output};

/// Random settings.
const COUNT: u64 = 1000;
/// One of so many is sent by the program itself; the others by the function that it calls.
const BY_PROGRAM: u64 = 25;
/// Most periods between the end of its preparation and its effect: the one under way, and one
/// before whose state there is no time left.
const WITHIN: usize = 2;
/// For tests without other requirements: inputs under way when a plan was made do not count into
/// its horizon.
const SCENARIO: [&str; 4] = ["--scenario", "circle", "--duration", "600"];

/// Random numbers; the same ones every time.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % end
    }

    /// A number from `from` on, evenly distributed on a logarithmic scale.
    fn ratio(&mut self, from: f64, to: f64) -> f64 {
        from * (to / from).powf(self.below(1001) as f64 / 1000.0)
    }

    fn of<'a>(&mut self, several: &[&'a str]) -> &'a str {
        several[self.below(several.len() as u64) as usize]
    }

    fn weight(&mut self) -> String {
        let key =
            self.of(&["position", "heading", "velocity", "yaw_rate", "input", "terminal_factor"]);
        format!("mpc.weights.{key}={:.4}", self.ratio(0.05, 50.0))
    }

    fn horizon(&mut self) -> [String; 2] {
        let horizon = 3 + self.below(38);
        [
            format!("mpc.horizon_steps={horizon}"),
            format!("mpc.control_horizon_steps={}", 1 + self.below(horizon.min(10))),
        ]
    }

    fn path(&mut self) -> Vec<String> {
        let (size, speed) = (self.ratio(0.5, 5.0), self.ratio(0.2, 1.5));
        let path = match self.below(3) {
            0 => {
                format!("reference.path.circle={{ radius_m = {size:.3}, speed_mps = {speed:.3} }}")
            }
            1 => format!("reference.path.square={{ side_m = {size:.3}, speed_mps = {speed:.3} }}"),
            _ => {
                format!(
                    "reference.path.figure-eight=\
                    {{ length_m = {size:.3}, width_m = {:.3}, lap_s = {:.3} }}",
                    size / 2.0,
                    20.0 / speed
                )
            }
        };
        vec![path, format!("reference.heading={}", self.of(&["tangent", "{ fixed-rad = 0.5 }"]))]
    }

    /// A setting, and the key for which it must be refused, if any.
    fn setting(&mut self) -> (Vec<String>, Option<&'static str>) {
        let good = match self.below(8) {
            0 | 1 => vec![self.weight()],
            2 => self.horizon().to_vec(),
            3 => self.path(),
            4 => vec![
                format!("mpc.budget_share={:.3}", self.ratio(0.1, 1.0)),
                format!("mpc.solver={}", self.of(&["clarabel", "active-set"])),
            ],
            5 => vec![format!("mpc.state_limits.speed_mps={}", self.of(&["none", "0.8", "2.0"]))],
            6 => {
                let horizon = self.horizon().to_vec();
                [horizon, vec!["mpc.weights.input_change=0.1".into()], self.path()].concat()
            }
            _ => {
                return (
                    vec![
                        format!("learner.every_ticks={}", 3 + self.below(30)),
                        format!("learner.evaluations_max={}", 1 + self.below(30)),
                    ],
                    None,
                );
            }
        };
        if self.below(4) > 0 {
            return (good, None);
        }
        // The rest of it is valid, and must not be applied either.
        let (key, value) = match self.below(8) {
            0 => ("mpc.horizon_steps", "41"),
            1 => ("mpc.weights.position", "-1.0"),
            2 => ("mpc.weights.heading", "heavy"),
            3 => ("mpc.weights.importance", "1.0"),
            4 => ("robot.limits.input_mps", "9.0"),
            5 => ("mpc.observer_gain", "0.5"),
            6 => ("mpc.state_limits.chance_level", "0.2"),
            _ => ("mpc.budget_share", "0"),
        };
        let rest = good.into_iter().filter(|pair| !pair.starts_with(key));
        (rest.chain([format!("{key}={value}")]).collect(), Some(key))
    }
}

/// Runs `coxswain set ARGUMENTS…` for the launch whose files are at `home`.
fn say(home: &Path, arguments: &[&str]) -> Result<Output, Box<dyn Error>> {
    Ok(Command::new(binaries()?.join("coxswain"))
        .arg("set")
        .args(arguments)
        .env("TMPDIR", home)
        .output()?)
}

/// The exit code and the standard error.
fn refusal(home: &Path, arguments: &[&str]) -> Result<(Option<i32>, String), Box<dyn Error>> {
    let output = say(home, arguments)?;
    Ok((output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned()))
}

/// The folder of the launches at `home`.
fn base(home: &Path) -> std::path::PathBuf {
    home.join(format!("coxswain-{}", rustix::process::getuid().as_raw()))
}

/// Ends a launch as a user would, and reads its record.
fn end(launched: Launched) -> Result<Record, Box<dyn Error>> {
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(128 + 15), "{}", ended.text);
    Ok(Record::read(&home.path().join("run"))?)
}

/// The changes in the record, by process and number.
fn on_record(record: &Record) -> Result<BTreeMap<(String, u64), Settled>, Box<dyn Error>> {
    let text =
        record.of("set").map(|message| serde_json::from_value::<Settled>(message.fields.clone()));
    Ok(text
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .map(|settled| ((settled.process.clone(), settled.number), settled))
        .collect())
}

#[test]
fn each_of_a_thousand_random_settings_is_used_within_two_ticks_or_refused_and_recorded() -> Outcome
{
    let launched = Launched::new(&SCENARIO)?;
    launched.wait_for_log("controller", "version=2 ", 1)?;
    let (home, run) = (launched.home().to_path_buf(), launched.folder());
    let settings: controller::Settings = read_settings(&run.join("settings/controller.toml"))?;
    let mut random = Random(7);
    let mut refused = 0;
    for number in 0..COUNT {
        let (pairs, wrong) = random.setting();
        let (came, why) = if number % BY_PROGRAM == 0 {
            let mut arguments: Vec<&str> = pairs.iter().map(String::as_str).collect();
            let folder = run.to_string_lossy();
            if number % (2 * BY_PROGRAM) == 0 {
                arguments.extend(["--run", &folder]);
            }
            let (code, text) = refusal(&home, &arguments)?;
            (code == Some(0), text)
        } else {
            let (lines, role) = understand(&pairs)?;
            set(Some(&run), &base(&home), role, &lines)
                .map_or_else(|error| (false, error.to_string()), |_| (true, String::new()))
        };
        assert_eq!(came, wrong.is_none(), "{pairs:?}: {why}");
        if let Some(key) = wrong {
            assert!(why.contains(key), "{pairs:?}: {why}");
            refused += 1;
        }
    }
    let record = end(launched)?;

    let settled = on_record(&record)?;
    assert_eq!(settled.len() as u64, COUNT, "everything that was asked is on record");
    assert!(
        settled
            .values()
            .all(|settled| !settled.request.who.is_empty() && settled.request.asked_unix_nanos > 0)
    );
    let mut delays = BTreeMap::new();
    let mut in_use = vec![(0, settings.clone())];
    for settled in settled.values() {
        let Came::Applied { taken_at_tick, ready_at_tick, acts_from_tick, .. } =
            settled.answer.outcome
        else {
            continue;
        };
        *delays.entry(acts_from_tick - taken_at_tick).or_insert(0) += 1;
        // The preparation time depends on the machine; a prepared change waits for nothing but the
        // end of a period.
        let answered = record
            .of("plan")
            .filter(|plan| (ready_at_tick + 1..acts_from_tick).contains(&plan.stamp("tick")));
        assert!(answered.count() < WITHIN, "{settled:?}");
        if settled.process == Participant::Controller.text()
            && let Some((_, before)) = in_use.last()
        {
            let after = changed(before, &[Change::parse(&settled.request.change)?], &RULES)?;
            in_use.push((acts_from_tick, after));
        }
    }
    let applied: u64 = delays.values().sum();
    assert_eq!((applied, settled.len() as u64 - applied), (COUNT - refused, refused));
    writeln!(
        io::stdout(),
        "{applied} in use, {refused} refused; periods from taking up to use: {delays:?}"
    )?;
    the_plans_are_of_the_settings_that_the_record_gives(&record, &in_use)
}

/// Every plan has the horizon of the settings in use then, and begins at their reference.
fn the_plans_are_of_the_settings_that_the_record_gives(
    record: &Record,
    in_use: &[(u64, controller::Settings)],
) -> Outcome {
    let epochs: Vec<u64> = record.of("plan").map(|plan| plan.count("plant_epoch")).collect();
    assert!(epochs.iter().all(|epoch| Some(epoch) == epochs.first()), "nobody was restarted");
    let last = record.of("plan").map(|plan| plan.stamp("tick")).max().ok_or("no plan")?;
    let mut stops = record.of("state").filter(|state| state.word("gate") == "stopped");
    let stopped = stops.next().map(|state| state.stamp("tick"));
    let period = 0.1;
    let mut reference: Option<(usize, Reference)> = None;
    let (mut plans, mut horizons) = (0, std::collections::BTreeSet::new());
    for plan in record.of("plan") {
        let tick = plan.stamp("tick");
        // Of several that act from the same tick on, the last has replaced the others.
        let index = in_use.iter().rposition(|(from, _)| *from <= tick).ok_or("nothing in use")?;
        let (_, settings) = &in_use[index];
        let under_way = plan.count("delay_micros") / 100_000;
        assert_eq!(
            plan.count("horizon"),
            (settings.mpc.horizon_steps as u64 + under_way).min(40),
            "tick {tick}"
        );
        horizons.insert(settings.mpc.horizon_steps);
        if reference.as_ref().is_none_or(|(of, _)| *of != index) {
            let table = Reference::new(
                &settings.reference,
                &settings.start,
                period,
                usize::try_from(last)?,
            )?;
            reference = Some((index, table));
        }
        plans += 1;
        // The reference of a robot that the gate has stopped waits.
        if stopped.is_some_and(|stopped| tick >= stopped) {
            continue;
        }
        let point = reference.as_ref().ok_or("no reference")?.1.at(tick);
        let begins: Vec<f64> = plan.fields["reference"][0]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(serde_json::Value::as_f64)
            .collect();
        assert_eq!(begins[..3], point.pose, "tick {tick}");
    }
    assert!(plans > 200 && horizons.len() > 10, "{plans} plans, of {horizons:?}");
    Ok(())
}

#[test]
fn an_impossible_setting_is_named_and_the_settings_in_use_stay() -> Outcome {
    let launched = Launched::new(&SCENARIO)?;
    launched.wait_for_log("controller", "version=1 ", 1)?;
    let home = launched.home().to_path_buf();
    for (pairs, parts) in [
        (&["mpc.weights.position=-1"][..], ["mpc.weights.position = -1", "(value)"]),
        (&["mpc.weights.postion=1"], ["mpc.weights.postion = 1", "(unknown-key)"]),
        (&["mpc.weights.position=heavy"], ["mpc.weights.position = \"heavy\"", "(value)"]),
        (&["mpc.weights.position=none"], ["mpc.weights.position", "(missing-key)"]),
        (&["mpc.horizon_steps=41"], ["mpc.horizon_steps = 41", "(value)"]),
        (
            &["mpc.horizon_steps=20", "mpc.control_horizon_steps=21"],
            ["mpc.control_horizon_steps = 21", "(value)"],
        ),
        (&["mpc.solver=magic"], ["mpc.solver = \"magic\"", "(value)"]),
        (&["robot.limits.input_mps=100"], ["robot.limits.input_mps = 100", "(fixed-key)"]),
        (
            &["reference.path.circle.width_m=3"],
            ["reference.path.circle.width_m = 3", "(unknown-key)"],
        ),
        (&["reference.path.square.side_m=3"], ["reference.path.square.speed_mps", "(missing-key)"]),
        (&["reference.path.points.file=/nowhere.csv"], ["/nowhere.csv", "(value)"]),
        (&["learner.every_ticks=0"], ["learner.every_ticks = 0", "(value)"]),
        (&["learner.points_max=50"], ["learner.points_max = 50", "(fixed-key)"]),
        (&["learner.every_ticks=9", "mpc.horizon_steps=9"], ["", ""]),
        (&["mpc.horizon_steps"], ["KEY=VALUE", ""]),
    ] {
        let (code, text) = refusal(&home, pairs)?;
        assert_eq!((code, text.trim().lines().count()), (Some(2), 1), "{pairs:?}: {text}");
        assert!(parts.iter().all(|part| text.contains(part)), "{pairs:?}: {text}");
    }
    let two = understand(&["learner.every_ticks=9".into(), "mpc.horizon_steps=9".into()]);
    assert!(matches!(two, Err(SetError::TwoProcesses)), "{two:?}");
    let record = end(launched)?;
    let settled = on_record(&record)?;
    assert!(
        settled.len() == 13
            && settled
                .values()
                .all(|settled| matches!(settled.answer.outcome, Came::Refused { .. })),
        "{settled:?}"
    );
    let horizons: Vec<u64> = record
        .of("plan")
        .map(|plan| plan.count("horizon") - plan.count("delay_micros") / 100_000)
        .collect();
    assert!(horizons.iter().all(|horizon| Some(horizon) == horizons.first()), "{horizons:?}");
    Ok(())
}

#[test]
fn without_a_driving_robot_or_in_lock_step_nothing_can_be_set() -> Outcome {
    let launched = Launched::new(&["--pace", "lock-step", "--duration", "10000"])?;
    launched.wait_for_controller(1)?;
    let (home, run) = (launched.home().to_path_buf(), launched.folder());
    let (code, text) = refusal(&home, &["mpc.weights.position=3"])?;
    assert!(code == Some(2) && text.contains("controller (lock-step)"), "{text}");
    let (code, text) = refusal(&home, &["learner.every_ticks=3"])?;
    assert!(code == Some(2) && text.contains("learner (lock-step)"), "{text}");
    let (code, text) = refusal(&home, &["mpc.weights.position=3", "--run", "/nowhere"])?;
    assert!(code == Some(2) && text.contains("--run /nowhere"), "{text}");

    let other =
        Launched::at_home(tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?, &SCENARIO)?;
    let (code, text) =
        refusal(other.home(), &["mpc.weights.position=3", "--run", &run.to_string_lossy()])?;
    assert!(code == Some(2) && text.contains(&*run.to_string_lossy()), "{text}");
    drop(other);
    drop(launched);
    let empty = tempfile::tempdir_in("/tmp")?;
    let (code, text) = refusal(empty.path(), &["mpc.weights.position=3"])?;
    assert_eq!(code, Some(1), "{text}");
    let nothing = set(None, &base(empty.path()), Participant::Controller, "");
    assert!(matches!(nothing, Err(SetError::NothingRuns)), "{nothing:?}");
    Ok(())
}

#[test]
fn of_two_launches_only_the_named_one_is_changed() -> Outcome {
    let first = Launched::new(&SCENARIO)?;
    first.wait_for_controller(1)?;
    let home = first.home().to_path_buf();
    let mut command = launch_command(&graph_file("local"), &home.join("second"), &SCENARIO)?;
    command.env("TMPDIR", &home);
    let mut second = promises::Reader::start(&mut command)?;
    second.wait_for_error("coxswain watch", 1)?;
    let (code, text) = refusal(&home, &["mpc.horizon_steps=9"])?;
    let [one, two] = ["run", "second"].map(|name| home.join(name).display().to_string());
    assert!(code == Some(2) && text.contains(&one) && text.contains(&two), "{text}");
    let output = say(&home, &["mpc.horizon_steps=9", "--run", &two])?;
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.starts_with("mpc.horizon_steps = 9: "), "{text}");
    signal(second.pid(), Signal::TERM)?;
    second.end()?;
    let records = (end(first)?, ());
    assert_eq!(on_record(&records.0)?.len(), 0, "the other drives as before");
    Ok(())
}

#[test]
fn a_restarted_controller_keeps_its_changed_settings() -> Outcome {
    let launched = Launched::new(&SCENARIO)?;
    launched.wait_for_log("controller", "version=1 ", 1)?;
    let home = launched.home().to_path_buf();
    assert!(
        say(&home, &["mpc.horizon_steps=9", "reference.path.circle.radius_m=1.5"])?
            .status
            .success()
    );
    assert!(say(&home, &["mpc.horizon_steps=11"])?.status.success());
    let pid = launched.process("controller", None)?;
    signal(pid, Signal::KILL)?;
    // No process is there to answer at once.
    let output = say(&home, &["mpc.weights.position=12"])?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    launched.process("controller", Some(pid))?;
    launched.wait_for_controller(2)?;
    launched.wait_for_log("controller", "changes=", 1)?;
    std::thread::sleep(std::time::Duration::from_secs(1));
    let record = end(launched)?;
    let second = record.of("plan").map(|plan| plan.stamp("epoch")).max().ok_or("no plan")?;
    let horizons: Vec<u64> = record
        .of("plan")
        .filter(|plan| plan.stamp("epoch") == second)
        .map(|plan| plan.count("horizon") - plan.count("delay_micros") / 100_000)
        .collect();
    assert!(horizons.len() > 3 && horizons.iter().all(|&horizon| horizon == 11), "{horizons:?}");
    assert_eq!(on_record(&record)?.len(), 3);
    Ok(())
}
