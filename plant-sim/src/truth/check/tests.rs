//! Which settings are possible and which are rejected.

use super::*;
use crate::truth::{Fault, Patch, Push, Wheel, WheelSlip};

fn refused(truth: &Truth) -> String {
    truth.check().map_or_else(|impossible| impossible.key, |()| "nothing".to_owned())
}

#[test]
fn the_default_robot_is_possible() {
    assert_eq!(Truth::default().check(), Ok(()));
}

#[test]
fn the_error_names_the_path_of_an_impossible_setting() {
    let patch = Patch { from_m: [0.0; 2], to_m: [1.0; 2], friction_factor: 1.0, grip_factor: 0.5 };
    let push = Push { force_n: [0.0, f64::NAN], ..Push::default() };
    let fault = Fault { wheel: Wheel::RearLeft, gain: -1.0, at_s: 0.0, until_s: None };
    let plain = Truth::default;
    let cases = [
        ("mass_kg", Truth { mass_kg: 0.0, ..plain() }),
        ("yaw_inertia_kg_m2", Truth { yaw_inertia_kg_m2: f64::INFINITY, ..plain() }),
        ("motor_gain.2", Truth { motor_gain: vec![1.0, 1.0, -0.1, 1.0], ..plain() }),
        ("command_delay_s", Truth { command_delay_s: 0.000_05, ..plain() }),
        ("reported_delay_s", Truth { reported_delay_s: f64::NAN, ..plain() }),
        ("current_lag_s", Truth { current_lag_s: 1e-5, ..plain() }),
        ("push.force_n", Truth { push: Some(push), ..plain() }),
        ("patches.0.grip_factor", Truth { patches: vec![patch], ..plain() }),
        ("faults.0.gain", Truth { faults: vec![fault], ..plain() }),
        (
            "sensor.heading_noise_rad",
            Truth { sensor: Sensor { heading_noise_rad: -0.1, ..Sensor::default() }, ..plain() },
        ),
    ];
    for (key, truth) in cases {
        assert_eq!(refused(&truth), key);
    }
}

#[test]
fn a_rate_that_a_step_cannot_integrate_is_rejected() {
    let slip = WheelSlip { grip: 0.6, slip_speed_scale_mps: 1e-4 };
    let plain = Truth::default;
    let cases = [
        ("speed_loop_gain_a_s_per_rad", Truth { speed_loop_gain_a_s_per_rad: 1e3, ..plain() }),
        (
            "rolling_friction_speed_scale_radps",
            Truth { rolling_friction_speed_scale_radps: 1e-6, ..plain() },
        ),
        ("wheel_slip.slip_speed_scale_mps", Truth { wheel_slip: Some(slip), ..plain() }),
    ];
    for (key, truth) in cases {
        assert_eq!(refused(&truth), key);
    }
}
