//! One omnidirectional base: wheels, response and limits, as in a robot file.

use crate::{Shape, TrackingLimit, Velocity, Wheels};
use serde::{Deserialize, Serialize};

/// Smallest value of a positive parameter. Between this and [`LARGEST`] the main model of every
/// robot is finite.
const SMALLEST: f64 = 1e-9;
/// Largest parameter.
const LARGEST: f64 = 1e9;

/// One robot: the content of a robot file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Kind and places of the wheels.
    pub wheels: Wheels,
    /// Masses and frictions, as believed. With `drive`, in place of `response`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<Body>,
    /// Motors and their speed loop. With `body`, in place of `response`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drive: Option<Drive>,
    /// How the base responds to its inputs, in place of `body` and `drive`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<Response>,
    /// Limits of its inputs.
    pub limits: Limits,
    /// Outline on the floor; by default the rectangle around its wheels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub footprint: Option<Footprint>,
}

/// Outline on the floor: a rectangle around the origin of the body frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Footprint {
    /// Along x \[m\].
    pub length_m: f64,
    /// Along y \[m\].
    pub width_m: f64,
    /// Distance that it keeps from obstacles \[m\].
    #[serde(default = "usual_clearance")]
    pub clearance_m: f64,
}

impl Footprint {
    /// The rectangle, in the body frame.
    pub fn shape(&self) -> Shape {
        Shape::rectangle(self.length_m, self.width_m)
    }
}

/// Masses and frictions, as believed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// m \[kg\].
    pub mass_kg: f64,
    /// `I_z` about the vertical through the centre of mass \[kg m²\].
    pub yaw_inertia_kg_m2: f64,
    /// `I_ω` of one wheel with its rotor \[kg m²\].
    pub wheel_inertia_kg_m2: f64,
    /// f, viscous friction of one axle \[N m s\].
    pub axle_friction_nms: f64,
}

/// Motors and the speed loop of the ESC, i = `k_p` (`u_m` − ω).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// p, pole pairs.
    pub pole_pairs: f64,
    /// `K_T` \[N m/A\].
    pub torque_constant_nm_per_a: f64,
    /// `k_p` \[A s/rad\].
    pub speed_loop_gain_a_s_per_rad: f64,
    /// Largest motor current \[A\].
    pub current_limit_a: f64,
    /// Largest wheel speed \[rad/s\].
    pub wheel_speed_limit_radps: f64,
}

/// How the base responds to its inputs: what a data sheet or an experiment says of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Response {
    /// Steady velocity per input: forward, left, yaw \[1\].
    #[serde(default = "unchanged")]
    pub gain: Velocity,
    /// Time in which the velocity has made 1 − 1/e of a step: forward, left, yaw \[s\].
    pub time_constant_s: Velocity,
    /// Time from an input to the first motion \[s\]. The controller begins with it and identifies
    /// it further.
    #[serde(default)]
    pub dead_time_s: f64,
    /// Largest wheel speed, if it is known \[rad/s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wheel_speed_limit_radps: Option<f64>,
}

impl Default for Response {
    /// A base that follows its input within half a second.
    fn default() -> Self {
        Self {
            gain: unchanged(),
            time_constant_s: [0.5; 3],
            dead_time_s: 0.0,
            wheel_speed_limit_radps: None,
        }
    }
}

fn usual_clearance() -> f64 {
    0.05
}

fn unchanged() -> Velocity {
    [1.0; 3]
}

/// Limits of the inputs, independent of those of the wheels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Largest planar input, per axis \[m/s\].
    pub input_mps: f64,
    /// Largest yaw input \[rad/s\].
    pub yaw_input_radps: f64,
    /// Largest change of the planar input, per axis \[m/s²\].
    pub input_rate_mps2: f64,
    /// Largest change of the yaw input \[rad/s²\].
    pub yaw_input_rate_radps2: f64,
    /// Deceleration of the gate's braking ramp \[m/s²\].
    pub brake_mps2: f64,
    /// Yaw deceleration of the gate's braking ramp \[rad/s²\].
    pub yaw_brake_radps2: f64,
    /// Distance from the reference above which the robot is stopped \[m\]; by default
    /// [`Robot::TRACKING_DIAGONALS`] wheel diagonals.
    #[serde(default)]
    pub tracking_error_m: TrackingLimit,
    /// Heading error above which the robot is stopped \[rad\]; by default
    /// [`Robot::TRACKING_HEADING_RAD`].
    #[serde(default)]
    pub tracking_error_heading_rad: TrackingLimit,
}

/// A parameter that no robot can have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: expected {expected}")]
pub struct Impossible {
    /// Dotted path of the parameter.
    pub key: &'static str,
    /// Expected values.
    pub expected: &'static str,
}

impl Robot {
    /// The robot of the paper's scenario, as in `deploy/robots/mecanum.toml`: for examples, tests
    /// and benches.
    pub fn example() -> Self {
        Self {
            wheels: Wheels::example(),
            body: Some(Body {
                mass_kg: 15.0,
                yaw_inertia_kg_m2: 0.6,
                wheel_inertia_kg_m2: 2e-3,
                axle_friction_nms: 2e-3,
            }),
            drive: Some(Drive {
                pole_pairs: 4.0,
                torque_constant_nm_per_a: 0.04,
                speed_loop_gain_a_s_per_rad: 0.5,
                current_limit_a: 20.0,
                wheel_speed_limit_radps: 120.0,
            }),
            response: None,
            limits: Limits {
                input_mps: 5.0,
                yaw_input_radps: 6.0,
                input_rate_mps2: 60.0,
                yaw_input_rate_radps2: 120.0,
                brake_mps2: 8.0,
                yaw_brake_radps2: 16.0,
                tracking_error_m: TrackingLimit::Default,
                tracking_error_heading_rad: TrackingLimit::Default,
            },
            footprint: None,
        }
    }

    /// Default of `limits.tracking_error_m`, in wheel diagonals 2 √(a² + b²) (distance from a wheel
    /// to the opposite one).
    pub const TRACKING_DIAGONALS: f64 = 10.0;
    /// Default of `limits.tracking_error_heading_rad` \[rad\].
    pub const TRACKING_HEADING_RAD: f64 = 2.0;

    /// Outline on the floor: that of the robot file, or the rectangle around its wheels. A wheel
    /// reaches as far as its radius, along and across.
    pub fn footprint(&self) -> Footprint {
        self.footprint.unwrap_or_else(|| {
            let [ahead, side] = self.wheels.half_extent_m();
            let radius = self.wheels.radii_m().iter().copied().fold(0.0, f64::max);
            Footprint {
                length_m: 2.0 * (ahead + radius),
                width_m: 2.0 * (side + radius),
                clearance_m: usual_clearance(),
            }
        })
    }

    /// Distance from the reference above which the robot is stopped \[m\], if there is such a
    /// limit.
    pub fn tracking_error_m(&self) -> Option<f64> {
        let [ahead, side] = self.wheels.half_extent_m();
        let diagonal = 2.0 * ahead.hypot(side);
        self.limits.tracking_error_m.or(Self::TRACKING_DIAGONALS * diagonal)
    }

    /// Heading error above which the robot is stopped \[rad\], if there is such a limit.
    pub fn tracking_error_heading_rad(&self) -> Option<f64> {
        self.limits.tracking_error_heading_rad.or(Self::TRACKING_HEADING_RAD)
    }

    /// Largest current of a motor, if the robot file has motors \[A\].
    pub fn current_limit_a(&self) -> Option<f64> {
        self.drive.map(|drive| drive.current_limit_a)
    }

    /// Largest wheel speed; infinite if it is not known \[rad/s\].
    pub fn wheel_speed_limit_radps(&self) -> f64 {
        let of_response = self.response.and_then(|response| response.wheel_speed_limit_radps);
        self.drive
            .map(|drive| drive.wheel_speed_limit_radps)
            .or(of_response)
            .unwrap_or(f64::INFINITY)
    }

    /// Dead time that the robot file states; 0 if it has motors \[s\].
    pub fn dead_time_s(&self) -> f64 {
        self.response.map_or(0.0, |response| response.dead_time_s)
    }

    /// Time after which the base has nearly followed its input: dead time plus the largest time
    /// constant of an axis \[s\].
    ///
    /// With motors, a time constant is λ/(κ + f). Here λ = D r²/Σ(J r̄/r)² + `I_ω` is the inertia
    /// of the axis, and κ = p `K_T` `k_p` the stiffness of the speed loop.
    pub fn response_time_s(&self) -> f64 {
        let constants = match (&self.body, &self.drive) {
            (Some(body), Some(drive)) => {
                let stiffness = drive.pole_pairs
                    * drive.torque_constant_nm_per_a
                    * drive.speed_loop_gain_a_s_per_rad;
                let radius = self.wheels.radius_m();
                let squares = self.wheels.square_sums();
                let inertia = [body.mass_kg, body.mass_kg, body.yaw_inertia_kg_m2];
                std::array::from_fn(|axis| {
                    let seen = inertia[axis] * radius * radius / squares[axis];
                    (seen + body.wheel_inertia_kg_m2) / (stiffness + body.axle_friction_nms)
                })
            }
            _ => self.response.unwrap_or_default().time_constant_s,
        };
        self.dead_time_s() + constants.into_iter().fold(0.0, f64::max)
    }

    /// Checks that the parameters are possible.
    ///
    /// # Errors
    /// [`Impossible`] names the first parameter that is impossible.
    pub fn check(&self) -> Result<(), Impossible> {
        self.check_kind()?;
        let mut positive = vec![
            ("limits.input_mps", self.limits.input_mps),
            ("limits.yaw_input_radps", self.limits.yaw_input_radps),
            ("limits.input_rate_mps2", self.limits.input_rate_mps2),
            ("limits.yaw_input_rate_radps2", self.limits.yaw_input_rate_radps2),
            ("limits.brake_mps2", self.limits.brake_mps2),
            ("limits.yaw_brake_radps2", self.limits.yaw_brake_radps2),
        ];
        let mut not_negative = Vec::new();
        if let Some(body) = &self.body {
            positive.extend([
                ("body.mass_kg", body.mass_kg),
                ("body.yaw_inertia_kg_m2", body.yaw_inertia_kg_m2),
            ]);
            not_negative.extend([
                ("body.wheel_inertia_kg_m2", body.wheel_inertia_kg_m2),
                ("body.axle_friction_nms", body.axle_friction_nms),
            ]);
        }
        if let Some(drive) = &self.drive {
            positive.extend([
                ("drive.pole_pairs", drive.pole_pairs),
                ("drive.torque_constant_nm_per_a", drive.torque_constant_nm_per_a),
                ("drive.speed_loop_gain_a_s_per_rad", drive.speed_loop_gain_a_s_per_rad),
                ("drive.current_limit_a", drive.current_limit_a),
                ("drive.wheel_speed_limit_radps", drive.wheel_speed_limit_radps),
            ]);
        }
        if let Some(response) = &self.response {
            positive.extend(response.gain.map(|gain| ("response.gain", gain)));
            positive.extend(
                response.time_constant_s.map(|constant| ("response.time_constant_s", constant)),
            );
            positive.extend(
                response
                    .wheel_speed_limit_radps
                    .map(|limit| ("response.wheel_speed_limit_radps", limit)),
            );
            not_negative.push(("response.dead_time_s", response.dead_time_s));
        }
        if let Some(footprint) = &self.footprint {
            positive.extend([
                ("footprint.length_m", footprint.length_m),
                ("footprint.width_m", footprint.width_m),
            ]);
            not_negative.push(("footprint.clearance_m", footprint.clearance_m));
        }
        for (key, value) in positive {
            if !(SMALLEST..=LARGEST).contains(&value) {
                return Err(Impossible {
                    key,
                    expected: "a number greater than 0, from 1e-9 to 1e9",
                });
            }
        }
        for (key, value) in not_negative {
            if !(0.0..=LARGEST).contains(&value) {
                return Err(Impossible { key, expected: "a number from 0 to 1e9" });
            }
        }
        let tracking = [
            ("limits.tracking_error_m", self.limits.tracking_error_m),
            ("limits.tracking_error_heading_rad", self.limits.tracking_error_heading_rad),
        ];
        for (key, limit) in tracking {
            if let TrackingLimit::At(limit) = limit
                && !(SMALLEST..=LARGEST).contains(&limit)
            {
                let expected = "a number greater than 0, from 1e-9 to 1e9, or \"none\"";
                return Err(Impossible { key, expected });
            }
        }
        Ok(())
    }

    /// Checks that the response is given in one way.
    fn check_kind(&self) -> Result<(), Impossible> {
        let impossible = |key, expected| Err(Impossible { key, expected });
        match (&self.body, &self.drive, &self.response) {
            (Some(_) | None, Some(_), Some(_)) | (Some(_), None, Some(_)) => {
                impossible("response", "either [response], or [body] and [drive]")
            }
            (None, None, None) => impossible("response", "[response], or [body] and [drive]"),
            (Some(_), None, None) => impossible("drive", "[drive] beside [body]"),
            (None, Some(_), None) => impossible("body", "[body] beside [drive]"),
            (Some(_), Some(_), None) if self.wheels.count() == 0 => {
                impossible("response", "[response] for a base without known wheels (wheels.twist)")
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_response_time_is_dead_time_and_largest_time_constant() {
        let mut robot = Robot::example();
        // λ = 15 · 0.05²/4 + 0.002, κ = 4 · 0.04 · 0.5
        let expected = (15.0 * 0.05_f64.powi(2) / 4.0 + 2e-3) / (0.08 + 2e-3);
        assert!((robot.response_time_s() - expected).abs() < 1e-12, "{}", robot.response_time_s());
        let response =
            Response { time_constant_s: [0.2, 0.3, 0.1], dead_time_s: 0.05, ..Response::default() };
        (robot.body, robot.drive, robot.response) = (None, None, Some(response));
        assert!((robot.response_time_s() - 0.35).abs() < 1e-12);
    }
}
