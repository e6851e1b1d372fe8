//! The settings of a world, as a scenario names them.
//!
//! What is left out has the reference robot's ideal value (the one that the reference scenario *believes*), and no effect
//! beyond the plain robot: zero, an empty list or an absent table is off. A scenario so names only what it makes different.

use serde::{Deserialize, Serialize};

/// What the robot and its world really are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Truth {
    /// m: mass of the robot with its wheels \[kg\].
    pub mass_kg: f64,
    /// `I_z`: inertia about the vertical axis \[kg m²\].
    pub yaw_inertia_kg_m2: f64,
    /// `I_ω`: inertia of one wheel with its motor about its axle \[kg m²\].
    pub wheel_inertia_kg_m2: f64,

    /// r: wheel radius \[m\].
    pub wheel_radius_m: f64,
    /// a: from the centre to a wheel, sideways \[m\].
    pub half_track_m: f64,
    /// b: from the centre to a wheel, forward \[m\].
    pub half_wheelbase_m: f64,

    /// f: torque against the wheel per speed of the wheel \[N m s/rad\].
    pub wheel_viscous_friction_nms: f64,
    /// μ: rolling friction, as a part of the wheel's load \[1\].
    pub rolling_friction: f64,
    /// `ω_s`: wheel speed at which rolling friction has reached tanh(1) of its value \[rad/s\].
    pub rolling_friction_speed_scale_radps: f64,
    /// Rolling friction of a wheel that hardly turns, as a multiple of that of one that does; 1 is no stiction.
    pub breakaway_factor: f64,
    /// `ω_b`: wheel speed at which 1/e of what breaking away takes more is left \[rad/s\].
    pub breakaway_speed_radps: f64,
    /// Air drag per squared speed \[N s²/m²\].
    pub drag_n_s2_per_m2: f64,

    /// Part of its torque that each motor really gives; 1 is a healthy one.
    pub motor_gain: [f64; 4],
    /// p: pole pairs.
    pub pole_pairs: f64,
    /// `K_T`: torque per current and pole pair \[N m/A\].
    pub torque_constant_nm_per_a: f64,
    /// `k_p` of the speed loop: current per speed error \[A s/rad\].
    pub speed_loop_gain_a_s_per_rad: f64,
    /// `k_i` of the speed loop: current per integrated speed error \[A/rad\].
    pub speed_loop_integral_a_per_rad: f64,
    /// Speed error that the speed loop ignores \[rad/s\].
    pub deadband_radps: f64,
    /// `i_max`: the most current that a motor is asked for, either way \[A\].
    pub current_limit_a: f64,
    /// Time constant with which the current follows what is asked \[s\]; 0 is at once.
    pub current_lag_s: f64,
    /// The fastest wheel speed that the speed loop takes as a target, either way \[rad/s\].
    pub wheel_speed_limit_radps: f64,
    /// From the gate to the motors \[s\]; a multiple of 0.1 ms.
    pub command_delay_s: f64,

    /// The floor's inclination.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slope: Option<Slope>,
    /// A constant force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub push: Option<Push>,
    /// A bounded random force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub random_force: Option<RandomForce>,
    /// A load that comes on in the course of the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub payload: Option<Payload>,
    /// Wheels that can slip; without it they never do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_slip: Option<WheelSlip>,
    /// Where the floor is different; of overlapping patches the first counts.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub patches: Vec<Patch>,
    /// Motors that change in the course of the run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<Fault>,
    /// When the whole floor is slippery; needs `wheel_slip`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub slippery: Vec<Slippery>,
    /// When sensors stand still.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub stuck: Vec<Stuck>,
    /// What the sensors add to the truth.
    pub sensor: Sensor,
}

impl Default for Truth {
    fn default() -> Self {
        Self {
            mass_kg: 15.0,
            yaw_inertia_kg_m2: 0.6,
            wheel_inertia_kg_m2: 2e-3,
            wheel_radius_m: 0.05,
            half_track_m: 0.15,
            half_wheelbase_m: 0.125,
            wheel_viscous_friction_nms: 2e-3,
            rolling_friction: 0.02,
            rolling_friction_speed_scale_radps: 0.5,
            breakaway_factor: 1.0,
            breakaway_speed_radps: 3.0,
            drag_n_s2_per_m2: 0.0,
            motor_gain: [1.0; 4],
            pole_pairs: 4.0,
            torque_constant_nm_per_a: 0.04,
            speed_loop_gain_a_s_per_rad: 0.5,
            speed_loop_integral_a_per_rad: 0.0,
            deadband_radps: 0.0,
            current_limit_a: 20.0,
            current_lag_s: 0.0,
            wheel_speed_limit_radps: 500.0,
            command_delay_s: 0.0,
            slope: None,
            push: None,
            random_force: None,
            payload: None,
            wheel_slip: None,
            patches: Vec::new(),
            faults: Vec::new(),
            slippery: Vec::new(),
            stuck: Vec::new(),
            sensor: Sensor::default(),
        }
    }
}

/// The floor's inclination.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slope {
    /// Between the floor and the horizontal \[rad\].
    pub angle_rad: f64,
    /// World heading of the way down \[rad\].
    #[serde(default)]
    pub direction_rad: f64,
}

/// A constant force at the robot's centre, fixed in the world.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Push {
    /// In the world's x and y \[N\].
    pub force_n: [f64; 2],
    /// About the vertical axis, counter-clockwise \[N m\].
    pub torque_nm: f64,
    /// When it begins \[s\].
    pub from_s: f64,
    /// When it ends \[s\]; absent is never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// A bounded random force at the robot's centre, fixed in the body.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RandomForce {
    /// The most along x and along y, either way \[N\].
    pub bound_n: f64,
    /// The most about the vertical axis, either way \[N m\].
    pub bound_nm: f64,
    /// Time over which the force forgets \[s\]; 0 is a new one every millisecond.
    pub correlation_s: f64,
}

/// A load that comes on, and moves as the robot does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Payload {
    /// Mass \[kg\].
    pub mass_kg: f64,
    /// Inertia about its own vertical axis \[kg m²\].
    #[serde(default)]
    pub yaw_inertia_kg_m2: f64,
    /// Where it lies: forward and left of the robot's centre \[m\].
    #[serde(default)]
    pub offset_m: [f64; 2],
    /// When it comes on \[s\].
    #[serde(default)]
    pub at_s: f64,
    /// When it is taken off \[s\]; absent is never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// Wheels that push the floor only as hard as they grip it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WheelSlip {
    /// The most force along a roller's axis, as a part of the wheel's load \[1\].
    pub grip: f64,
    /// Rim speed against the floor at which the force has reached tanh(1) of its most \[m/s\].
    #[serde(default = "slip_speed_scale_mps")]
    pub slip_speed_scale_mps: f64,
}

fn slip_speed_scale_mps() -> f64 {
    0.05
}

/// A rectangle of floor that is different, to the wheels that stand on it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// Its least x and y in the world \[m\].
    pub from_m: [f64; 2],
    /// Its largest x and y in the world \[m\].
    pub to_m: [f64; 2],
    /// Rolling friction there, as a multiple of that elsewhere.
    #[serde(default = "unchanged")]
    pub friction_factor: f64,
    /// Grip there, as a multiple of that elsewhere; needs `wheel_slip`.
    #[serde(default = "unchanged")]
    pub grip_factor: f64,
}

fn unchanged() -> f64 {
    1.0
}

/// A motor's gain from some time on, until that is over or another fault of the same wheel begins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// Whose motor.
    pub wheel: Wheel,
    /// What takes the place of its `motor_gain`; 0 is a dead motor.
    pub gain: f64,
    /// From when on \[s\].
    pub at_s: f64,
    /// When it is over \[s\]; absent is never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// A floor that is slippery everywhere for a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slippery {
    /// Grip, as a multiple of that at other times, at most 1.
    pub grip_factor: f64,
    /// From when on \[s\].
    pub from_s: f64,
    /// Until when \[s\]; absent is for ever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// A sensor that shows for a time what it showed when that began.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stuck {
    /// Which one.
    pub sensor: StuckSensor,
    /// From when on \[s\].
    pub from_s: f64,
    /// Until when \[s\]; absent is for ever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// What stands still.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StuckSensor {
    /// x, y and heading in the world.
    Pose,
    /// Velocity forward and left, and yaw rate.
    Velocity,
    /// Everything that is measured.
    Everything,
}

/// A wheel by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wheel {
    /// Wheel 0.
    FrontRight,
    /// Wheel 1.
    FrontLeft,
    /// Wheel 2.
    RearLeft,
    /// Wheel 3.
    RearRight,
}

impl Wheel {
    /// Its place in an array of wheels.
    pub const fn index(self) -> usize {
        match self {
            Self::FrontRight => 0,
            Self::FrontLeft => 1,
            Self::RearLeft => 2,
            Self::RearRight => 3,
        }
    }
}

/// What the sensors add to the truth: Gaussian noise (standard deviation), then rounding to a step; 0 is off.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sensor {
    /// Noise of x and of y in the world \[m\].
    pub position_noise_m: f64,
    /// Noise of the heading \[rad\].
    pub heading_noise_rad: f64,
    /// Noise of the velocity forward and left \[m/s\].
    pub velocity_noise_mps: f64,
    /// Noise of the yaw rate \[rad/s\].
    pub yaw_rate_noise_radps: f64,
    /// Noise of each wheel's speed \[rad/s\].
    pub wheel_speed_noise_radps: f64,
    /// Noise of each motor's current \[A\].
    pub current_noise_a: f64,
    /// Step of x and of y in the world \[m\].
    pub position_step_m: f64,
    /// Step of the heading \[rad\].
    pub heading_step_rad: f64,
    /// Step of the velocity forward and left \[m/s\].
    pub velocity_step_mps: f64,
    /// Step of the yaw rate \[rad/s\].
    pub yaw_rate_step_radps: f64,
    /// Step of each wheel's speed \[rad/s\].
    pub wheel_speed_step_radps: f64,
    /// Step of each motor's current \[A\].
    pub current_step_a: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::value::{Error, MapDeserializer};

    fn read<const N: usize>(settings: [(&str, f64); N]) -> Result<Truth, Error> {
        Truth::deserialize(MapDeserializer::new(settings.into_iter()))
    }

    #[test]
    fn what_a_scenario_leaves_out_is_the_plain_robot() {
        let named = Truth { mass_kg: 22.0, drag_n_s2_per_m2: 0.5, ..Truth::default() };
        assert_eq!(read([("mass_kg", 22.0), ("drag_n_s2_per_m2", 0.5)]), Ok(named));
        assert_eq!(read([]), Ok(Truth::default()));
    }

    #[test]
    fn a_setting_that_is_not_known_is_refused_by_name() {
        let refused = read([("mas_kg", 22.0)]).map_err(|error| error.to_string());
        assert!(refused.is_err_and(|message| message.contains("`mas_kg`")));
    }
}
