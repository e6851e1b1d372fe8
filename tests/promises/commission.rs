//! Promise: the commands of the tutorial "Commission a robot", one after the other as they stand
//! there, lead from a data sheet to a robot that learns. The robot is another one than that of the
//! page: its mass, motors, friction and dead time are drawn by a seed.

use graph::assembly::robot_of;
use graph::scenario::Scenario;
use identify::log::{Log, bag::Topics};
use promises::{Outcome, binaries, copy_folder, repository};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;
use std::error::Error;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;
use toml::Table;

/// The robot that the page takes as its simulator.
const SIMULATED: &str = "deploy/worlds/robots/rosbot-xl.toml";

/// The blocks of commands of a page.
fn commands(page: &str) -> Vec<String> {
    let mut blocks = Vec::new();
    let mut open: Option<String> = None;
    for line in page.lines() {
        match (&mut open, line) {
            (None, "```sh") => open = Some(String::new()),
            (Some(_), "```") => blocks.extend(open.take()),
            (Some(block), line) => {
                block.push_str(line);
                block.push('\n');
            }
            _ => {}
        }
    }
    blocks
}

/// Hides another robot behind the page: one whose parameters no file in `home` but the truth has.
/// Returns its dead time \[s\].
fn hide(home: &Path, seed: u64) -> Result<f64, Box<dyn Error>> {
    let path = home.join(SIMULATED);
    let mut scenario: Table = fs::read_to_string(&path)?.parse()?;
    let truth = scenario.get_mut("truth").and_then(toml::Value::as_table_mut).ok_or("no truth")?;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mass = 7.5 * 2.0_f64.powf(random.random_range(-0.6..0.6));
    let dead_time_s = (random.random_range(0.0..0.08_f64) * 1e4).round() * 1e-4;
    let hidden = [
        ("mass_kg", mass),
        ("yaw_inertia_kg_m2", 0.02 * mass),
        ("rolling_friction", random.random_range(0.01..0.05)),
        ("speed_loop_gain_a_s_per_rad", random.random_range(0.8..1.6)),
        ("speed_loop_integral_a_per_rad", random.random_range(0.5..3.0)),
        ("command_delay_s", dead_time_s),
    ];
    for (key, value) in hidden {
        let known = truth.insert(key.to_owned(), value.into());
        assert!(known.is_some(), "{key} is no parameter of the page's robot");
    }
    fs::write(&path, scenario.to_string())?;
    Ok(dead_time_s)
}

fn summary(run: &Path) -> Result<Value, Box<dyn Error>> {
    Ok(serde_json::from_slice(&fs::read(run.join("summary.json"))?)?)
}

#[test]
fn the_page_leads_from_a_data_sheet_to_a_robot_that_learns() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let home = home.path();
    copy_folder(&repository().join("deploy"), &home.join("deploy"))?;
    fs::create_dir(home.join("target"))?;
    symlink(binaries()?, home.join("target/release"))?;
    let dead_time_s = hide(home, 20_261_129)?;
    let page = fs::read_to_string(repository().join("docs/tutorial/commission.md"))?;
    let blocks = commands(&page);
    assert!(blocks.len() >= 7, "{blocks:?}");
    for block in &blocks {
        let mut shell = Command::new("bash");
        // As typed: job control for `&` and `%1`, and an end at the first command that fails.
        shell.args(["-m", "-e", "-c", block.as_str()]).current_dir(home).env("TMPDIR", home);
        let output = shell.output()?;
        assert!(output.status.success(), "{block}\n{output:?}");
    }
    let mine = home.join("mine");

    // What came out is a description of the hidden robot.
    let found = robot_of(&mine.join("robot.toml"))?.response.ok_or("no response")?;
    assert!((found.dead_time_s - dead_time_s).abs() < 0.015, "{found:?} {dead_time_s}");
    assert!(found.gain.iter().all(|gain| (gain - 1.0).abs() < 0.05), "{found:?}");
    for file in ["identified/report.html", "both.html"] {
        assert!(fs::read_to_string(mine.join(file))?.contains("<svg"), "{file}");
    }

    // Each velocity moved the robot in its own direction.
    let signs = Log::read(&[mine.join("signs")], &Topics::default())?;
    let last = signs.stretches.iter().flatten().last().ok_or("no state")?;
    assert!(last.pose.iter().all(|it| *it > 0.05), "{:?}", last.pose);

    // The runs were on plans alone, and the last ones with the period that was recommended.
    let tuned = Scenario::named(&mine, "scenario+eight+tuned", None, &[])?;
    for run in ["first", "second", "third"] {
        let summary = summary(&mine.join(run))?;
        assert_eq!(summary["periods_missed"], 0, "{run}: {summary}");
        assert!(summary["snapshots_adopted"].as_u64() > Some(0), "{run}: {summary}");
        let rmse = summary["position_rmse_m"].as_f64();
        assert!(rmse.is_some_and(|rmse| rmse < 0.05), "{run}: {summary}");
    }
    let periods = summary(&mine.join("third"))?["periods"].as_f64();
    assert_eq!(periods, Some(40e3 / tuned.period_millis));
    Ok(())
}
