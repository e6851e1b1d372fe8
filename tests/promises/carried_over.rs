//! Promise: the data of an earlier snapshot, of another robot file or of another robot, never makes
//! a model worse.

use graph::assembly::Assembly;
use graph::options::Options;
use identify::excitation::{Room, motion};
use identify::log::{Log, Sample};
use learner::data_set::fingerprint_of;
use learner::snapshot::{self, Label};
use model::learned::INPUTS;
use model::main_model::MainModel;
use offline::contender::Contender;
use offline::cross_validation::{Errors, errors};
use offline::periods::{Passage, passages};
use offline::training::Training;
use offline::verdict::Verdict;
use offline::work::Work;
use plant_sim::truth::{Truth, World};
use process::Run;
use promises::{Outcome, repository};
use protocol::message::ModelSnapshot;
use robot::Robot;
use std::error::Error;
use std::path::Path;

/// Robots with their simulated truth, as graph files.
const ROBOTS: [&str; 6] = [
    "deploy/graphs/local.toml",
    "deploy/worlds/robots/graphs/rosbot-xl.toml",
    "deploy/worlds/robots/graphs/panther-mecanum.toml",
    "deploy/worlds/robots/graphs/ridgeback.toml",
    "deploy/worlds/robots/graphs/linorobot2-mecanum.toml",
    "deploy/worlds/robots/graphs/omni-3.toml",
];

fn assembly(graph: &str) -> Result<Assembly, Box<dyn Error>> {
    Ok(Assembly::read(&Options::of_graph(&repository().join(graph)))?)
}

/// `duration_s` of excitation of the robot of `assembly` in the world of `truth`.
fn drive(assembly: &Assembly, truth: &Truth, duration_s: f64, seed: u64) -> Log {
    let (period_s, limits) = (1e-3 * assembly.scenario.period_millis, &assembly.robot.limits);
    let room = Room {
        size_m: [4.0, 4.0],
        speed_mps: 0.7 * limits.input_mps,
        yaw_rate_radps: 0.5 * limits.yaw_input_radps,
        acceleration: [2.0, 2.0, 4.0],
    };
    let mut world = World::new(truth, driver::Start::default(), seed);
    let points = motion(&room, duration_s, period_s, seed);
    let samples = points.windows(2).map(|pair| {
        let [from, to] = [pair[0].pose, pair[1].pose];
        let (sin, cos) = (0.5 * (from[2] + to[2])).sin_cos();
        let [x, y, yaw] = [0, 1, 2].map(|axis| (to[axis] - from[axis]) / period_s);
        let input = [cos * x + sin * y, cos * y - sin * x, yaw];
        world.advance(assembly.scenario.period_nanos(), input);
        let measured = world.measure();
        Sample {
            time_s: pair[1].time_s,
            pose: measured.pose,
            velocity: measured.velocity,
            input,
            wheel_speed: None,
        }
    });
    Log { period_s, stretches: vec![samples.collect()], ..Log::default() }
}

/// The settings of the robot of `assembly`.
fn settings(assembly: &Assembly) -> (learner::Settings, controller::Settings) {
    let links = assembly.links("none", Path::new(""));
    let run = Run::new("", assembly.scenario.period_nanos(), links);
    (assembly.learner(run.clone()), assembly.controller(run))
}

/// A snapshot of `log`, for the robot file of `assembly`.
fn learned(assembly: &Assembly, log: &Log) -> Result<ModelSnapshot, Box<dyn Error>> {
    let (learner, controller) = settings(assembly);
    let fitted =
        Training::<INPUTS>::new(&learner).fit(passages(log, &controller).iter().flatten())?;
    let label = Label {
        version: 1,
        fingerprint: fingerprint_of(&learner),
        plant_epoch: 0,
        trained_tick: 0,
        effective_tick: 0,
    };
    Ok(snapshot::write(&fitted, &label, &[])?)
}

/// Errors on `test` of models that were trained on `log` with and without `earlier`.
fn with_and_without(
    assembly: &Assembly,
    log: &Log,
    test: &Log,
    earlier: &(ModelSnapshot, MainModel),
) -> Result<[Errors; 2], Box<dyn Error>> {
    let (learner, controller) = settings(assembly);
    let (ours, test) = (passages(log, &controller), passages(test, &controller));
    let error = |earlier: Option<&(ModelSnapshot, MainModel)>| -> Result<Errors, Box<dyn Error>> {
        let work = Work { learner: &learner, controller: &controller, passages: &ours, earlier };
        let (training, _) = work.carry_over(Training::<INPUTS>::new(&learner))?;
        let model = training.fit(ours.iter().flatten())?.learned;
        let mut contender = Contender::new(&controller, Some(Box::new(model)), true);
        Ok(errors(&mut contender, &test as &[Passage]))
    };
    Ok([error(Some(earlier))?, error(None)?])
}

/// The robot file as it was before: slower, and with another gain.
fn earlier_file(robot: &Robot) -> Robot {
    let mut robot = *robot;
    if let Some(body) = &mut robot.body {
        (body.mass_kg, body.yaw_inertia_kg_m2) = (1.5 * body.mass_kg, 1.5 * body.yaw_inertia_kg_m2);
    }
    if let Some(response) = &mut robot.response {
        response.time_constant_s = response.time_constant_s.map(|constant| 1.5 * constant);
        response.gain = response.gain.map(|gain| 0.9 * gain);
    }
    robot
}

/// The snapshot of `robot` in the world of `truth`, and its main model.
fn earlier(
    assembly: &Assembly,
    robot: &Robot,
    truth: &Truth,
) -> Result<(ModelSnapshot, MainModel), Box<dyn Error>> {
    let assembly = Assembly { robot: *robot, ..assembly.clone() };
    let snapshot = learned(&assembly, &drive(&assembly, truth, 60.0, 1))?;
    Ok((snapshot, MainModel::new(robot, 1e-3 * assembly.scenario.period_millis)))
}

/// Ratio of the errors with the earlier data to those without, on other motion: for another robot
/// file of the same robot, and for a robot that has changed.
fn ratios(graph: &str, duration_s: f64) -> Result<[Verdict; 2], Box<dyn Error>> {
    let assembly = assembly(graph)?;
    let truth = assembly.scenario.truth.clone().ok_or("no truth")?;
    let log = drive(&assembly, &truth, duration_s, 2);
    let test = drive(&assembly, &truth, 60.0, 3);
    let before = earlier_file(&assembly.robot);
    let mut other = truth.clone();
    other.mass_kg *= 2.0;
    other.yaw_inertia_kg_m2 *= 2.0;
    other.motor_gain.iter_mut().take(1).for_each(|gain| *gain *= 0.6);
    let mut verdicts = Vec::new();
    for (robot, truth) in [(&before, &truth), (&assembly.robot, &other)] {
        let earlier = earlier(&assembly, robot, truth)?;
        let [with, without] = with_and_without(&assembly, &log, &test, &earlier)?;
        verdicts.push(Verdict::between(&with, &without));
    }
    verdicts.try_into().map_err(|_| "two".into())
}

#[test]
fn data_of_another_robot_file_or_of_a_changed_robot_do_no_harm() -> Outcome {
    for verdict in ratios(ROBOTS[1], 10.0)? {
        let [_, ten] = verdict.means();
        assert!(ten <= 1.05, "{verdict:?}");
    }
    Ok(())
}

#[test]
#[ignore = "a measurement of minutes; docs/identification.md has its figures"]
fn what_carried_data_bring_to_every_robot() -> Outcome {
    for graph in ROBOTS {
        for duration_s in [10.0, 30.0, 60.0] {
            let [file, robot] = ratios(graph, duration_s)?.map(|verdict| verdict.means());
            terminal::print(format_args!(
                "{graph} {duration_s} s: other file {:.2} {:.2}, changed robot {:.2} {:.2}",
                file[0], file[1], robot[0], robot[1]
            ));
        }
    }
    Ok(())
}
