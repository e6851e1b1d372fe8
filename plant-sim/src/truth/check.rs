//! Checks of the settings: finite, of the right sign, and slow enough for the time step of the
//! world.

use thiserror::Error;

use super::dynamics::GRAVITY;
use super::parameters::{Sensor, Truth};
use super::world::World;

/// Largest rate of change that a step of 0.1 ms integrates accurately \[1/s\].
const FASTEST_PER_S: f64 = 2000.0;

/// Rim speed up to which a step integrates the equations accurately \[m/s\].
const TOP_SPEED_MPS: f64 = 50.0;

/// A setting that no world can have.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{key}: expected {expected}")]
pub struct Impossible {
    /// Path of the setting within the table of the truth, such as `push.force_n`.
    pub key: String,
    /// Expected value.
    pub expected: String,
}

type Verdict = Result<(), Impossible>;

impl Truth {
    /// Checks that such a world is possible; reports the first impossible setting.
    pub fn check(&self) -> Result<(), Impossible> {
        self.check_body()?;
        self.check_motors()?;
        self.check_world()?;
        self.check_wheel_slip()?;
        self.check_timetable()?;
        self.sensor.check()?;
        self.check_rates()
    }

    fn check_body(&self) -> Verdict {
        positive("mass_kg", self.mass_kg)?;
        positive("yaw_inertia_kg_m2", self.yaw_inertia_kg_m2)?;
        not_negative("wheel_inertia_kg_m2", self.wheel_inertia_kg_m2)?;
        require(self.wheels.count() > 0, "wheels", "known wheels: no twist")?;
        not_negative("wheel_viscous_friction_nms", self.wheel_viscous_friction_nms)?;
        not_negative("rolling_friction", self.rolling_friction)?;
        positive("rolling_friction_speed_scale_radps", self.rolling_friction_speed_scale_radps)?;
        require(
            self.breakaway_factor >= 1.0 && self.breakaway_factor.is_finite(),
            "breakaway_factor",
            "a finite number of at least 1",
        )?;
        positive("breakaway_speed_radps", self.breakaway_speed_radps)?;
        not_negative("drag_n_s2_per_m2", self.drag_n_s2_per_m2)
    }

    fn check_motors(&self) -> Verdict {
        for (wheel, gain) in self.motor_gain.iter().enumerate() {
            motor_gain(&format!("motor_gain.{wheel}"), *gain)?;
        }
        let wheels = self.wheels.count();
        require(
            self.motor_gain.len() <= wheels,
            "motor_gain",
            &format!("at most {wheels} numbers, one for each wheel"),
        )?;
        positive("pole_pairs", self.pole_pairs)?;
        positive("torque_constant_nm_per_a", self.torque_constant_nm_per_a)?;
        not_negative("speed_loop_gain_a_s_per_rad", self.speed_loop_gain_a_s_per_rad)?;
        not_negative("speed_loop_integral_a_per_rad", self.speed_loop_integral_a_per_rad)?;
        not_negative("deadband_radps", self.deadband_radps)?;
        positive("current_limit_a", self.current_limit_a)?;
        let lag = self.current_lag_s;
        let followed =
            lag.abs() < f64::MIN_POSITIVE || (lag.is_finite() && lag >= 1.0 / FASTEST_PER_S);
        require(
            followed,
            "current_lag_s",
            "0, or at least 0.0005 s: a step of 0.1 ms cannot integrate less",
        )?;
        let limit = self.wheel_speed_limit_radps;
        require(
            limit > 0.0 && limit * self.wheels.radius_m() <= TOP_SPEED_MPS,
            "wheel_speed_limit_radps",
            "positive, and at most 50 m/s at the rim",
        )?;
        require(
            (0.0..=World::LONGEST_DELAY_S).contains(&self.reported_delay_s),
            "reported_delay_s",
            "between 0 and 10 s",
        )?;
        let delay = self.command_delay_s;
        let steps = delay * 1e9 / World::STEP_NANOS as f64;
        require(
            (0.0..=World::LONGEST_DELAY_S).contains(&delay) && (steps - steps.round()).abs() < 1e-6,
            "command_delay_s",
            "between 0 and 10 s, a multiple of 0.0001 s",
        )
    }

    fn check_world(&self) -> Verdict {
        if let Some(slope) = self.slope {
            require(slope.angle_rad.abs() < 1.0, "slope.angle_rad", "between -1 and 1 rad")?;
            finite("slope.direction_rad", slope.direction_rad)?;
        }
        if let Some(push) = self.push {
            finite("push.force_n", push.force_n[0])?;
            finite("push.force_n", push.force_n[1])?;
            finite("push.torque_nm", push.torque_nm)?;
        }
        if let Some(force) = self.random_force {
            not_negative("random_force.bound_n", force.bound_n)?;
            not_negative("random_force.bound_nm", force.bound_nm)?;
            not_negative("random_force.correlation_s", force.correlation_s)?;
        }
        for (index, patch) in self.patches.iter().enumerate() {
            for axis in 0..2 {
                let (from, to) = (patch.from_m[axis], patch.to_m[axis]);
                finite(&format!("patches.{index}.from_m"), from)?;
                require(
                    to.is_finite() && to > from,
                    &format!("patches.{index}.to_m"),
                    "finite, and beyond from_m in x and in y",
                )?;
            }
            not_negative(&format!("patches.{index}.friction_factor"), patch.friction_factor)?;
            not_negative(&format!("patches.{index}.grip_factor"), patch.grip_factor)?;
            require(
                self.wheel_slip.is_some() || (patch.grip_factor - 1.0).abs() < f64::EPSILON,
                &format!("patches.{index}.grip_factor"),
                "1: without the table wheel_slip, wheels never slip",
            )?;
        }
        Ok(())
    }

    fn check_wheel_slip(&self) -> Verdict {
        let Some(slip) = self.wheel_slip else {
            return Ok(());
        };
        positive("wheel_slip.grip", slip.grip)?;
        positive("wheel_slip.slip_speed_scale_mps", slip.slip_speed_scale_mps)?;
        require(
            self.wheel_inertia_kg_m2 > 0.0,
            "wheel_inertia_kg_m2",
            "positive, because the wheels can slip",
        )
    }

    fn check_timetable(&self) -> Verdict {
        if let Some(payload) = self.payload {
            not_negative("payload.mass_kg", payload.mass_kg)?;
            not_negative("payload.yaw_inertia_kg_m2", payload.yaw_inertia_kg_m2)?;
            not_negative("payload.at_s", payload.at_s)?;
            later("payload.until_s", payload.until_s, payload.at_s)?;
            let [forward, left] = payload.offset_m.map(f64::abs);
            let [ahead, side] = self.wheels.half_extent_m();
            require(
                forward < ahead && left < side,
                "payload.offset_m",
                "a point between the wheels",
            )?;
        }
        if let Some(push) = self.push {
            not_negative("push.from_s", push.from_s)?;
            later("push.until_s", push.until_s, push.from_s)?;
        }
        for (index, fault) in self.faults.iter().enumerate() {
            let wheels = self.wheels.count();
            require(
                fault.wheel.index() < wheels,
                &format!("faults.{index}.wheel"),
                &format!("one of the {wheels} wheels"),
            )?;
            motor_gain(&format!("faults.{index}.gain"), fault.gain)?;
            not_negative(&format!("faults.{index}.at_s"), fault.at_s)?;
            later(&format!("faults.{index}.until_s"), fault.until_s, fault.at_s)?;
        }
        for (index, slippery) in self.slippery.iter().enumerate() {
            let key = |name: &str| format!("slippery.{index}.{name}");
            require(
                (0.0..=1.0).contains(&slippery.grip_factor),
                &key("grip_factor"),
                "between 0 and 1",
            )?;
            require(
                self.wheel_slip.is_some(),
                &key("grip_factor"),
                "no value without the table wheel_slip: wheels never slip then",
            )?;
            not_negative(&key("from_s"), slippery.from_s)?;
            later(&key("until_s"), slippery.until_s, slippery.from_s)?;
        }
        for (index, stuck) in self.stuck.iter().enumerate() {
            not_negative(&format!("stuck.{index}.from_s"), stuck.from_s)?;
            later(&format!("stuck.{index}.until_s"), stuck.until_s, stuck.from_s)?;
        }
        for (index, pressed) in self.pressed.iter().enumerate() {
            not_negative(&format!("pressed.{index}.from_s"), pressed.from_s)?;
            later(&format!("pressed.{index}.until_s"), pressed.until_s, pressed.from_s)?;
        }
        Ok(())
    }

    /// Checks that each part of the equations alone is slow enough: its slope divided by the
    /// smallest inertia that it moves.
    fn check_rates(&self) -> Verdict {
        let (radius, arm) = (self.wheels.radius_m(), self.wheels.lever_m());
        let share = 1.0 / self.wheels.count() as f64;
        let [forward, left, _] = self.wheels.square_sums();
        let rolling = (radius * radius * self.mass_kg / forward.max(left))
            .min(share * self.yaw_inertia_kg_m2 * (radius / arm).powi(2));
        let inertia =
            self.wheel_inertia_kg_m2 + if self.wheel_slip.is_some() { 0.0 } else { rolling };
        let heaviest = self.mass_kg + self.payload.map_or(0.0, |payload| payload.mass_kg);
        let load_n = share * heaviest * GRAVITY;
        let gain =
            self.motor_gain.iter().copied().chain(self.faults.iter().map(|fault| fault.gain)).fold(
                if self.motor_gain.len() < self.wheels.count() { 1.0 } else { 0.0 },
                f64::max,
            );
        let motor = gain * self.pole_pairs * self.torque_constant_nm_per_a / inertia;
        let roughest = self.patches.iter().map(|patch| patch.friction_factor).fold(1.0, f64::max);
        let rolling_nm = self.rolling_friction * roughest * load_n * radius;

        slow("speed_loop_gain_a_s_per_rad", motor * self.speed_loop_gain_a_s_per_rad)?;
        slow("speed_loop_integral_a_per_rad", (motor * self.speed_loop_integral_a_per_rad).sqrt())?;
        slow("wheel_viscous_friction_nms", self.wheel_viscous_friction_nms / inertia)?;
        slow(
            "breakaway_speed_radps",
            (self.breakaway_factor - 1.0) * rolling_nm / self.breakaway_speed_radps / inertia,
        )?;
        slow(
            "rolling_friction_speed_scale_radps",
            self.breakaway_factor * rolling_nm / self.rolling_friction_speed_scale_radps / inertia,
        )?;
        slow("drag_n_s2_per_m2", self.drag_n_s2_per_m2 * TOP_SPEED_MPS / self.mass_kg)?;
        slow("wheels", TOP_SPEED_MPS / arm)?;
        if let Some(slip) = self.wheel_slip {
            let grippiest = self.patches.iter().map(|patch| patch.grip_factor).fold(1.0, f64::max);
            let traction = grippiest * slip.grip * load_n / slip.slip_speed_scale_mps;
            let yielding = radius * radius / self.wheel_inertia_kg_m2
                + forward.max(left) / self.mass_kg
                + arm * arm / (share * self.yaw_inertia_kg_m2);
            slow("wheel_slip.slip_speed_scale_mps", traction * yielding)?;
        }
        Ok(())
    }
}

impl Sensor {
    fn check(&self) -> Verdict {
        let all = [
            ("position_noise_m", self.position_noise_m),
            ("heading_noise_rad", self.heading_noise_rad),
            ("velocity_noise_mps", self.velocity_noise_mps),
            ("yaw_rate_noise_radps", self.yaw_rate_noise_radps),
            ("wheel_speed_noise_radps", self.wheel_speed_noise_radps),
            ("current_noise_a", self.current_noise_a),
            ("position_step_m", self.position_step_m),
            ("heading_step_rad", self.heading_step_rad),
            ("velocity_step_mps", self.velocity_step_mps),
            ("yaw_rate_step_radps", self.yaw_rate_step_radps),
            ("wheel_speed_step_radps", self.wheel_speed_step_radps),
            ("current_step_a", self.current_step_a),
        ];
        all.into_iter().try_for_each(|(key, value)| not_negative(&format!("sensor.{key}"), value))
    }
}

fn require(holds: bool, key: &str, expected: &str) -> Verdict {
    if holds {
        Ok(())
    } else {
        Err(Impossible { key: key.to_owned(), expected: expected.to_owned() })
    }
}

fn finite(key: &str, value: f64) -> Verdict {
    require(value.is_finite(), key, "finite")
}

fn positive(key: &str, value: f64) -> Verdict {
    require(value.is_finite() && value > 0.0, key, "finite and positive")
}

fn not_negative(key: &str, value: f64) -> Verdict {
    require(value.is_finite() && value >= 0.0, key, "finite and not negative")
}

fn later(key: &str, until_s: Option<f64>, from_s: f64) -> Verdict {
    require(
        until_s.is_none_or(|until| until.is_finite() && until > from_s),
        key,
        "finite, and later than its beginning",
    )
}

fn motor_gain(key: &str, value: f64) -> Verdict {
    require((0.0..=2.0).contains(&value), key, "between 0 and 2")
}

fn slow(key: &str, rate_per_s: f64) -> Verdict {
    let slow = rate_per_s.is_finite() && rate_per_s <= FASTEST_PER_S;
    require(
        slow,
        key,
        &format!("a rate of at most {FASTEST_PER_S} per second, not {rate_per_s:.0}"),
    )
}

#[cfg(test)]
mod tests;
