//! All numbers that the data tell of a robot, with names, for terminal, page and robot file.

use crate::fit::{Estimate, Estimated};
use crate::log::AXIS_NAMES;
use crate::parameter::Parameter;
use crate::reached::Reached;
use crate::sensors::{Measured, Sensors};
use robot::{AXES, Wheels};
use std::fmt::{self, Display, Formatter};

/// One number with its name.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// What it is.
    pub name: String,
    /// Its value and interval.
    pub measured: Measured,
    /// Its unit.
    pub unit: &'static str,
}

impl Number {
    fn new(name: impl Into<String>, measured: Measured, unit: &'static str) -> Self {
        Self { name: name.into(), measured, unit }
    }
}

impl Display for Number {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { name, measured: Measured { value, half_width }, unit } = self;
        write!(f, "{name:44} {value:9.4} ± {half_width:.4} {unit}")
    }
}

/// What is known of a robot.
#[derive(Debug, Clone, Copy)]
pub struct Known<'a> {
    /// The response.
    pub estimate: &'a Estimate,
    /// Accelerations.
    pub reached: &'a Reached,
    /// Sensors and wheels.
    pub sensors: &'a Sensors,
    /// Wheels of the robot file.
    pub wheels: &'a Wheels,
}

impl Known<'_> {
    /// The parameters of the response.
    pub fn response(&self) -> Vec<Number> {
        let parameters = self.estimate.parameters.iter();
        parameters
            .map(|found| {
                Number::new(found.parameter.to_string(), measured(found), found.parameter.unit())
            })
            .collect()
    }

    /// Coupling of the axes, as far as an interval excludes that there is none.
    pub fn coupling(&self) -> Vec<Number> {
        let is_coupling = |parameter: Parameter| match parameter {
            Parameter::Gain(axis, other) => axis != other,
            Parameter::Cross(..) => true,
            _ => false,
        };
        let found =
            self.estimate.parameters.iter().filter(|found| {
                is_coupling(found.parameter) && found.half_width < found.value.abs()
            });
        found
            .map(|found| {
                Number::new(found.parameter.to_string(), measured(found), found.parameter.unit())
            })
            .collect()
    }

    /// Input that moves an axis from rest: static friction, and the dead band of the drive.
    pub fn input_from_rest(&self, axis: usize) -> Option<Measured> {
        let terms = [(Parameter::Friction(axis), 1.0), (Parameter::Stiction(axis), 1.0)];
        let both = self.estimate.sum(&terms)?;
        let response = &self.estimate.response;
        // A velocity of the axis, and the input that asks for it.
        let value = response.breakaway()[axis] / response.gain[axis][axis];
        let half_width = value / both.value * both.half_width;
        Some(Measured { value, half_width }).filter(|_| half_width.is_finite() && half_width > 0.0)
    }

    /// What is not a parameter of the response: friction at standstill, accelerations, wheels and
    /// sensors.
    pub fn others(&self) -> Vec<Number> {
        let mut all = Vec::new();
        let of = |what: &str, axis: usize| format!("{what}, {}", AXIS_NAMES[axis]);
        let by_yaw = |axis: usize, planar, yaw| if axis < 2 { planar } else { yaw };
        for axis in 0..AXES {
            let input = self.input_from_rest(axis);
            let unit = by_yaw(axis, "m/s", "rad/s");
            all.extend(
                input.map(|it| Number::new(of("input that moves it from rest", axis), it, unit)),
            );
        }
        let Reached { acceleration, braking } = self.reached;
        for (what, reached) in [("acceleration", acceleration), ("deceleration", braking)] {
            for (axis, reached) in reached.iter().enumerate() {
                let unit = by_yaw(axis, "m/s²", "rad/s²");
                let name = of(&format!("{what} that was reached"), axis);
                all.extend(reached.map(|it| Number::new(name, it, unit)));
            }
        }
        let Sensors { velocity_noise, pose_noise, latency_s, per_wheels, .. } = self.sensors;
        let Sensors { wheel_radius_m, wheel_lever_m, .. } = self.sensors;
        for (axis, ratio) in per_wheels.iter().flatten().enumerate() {
            let name = of("velocity by poses per velocity by wheels", axis);
            all.extend(ratio.map(|it| Number::new(name, it, "1")));
        }
        let stated = |value: f64| format!("{value:.4} in the robot file");
        all.extend(wheel_radius_m.map(|it| {
            Number::new(format!("wheel radius ({})", stated(self.wheels.radius_m())), it, "m")
        }));
        all.extend(wheel_lever_m.map(|it| {
            Number::new(format!("lever of the wheels ({})", stated(self.wheels.lever_m())), it, "m")
        }));
        for (axis, noise) in velocity_noise.iter().enumerate() {
            let unit = by_yaw(axis, "m/s", "rad/s");
            all.push(Number::new(of("noise of the velocity", axis), *noise, unit));
        }
        for (axis, noise) in pose_noise.iter().enumerate() {
            let name = ["noise of x", "noise of y", "noise of the heading"][axis];
            all.push(Number::new(name, *noise, by_yaw(axis, "m", "rad")));
        }
        let name = "latency of the velocity behind the pose";
        all.extend(latency_s.map(|it| Number::new(name, it, "s")));
        all
    }
}

fn measured(found: &Estimated) -> Measured {
    Measured { value: found.value, half_width: found.half_width }
}
