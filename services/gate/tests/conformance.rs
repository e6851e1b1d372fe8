//! Promise: the gate meets the duties of a driver in `protocol/WIRE.md`. Drivers in other languages
//! are tested with the same vectors.

use gate::{Bounds, Gate, Order};
use protocol::message::{Command, ObstacleSource, Reason, TAIL_MAX};
use robot::{Footprint, Map, Obstacle, Point, Response, Robot, Shape, Velocity, Wheels};
use serde::Deserialize;
use std::error::Error;
use std::fs;
use std::path::Path;

type Outcome = Result<(), Box<dyn Error>>;

const NANOS_PER_MS: u64 = 1_000_000;

#[derive(Deserialize)]
struct File {
    version: u16,
    period_ms: u64,
    plant_epoch: u64,
    robot: Limits,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Limits {
    input: Velocity,
    rate: Velocity,
    brake: Velocity,
    wheel_speed: f64,
    wheels: Wheels,
    /// Length, width and clearance.
    footprint: [f64; 3],
    response: f64,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    #[serde(default = "yes")]
    armed: bool,
    /// In place of those of the robot.
    wheels: Option<Wheels>,
    map: Option<Map>,
    events: Vec<Event>,
}

fn yes() -> bool {
    true
}

#[derive(Debug, Deserialize)]
struct Event {
    at_ms: u64,
    #[serde(flatten)]
    what: What,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum What {
    Begin(Begin),
    Command {
        command: Answer,
        verdict: u32,
    },
    Output {
        output: Velocity,
    },
    Order {
        order: String,
        followed: bool,
    },
    Estop {
        estop: bool,
    },
    Obstacles {
        obstacles: Vec<Seen>,
        source: usize,
        valid_ms: u64,
    },
    NotFinite {
        #[serde(rename = "not_finite")]
        _stands: bool,
    },
}

#[derive(Debug, Deserialize)]
struct Begin {
    publish: u64,
    pose: Option<[f64; 3]>,
    velocity: Option<Velocity>,
    #[serde(flatten)]
    past: Option<Past>,
}

/// An obstacle of a list.
#[derive(Debug, Deserialize)]
struct Seen {
    corners_m: Vec<Point>,
    radius_m: f64,
    velocity_mps: Point,
}

/// Published figures of the past period.
#[derive(Debug, Deserialize)]
struct Past {
    fallback_level: u32,
    reason: u32,
    gate: u32,
    stop: u32,
    refused: u64,
    input: Velocity,
}

#[derive(Debug, Deserialize)]
struct Answer {
    epoch: u64,
    writer: u64,
    tick: u64,
    plant_epoch: u64,
    fallback_level: u32,
    stop: u32,
    input: [Option<f64>; 3],
    tail: Vec<[Option<f64>; 3]>,
}

impl Answer {
    fn command(&self) -> Command {
        let numbers = |row: &[Option<f64>; 3]| row.map(|value| value.unwrap_or(f64::NAN));
        let mut command: Command = bytemuck::Zeroable::zeroed();
        (command.stamp.epoch, command.stamp.writer) = (self.epoch, self.writer);
        (command.stamp.tick, command.plant_epoch) = (self.tick, self.plant_epoch);
        (command.fallback_level, command.stop, command.input) =
            (self.fallback_level, self.stop, numbers(&self.input));
        command.tail_len = self.tail.len().min(TAIL_MAX) as u32;
        command.tail.iter_mut().zip(&self.tail).for_each(|(slot, row)| *slot = numbers(row));
        command
    }
}

fn robot(limits: &Limits, wheels: &Wheels) -> Robot {
    let mut robot = Robot { wheels: *wheels, ..Robot::example() };
    let [length_m, width_m, clearance_m] = limits.footprint;
    robot.footprint = Some(Footprint { length_m, width_m, clearance_m });
    (robot.body, robot.drive) = (None, None);
    robot.response = Some(Response {
        time_constant_s: [limits.response; 3],
        wheel_speed_limit_radps: Some(limits.wheel_speed),
        ..Response::default()
    });
    let [input_mps, _, yaw_input_radps] = limits.input;
    let [input_rate_mps2, _, yaw_input_rate_radps2] = limits.rate;
    let [brake_mps2, _, yaw_brake_radps2] = limits.brake;
    robot.limits = robot::Limits {
        input_mps,
        yaw_input_radps,
        input_rate_mps2,
        yaw_input_rate_radps2,
        brake_mps2,
        yaw_brake_radps2,
        ..robot.limits
    };
    robot
}

/// A gate whose output is summed over time.
struct Driven<'a> {
    name: &'a str,
    gate: Gate,
    now_ms: u64,
    since_ms: u64,
    sum: Velocity,
}

impl Driven<'_> {
    fn advance(&mut self, until_ms: u64) {
        while self.now_ms < until_ms {
            let input = self.gate.decide(self.now_ms * NANOS_PER_MS).input;
            self.sum.iter_mut().zip(input).for_each(|(sum, value)| *sum += value);
            self.now_ms += 1;
        }
    }

    fn take(&mut self, event: &Event) {
        self.advance(event.at_ms);
        let now = event.at_ms * NANOS_PER_MS;
        match &event.what {
            What::Begin(begin) => self.begin(begin, now, event),
            What::Command { command, verdict } => {
                let found = self.gate.offer(&command.command(), now).err();
                let found = found.unwrap_or(Reason::None).code();
                assert_eq!(found, *verdict, "{event:?}, {}", self.name);
            }
            What::Output { output } => {
                let found = self.gate.decide(now).input;
                assert!(close(&found, output, 0.02), "{found:?}: {event:?}, {}", self.name);
            }
            What::Order { order, followed } => {
                let order = Order::ALL.into_iter().find(|known| known.name() == order);
                let found = order.map(|order| self.gate.order(order).is_ok());
                assert_eq!(found, Some(*followed), "{event:?}, {}", self.name);
            }
            What::Obstacles { obstacles, source, valid_ms } => {
                let seen = |one: &Seen| {
                    let shape = Shape::hull(&one.corners_m, one.radius_m).ok()?;
                    Some(Obstacle { shape, velocity_mps: one.velocity_mps })
                };
                let list: Vec<Obstacle> = obstacles.iter().filter_map(seen).collect();
                let source = [ObstacleSource::Robot, ObstacleSource::Planner][*source];
                let valid = valid_ms * NANOS_PER_MS;
                assert_eq!(self.gate.see_obstacles(source, &list, now, valid), Ok(()));
            }
            What::Estop { estop } => self.gate.set_estop(*estop),
            What::NotFinite { .. } => self.gate.stop(Reason::BadState),
        }
    }

    fn begin(&mut self, begin: &Begin, now: u64, event: &Event) {
        if let Some(past) = &begin.past {
            let (fallback_level, reason) = self.gate.end_period(now);
            let machine = self.gate.machine();
            let found = (fallback_level.code(), reason.code(), machine.state().code());
            assert_eq!(
                found,
                (past.fallback_level, past.reason, past.gate),
                "{event:?}, {}",
                self.name
            );
            let found = (machine.stop_reason().code(), self.gate.refused());
            assert_eq!(found, (past.stop, past.refused), "{event:?}, {}", self.name);
            let mean = self.sum.map(|sum| sum / (self.now_ms - self.since_ms) as f64);
            assert!(close(&mean, &past.input, 0.01), "{mean:?}: {event:?}, {}", self.name);
        }
        (self.sum, self.since_ms) = ([0.0; 3], self.now_ms);
        self.gate.begin_period(begin.publish, now);
        if let (Some(pose), Some(velocity)) = (&begin.pose, &begin.velocity) {
            self.gate.see_pose(pose, velocity);
        }
    }
}

fn close(found: &Velocity, expected: &Velocity, within: f64) -> bool {
    found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= within)
}

#[test]
fn the_gate_conforms_to_the_vectors() -> Outcome {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../protocol/vectors/gate.json");
    let file: File = serde_json::from_str(&fs::read_to_string(path)?)?;
    assert_eq!(file.version, protocol::VERSION);
    for case in &file.cases {
        let wheels = case.wheels.as_ref().unwrap_or(&file.robot.wheels);
        let robot = robot(&file.robot, wheels);
        let bounds = Bounds::new(&robot, file.period_ms * NANOS_PER_MS, 0);
        let gate = Gate::new(bounds, file.plant_epoch);
        let surroundings = case.map.as_ref().map(Map::surroundings).transpose()?;
        let gate = match &surroundings {
            Some(surroundings) => gate.among(surroundings, &robot),
            None => gate,
        };
        let gate = if case.armed { gate } else { gate.disarmed() };
        let mut driven = Driven { name: &case.name, gate, now_ms: 0, since_ms: 0, sum: [0.0; 3] };
        for event in &case.events {
            driven.take(event);
        }
    }
    Ok(())
}
