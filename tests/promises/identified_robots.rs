//! Promise: controllers with an identified robot file drive as with the true parameters.

use promises::{Outcome, binaries, copy_folder, repository, text_of};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;
use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::Command;

const ROBOTS: u64 = 20;
/// Seeds of the noise: a robot at its limits has errors that differ by a factor of five.
const SEEDS: u32 = 4;
const REFERENCES: [&str; 4] = ["circle", "eight", "slalom", "square"];

/// What a robot file can state of a hidden robot.
struct Hidden {
    /// The table `[truth]`.
    truth: String,
    gain: f64,
    planar_time_constant_s: f64,
    yaw_time_constant_s: f64,
    dead_time_s: f64,
}

/// The robot of the paper with another mass, friction, motor and delay, as in the campaign of
/// `identify`.
fn hidden(seed: u64) -> Hidden {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mass = 22.0 * 2.0_f64.powf(random.random_range(-1.0..1.0));
    let inertia = 0.04 * mass;
    let mut motors = [1.0; 4];
    motors[random.random_range(0..4)] = random.random_range(0.6..1.0);
    let viscous: f64 = random.random_range(1e-3..6e-3);
    let rolling: f64 = random.random_range(0.01..0.06);
    let dead_time_s = (random.random_range(0.0..0.15_f64) * 1e4).round() * 1e-4;
    // Torque per speed error of a wheel: pole pairs, torque constant, gain of the speed loop.
    let stiffness = 4.0 * 0.04 * 0.5 * motors.iter().sum::<f64>() / 4.0;
    let (radius, lever, wheel_inertia) = (0.05_f64, 0.275_f64, 2e-3);
    let per_wheel = |inertia: f64| inertia * radius * radius / 4.0 + wheel_inertia;
    let truth = format!(
        "[truth]\nmass_kg = {mass}\nyaw_inertia_kg_m2 = {inertia}\n\
         wheel_inertia_kg_m2 = {wheel_inertia}\nwheel_viscous_friction_nms = {viscous}\n\
         rolling_friction = {rolling}\ndrag_n_s2_per_m2 = 0.5\nmotor_gain = {motors:?}\n\
         command_delay_s = {dead_time_s}\n\
         [truth.random_force]\nbound_n = 3.0\nbound_nm = 0.3\ncorrelation_s = 0.2\n"
    );
    Hidden {
        truth,
        gain: stiffness / (stiffness + viscous),
        planar_time_constant_s: per_wheel(mass) / (stiffness + viscous),
        yaw_time_constant_s: per_wheel(inertia / lever.powi(2)) / (stiffness + viscous),
        dead_time_s,
    }
}

/// The part of a robot file before `[body]`, and from `[limits]` on: without masses and motors.
fn without_motors(robot: &str) -> Result<[&str; 2], Box<dyn Error>> {
    let (wheels, rest) = robot.split_once("[body]").ok_or("no [body]")?;
    let limits = rest.find("[limits]").ok_or("no [limits]")?;
    Ok([wheels, &rest[limits..]])
}

/// Writes the files of robot `number` to `home`, and drives and identifies it.
fn identify(home: &Path, number: u64) -> Outcome {
    let hidden = hidden(number);
    let world = home.join("deploy/worlds/random");
    let robots = home.join("deploy/robots");
    let sheet = fs::read_to_string(robots.join("mecanum.toml"))?;
    let [wheels, limits] = without_motors(&sheet)?;
    let response = |gain: f64, planar: f64, yaw: f64, dead_time: f64| {
        format!(
            "[response]\ngain = [{gain}, {gain}, {gain}]\n\
             time_constant_s = [{planar}, {planar}, {yaw}]\ndead_time_s = {dead_time}\n"
        )
    };
    // What one would guess of a base of that size.
    let guess = format!("{wheels}{}{limits}", response(1.0, 0.15, 0.15, 0.0));
    let exact = response(
        hidden.gain,
        hidden.planar_time_constant_s,
        hidden.yaw_time_constant_s,
        hidden.dead_time_s,
    );
    let exact = format!("{wheels}{exact}{limits}");
    // The settings of the robots of deploy/worlds/robots, with another truth.
    let scenario = fs::read_to_string(home.join("deploy/worlds/robots/rosbot-xl.toml"))?;
    let until = scenario.find("# The robot as it is").ok_or("no truth")?;
    let sensor = scenario.find("[truth.sensor]").ok_or("no sensor")?;
    let scenario = scenario[..until].replace("speed_factor = 0.35", "speed_factor = 1.0")
        + &hidden.truth
        + &scenario[sensor..];
    let graph = fs::read_to_string(home.join("deploy/worlds/robots/graphs/rosbot-xl.toml"))?;
    for (kind, file) in [("guess", &guess), ("true", &exact)] {
        let name = format!("r{number}-{kind}");
        fs::write(robots.join(format!("{name}.toml")), file)?;
        fs::write(world.join(format!("{name}.toml")), &scenario)?;
        let graph = graph.replace("rosbot-xl", &name);
        fs::write(world.join(format!("graphs/{name}.toml")), graph)?;
    }
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.current_dir(home).args(["identify", "--pace", "lock-step", "--area", "3x3"]);
    command.args(["--set", "period_millis=20", "--seed", &number.to_string()]);
    command.arg("--drive").arg(world.join(format!("graphs/r{number}-guess.toml")));
    let out = home.join(format!("r{number}"));
    text_of(command.arg("--out").arg(&out))?;
    let name = format!("r{number}-found");
    fs::copy(out.join("robot.toml"), robots.join(format!("{name}.toml")))?;
    fs::write(world.join(format!("{name}.toml")), &scenario)?;
    fs::write(world.join(format!("graphs/{name}.toml")), graph.replace("rosbot-xl", &name))?;
    Ok(())
}

/// ```sh
/// cargo test --release -p promises --test promises identified_robots:: -- --ignored --nocapture
/// ```
#[test]
#[ignore = "a campaign of minutes: docs/identification.md has its figures"]
#[expect(clippy::print_stdout, reason = "its table is read by people")]
fn figures_of_twenty_random_robots() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let home = home.path();
    copy_folder(&repository().join("deploy"), &home.join("deploy"))?;
    let world = home.join("deploy/worlds/random");
    fs::create_dir_all(world.join("graphs"))?;
    copy_folder(&home.join("deploy/worlds/robots/variants"), &world.join("variants"))?;
    for number in 1..=ROBOTS {
        identify(home, number).map_err(|error| format!("robot {number}: {error}"))?;
    }
    let kinds = ["guess", "true", "found"];
    let names: Vec<String> =
        (1..=ROBOTS).flat_map(|number| kinds.map(|kind| format!("r{number}-{kind}"))).collect();
    fs::write(
        world.join("grid.toml"),
        format!("robots = {names:?}\nreferences = {REFERENCES:?}\nconditions = [\"nominal\"]\n"),
    )?;
    let mut command = Command::new(binaries()?.join("coxswain"));
    let rows = home.join("rows.jsonl");
    command.current_dir(home).args(["experiment", "compare", "--world", "random"]);
    command.args(["--profile", "agile", "--start", "cold", "--seeds", &SEEDS.to_string()]);
    command.args(["--controllers", "mpc+observer,gpr-mpc+observer", "--json"]).arg(&rows);
    text_of(&mut command)?;

    // Position RMSE, mean of the seeds [mm], by controller, robot and reference, and kind.
    let mut cells: BTreeMap<(String, String), BTreeMap<String, f64>> = BTreeMap::new();
    for line in fs::read_to_string(&rows)?.lines() {
        let row: Value = serde_json::from_str(line)?;
        let text = |key: &str| row[key].as_str().map(str::to_owned).ok_or("a name is missing");
        let scenario = text("scenario")?;
        let (number, rest) = scenario.split_once('-').ok_or("no number")?;
        let (kind, reference) = rest.split_once('+').ok_or("no reference")?;
        let rmse = row["position_rmse_m"].as_f64().ok_or("a figure is missing")?;
        let cell = (text("controller")?, format!("{number} {reference}"));
        let of_kinds = cells.entry(cell).or_default();
        *of_kinds.entry(kind.to_owned()).or_default() += 1e3 * rmse / f64::from(SEEDS);
    }
    for ((controller, cell), kinds) in &cells {
        let [guess, exact, found] = ["guess", "true", "found"].map(|kind| kinds[kind]);
        let ratio = found / exact;
        println!("{controller} {cell}: {guess:.2} {exact:.2} {found:.2} mm, ratio {ratio:.3}");
    }
    for controller in ["mpc+observer", "gpr-mpc+observer"] {
        let of = cells.iter().filter(|((name, _), _)| name == controller);
        let mut ratios: Vec<f64> = of.map(|(_, kinds)| kinds["found"] / kinds["true"]).collect();
        ratios.sort_by(f64::total_cmp);
        let above = ratios.iter().filter(|ratio| **ratio > 1.15).count();
        let mean = ratios.iter().map(|ratio| ratio.ln()).sum::<f64>() / ratios.len() as f64;
        println!(
            "{controller}: geometric mean {:.3}, largest {:.3}, {above} of {} above 1.15",
            mean.exp(),
            ratios.last().ok_or("no cell")?,
            ratios.len()
        );
        assert_eq!((ratios.len() as u64, above), (4 * ROBOTS, 0), "{controller}");
    }
    Ok(())
}
