//! The settings of a world, as in a scenario file.
//!
//! The default is the ideal value of the reference robot (the one that the reference scenario
//! *believes*). Other effects are off by default: zero, an empty list or an absent table. So a
//! scenario names only its differences.

use robot::{Robot, Wheels};
use serde::{Deserialize, Serialize};

/// The true robot and its world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Truth {
    /// m: mass of the robot with its wheels \[kg\].
    pub mass_kg: f64,
    /// `I_z`: inertia about the vertical axis \[kg m²\].
    pub yaw_inertia_kg_m2: f64,
    /// `I_ω`: inertia of one wheel with its motor about its axle \[kg m²\].
    pub wheel_inertia_kg_m2: f64,

    /// Kind and places of the wheels, as in a robot file.
    pub wheels: Wheels,

    /// f: torque against the wheel per speed of the wheel \[N m s/rad\].
    pub wheel_viscous_friction_nms: f64,
    /// μ: rolling friction per wheel load \[1\].
    pub rolling_friction: f64,
    /// `ω_s`: wheel speed at which rolling friction has reached tanh(1) of its value \[rad/s\].
    pub rolling_friction_speed_scale_radps: f64,
    /// Rolling friction of a wheel at standstill, as a multiple of that of a turning wheel; 1 is no
    /// stiction.
    pub breakaway_factor: f64,
    /// `ω_b`: wheel speed at which the extra friction has decayed to 1/e \[rad/s\].
    pub breakaway_speed_radps: f64,
    /// Air drag per squared speed \[N s²/m²\].
    pub drag_n_s2_per_m2: f64,

    /// γ: delivered torque of each motor per requested torque; 1 is a healthy motor, and the value
    /// of motors that are not listed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub motor_gain: Vec<f64>,
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
    /// `i_max`: largest requested current of a motor, in both directions \[A\].
    pub current_limit_a: f64,
    /// Time constant of the current's lag behind the request \[s\]; 0 is no lag.
    pub current_lag_s: f64,
    /// Largest target of the speed loop, in both directions \[rad/s\].
    pub wheel_speed_limit_radps: f64,
    /// Delay from the gate to the motors \[s\]; a multiple of 0.1 ms.
    pub command_delay_s: f64,
    /// Dead time that the driver reports to the controller \[s\]; 0 is a driver that knows of none.
    pub reported_delay_s: f64,

    /// The floor's inclination.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slope: Option<Slope>,
    /// A constant force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub push: Option<Push>,
    /// A bounded random force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub random_force: Option<RandomForce>,
    /// A load that is added during the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub payload: Option<Payload>,
    /// Wheels that can slip; absent, they never do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_slip: Option<WheelSlip>,
    /// Areas of different floor; where patches overlap, the first counts.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub patches: Vec<Patch>,
    /// Motor faults during the run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<Fault>,
    /// Times at which the whole floor is slippery; needs `wheel_slip`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub slippery: Vec<Slippery>,
    /// Sensors that are stuck for a time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub stuck: Vec<Stuck>,
    /// Times at which the emergency stop is pressed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub pressed: Vec<Pressed>,
    /// Noise and quantisation of the sensors.
    pub sensor: Sensor,
}

impl Default for Truth {
    fn default() -> Self {
        Self {
            mass_kg: 15.0,
            yaw_inertia_kg_m2: 0.6,
            wheel_inertia_kg_m2: 2e-3,
            wheels: Robot::example().wheels,
            wheel_viscous_friction_nms: 2e-3,
            rolling_friction: 0.02,
            rolling_friction_speed_scale_radps: 0.5,
            breakaway_factor: 1.0,
            breakaway_speed_radps: 3.0,
            drag_n_s2_per_m2: 0.0,
            motor_gain: Vec::new(),
            pole_pairs: 4.0,
            torque_constant_nm_per_a: 0.04,
            speed_loop_gain_a_s_per_rad: 0.5,
            speed_loop_integral_a_per_rad: 0.0,
            deadband_radps: 0.0,
            current_limit_a: 20.0,
            current_lag_s: 0.0,
            wheel_speed_limit_radps: 500.0,
            command_delay_s: 0.0,
            reported_delay_s: 0.0,
            slope: None,
            push: None,
            random_force: None,
            payload: None,
            wheel_slip: None,
            patches: Vec::new(),
            faults: Vec::new(),
            slippery: Vec::new(),
            stuck: Vec::new(),
            pressed: Vec::new(),
            sensor: Sensor::default(),
        }
    }
}

/// The floor's inclination.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slope {
    /// Angle between the floor and the horizontal \[rad\].
    pub angle_rad: f64,
    /// World heading of the downhill direction \[rad\].
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
    /// Begin \[s\].
    pub from_s: f64,
    /// End \[s\]; absent is never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// A bounded random force at the robot's centre, fixed in the body.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RandomForce {
    /// Largest force along x and along y, in both directions \[N\].
    pub bound_n: f64,
    /// Largest torque about the vertical axis, in both directions \[N m\].
    pub bound_nm: f64,
    /// Correlation time of the force \[s\]; 0 is a new force every millisecond.
    pub correlation_s: f64,
}

/// A load on the robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Payload {
    /// Mass \[kg\].
    pub mass_kg: f64,
    /// Inertia about its own vertical axis \[kg m²\].
    #[serde(default)]
    pub yaw_inertia_kg_m2: f64,
    /// Position, forward and left of the robot's centre \[m\].
    #[serde(default)]
    pub offset_m: [f64; 2],
    /// Time at which it is added \[s\].
    #[serde(default)]
    pub at_s: f64,
    /// Time at which it is removed \[s\]; absent is never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// Wheels whose force on the floor is limited by their grip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WheelSlip {
    /// c: largest force along a roller's axis, per wheel load \[1\].
    pub grip: f64,
    /// `v_s`: rim speed against the floor at which the force is tanh(1) of its largest value
    /// \[m/s\].
    #[serde(default = "slip_speed_scale_mps")]
    pub slip_speed_scale_mps: f64,
}

fn slip_speed_scale_mps() -> f64 {
    0.05
}

/// A rectangle of different floor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// Smallest x and y in the world \[m\].
    pub from_m: [f64; 2],
    /// Largest x and y in the world \[m\].
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

/// A different motor gain, until its end or until another fault of the same wheel begins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// Wheel of the motor.
    pub wheel: Wheel,
    /// Replaces the wheel's `motor_gain`; 0 is a dead motor.
    pub gain: f64,
    /// Begin \[s\].
    pub at_s: f64,
    /// End \[s\]; absent is never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// A floor that is slippery everywhere for a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slippery {
    /// Grip, as a multiple of that at other times, at most 1.
    pub grip_factor: f64,
    /// Begin \[s\].
    pub from_s: f64,
    /// End \[s\]; absent is never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// A sensor that repeats for a time the value of the beginning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stuck {
    /// The sensor.
    pub sensor: StuckSensor,
    /// Begin \[s\].
    pub from_s: f64,
    /// End \[s\]; absent is never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// An emergency stop that is pressed for a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pressed {
    /// Begin \[s\].
    pub from_s: f64,
    /// End \[s\]; absent is never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
}

/// Values that can be stuck.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StuckSensor {
    /// x, y and heading in the world.
    Pose,
    /// Velocity forward and left, and yaw rate.
    Velocity,
    /// All measured values.
    Everything,
}

/// A wheel by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wheel {
    /// The first wheel.
    #[serde(alias = "wheel-1")]
    FrontRight,
    /// The second wheel.
    #[serde(alias = "wheel-2")]
    FrontLeft,
    /// The third wheel.
    #[serde(alias = "wheel-3")]
    RearLeft,
    /// The fourth wheel.
    #[serde(alias = "wheel-4")]
    RearRight,
}

impl Wheel {
    /// Its index in an array of wheels.
    pub const fn index(self) -> usize {
        match self {
            Self::FrontRight => 0,
            Self::FrontLeft => 1,
            Self::RearLeft => 2,
            Self::RearRight => 3,
        }
    }
}

/// Gaussian noise (standard deviation), then rounding to a step; 0 is off.
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
    fn settings_that_a_scenario_omits_are_those_of_the_default_robot() {
        let named = Truth { mass_kg: 22.0, drag_n_s2_per_m2: 0.5, ..Truth::default() };
        assert_eq!(read([("mass_kg", 22.0), ("drag_n_s2_per_m2", 0.5)]), Ok(named));
        assert_eq!(read([]), Ok(Truth::default()));
    }

    #[test]
    fn the_error_names_an_unknown_setting() {
        let refused = read([("mas_kg", 22.0)]).map_err(|error| error.to_string());
        assert!(refused.is_err_and(|message| message.contains("`mas_kg`")));
    }
}
