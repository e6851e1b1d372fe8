//! Laws of the equations of motion.

use super::*;
use crate::truth::schedule::Schedule;
use nalgebra::{Matrix3x4, Matrix4, Vector4};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// M of the wheels, eqs. 19–20.
fn wheel_mass_matrix(truth: &Truth) -> Matrix4<f64> {
    let (r, arm) = (truth.wheels.radius_m(), truth.wheels.lever_m());
    let a = truth.mass_kg * r * r / 8.0;
    let b = truth.yaw_inertia_kg_m2 * r * r / (16.0 * arm * arm);
    let (c, d) = (a + b + truth.wheel_inertia_kg_m2, a - b);
    Matrix4::new(c, -b, d, b, -b, c, b, d, d, b, c, -b, b, d, -b, c)
}

/// J⁺ of the reference robot.
fn velocity_from_rim_speed() -> Matrix3x4<f64> {
    let turn = 1.0 / (0.15 + 0.125);
    #[rustfmt::skip]
    let inverse = 0.25 * Matrix3x4::new(
        1.0,   1.0,   1.0,  1.0,
        1.0,  -1.0,   1.0, -1.0,
        turn, -turn, -turn, turn,
    );
    inverse
}

fn conditions(truth: &Truth, command: Vector3<f64>) -> Conditions {
    Schedule::new(truth).at(0, Vector3::zeros(), command)
}

fn moving(truth: &Truth, velocity: Vector3<f64>) -> State<4> {
    State {
        pose: Vector3::zeros(),
        velocity,
        wheel_speed: Geometry::<4>::new(&truth.wheels).wheel_speed(&velocity),
        current: Vector4::zeros(),
        integral: Vector4::zeros(),
    }
}

fn velocities() -> impl Iterator<Item = Vector3<f64>> {
    let mut generator = Pcg64Mcg::seed_from_u64(11);
    (0..200).map(move |_| Vector3::from_fn(|_, _| generator.random_range(-5.0..5.0)))
}

#[test]
fn the_columns_of_j_are_eigenvectors_of_m() {
    let truth = Truth::default();
    let m = wheel_mass_matrix(&truth);
    let g = Geometry::<4>::new(&truth.wheels);
    let (r, arm) = (g.mean_radius_m, g.arm_m);
    let straight = truth.mass_kg * r * r / 4.0 + truth.wheel_inertia_kg_m2;
    let turning = truth.yaw_inertia_kg_m2 * r * r / (4.0 * arm * arm) + truth.wheel_inertia_kg_m2;
    for (axis, eigenvalue) in [straight, straight, turning].into_iter().enumerate() {
        let column = g.rim_speed_from_velocity.column(axis).into_owned();
        assert!((m * column - column * eigenvalue).amax() < 1e-16);
    }
    let across = Vector4::new(1.0, 1.0, -1.0, -1.0);
    assert!((m * across - across * truth.wheel_inertia_kg_m2).amax() < 1e-16);
}

#[test]
fn body_and_wheels_obey_the_papers_matrix() {
    // J⁺(M ω̇ − τ − r J⁺ᵀF) = 0, with τ of the speed loop alone and F of the turning frame and
    // drag.
    let truth = Truth {
        wheel_viscous_friction_nms: 0.0,
        rolling_friction: 0.0,
        drag_n_s2_per_m2: 0.5,
        current_limit_a: 1e3,
        ..Truth::default()
    };
    let dynamics = Dynamics::<4>::new(&truth);
    let g = Geometry::<4>::new(&truth.wheels);
    let inverse = velocity_from_rim_speed();
    let command = Vector3::new(1.0, -0.5, 0.3);
    let given = conditions(&truth, command);
    for v in velocities() {
        let state = moving(&truth, v);
        let torque = (g.wheel_speed(&command) - g.wheel_speed(&v)) * (4.0 * 0.04 * 0.5);
        let force = dynamics.force(&state, &given);
        let wheel_acceleration = dynamics.rate(&state, &given).wheel_speed;
        let wheels = wheel_mass_matrix(&truth) * wheel_acceleration - torque;
        let rest = wheels - inverse.tr_mul(&force) * g.mean_radius_m;
        assert!((inverse * rest).amax() < 1e-12);
    }
}

#[test]
fn the_turning_frame_does_no_work() {
    let given = Conditions {
        mass_moment: Vector2::new(1.5, -0.8),
        ..conditions(&Truth::default(), Vector3::zeros())
    };
    for v in velocities() {
        assert!(turning_frame(&given, &v).dot(&v).abs() < 1e-11);
    }
}

#[test]
fn a_load_beside_the_centre_obeys_newton_and_euler() {
    let payload = crate::truth::Payload {
        mass_kg: 11.0,
        yaw_inertia_kg_m2: 0.1,
        offset_m: [0.1, -0.05],
        at_s: 0.0,
        until_s: None,
    };
    let truth = Truth { payload: Some(payload), ..Truth::default() };
    let given = conditions(&truth, Vector3::zeros());
    let (mass, turn, moment) = (26.0, 0.6 + 0.1 + 11.0 * 0.0125, Vector2::new(1.1, -0.55));
    let matrix = nalgebra::Matrix3::new(
        mass, 0.0, -moment.y, 0.0, mass, moment.x, -moment.y, moment.x, turn,
    );
    for force in velocities() {
        let acceleration = accelerated(&given, &Vector3::zeros(), &force);
        assert!((matrix * acceleration - force).amax() < 1e-12);
    }
    let loads = Dynamics::<4>::new(&truth).load_n(&given);
    assert!((loads.sum() - mass * GRAVITY).abs() < 1e-10);
    let leaning: Vector2<f64> = loads
        .iter()
        .zip(&Geometry::<4>::new(&truth.wheels).contacts_m)
        .map(|(load, place)| *load * place)
        .sum();
    assert!(
        (leaning - moment * GRAVITY).amax() < 1e-10,
        "the wheels support the load at its position"
    );
}

#[test]
fn breakaway_friction_is_larger_than_rolling_friction() {
    let truth = Truth { rolling_friction: 0.05, breakaway_factor: 2.0, ..Truth::default() };
    let plain = Truth { breakaway_factor: 1.0, ..truth.clone() };
    let given = conditions(&truth, Vector3::zeros());
    let lost = |truth: &Truth, speed: f64| {
        let slow = moving(truth, Vector3::new(speed, 0.0, 0.0));
        Dynamics::<4>::new(truth).rate(&slow, &given).velocity.x
            - Dynamics::<4>::new(&Truth { rolling_friction: 0.0, ..truth.clone() })
                .rate(&slow, &given)
                .velocity
                .x
    };
    assert!(lost(&truth, 0.05) < 1.8 * lost(&plain, 0.05));
    assert!((lost(&truth, 1.0) / lost(&plain, 1.0) - 1.0).abs() < 1e-9);
}

#[test]
fn friction_drag_and_brake_only_dissipate_energy() {
    for wheel_slip in [None, Some(WheelSlip { grip: 0.6, slip_speed_scale_mps: 0.05 })] {
        let truth = Truth {
            wheel_slip,
            drag_n_s2_per_m2: 0.5,
            motor_gain: vec![0.85, 1.0, 0.0, 1.0],
            ..Truth::default()
        };
        let dynamics = Dynamics::<4>::new(&truth);
        let given = conditions(&truth, Vector3::zeros());
        for v in velocities() {
            let mut state = moving(&truth, v);
            if wheel_slip.is_some() {
                state.wheel_speed.swap_rows(0, 1);
            }
            let rate = dynamics.rate(&state, &given);
            let inertia = Vector3::new(truth.mass_kg, truth.mass_kg, truth.yaw_inertia_kg_m2);
            let power = rate.velocity.component_mul(&inertia).dot(&v)
                + truth.wheel_inertia_kg_m2 * rate.wheel_speed.dot(&state.wheel_speed);
            assert!(power < 0.0, "{power} W at {v}");
        }
    }
}

#[test]
fn a_slope_pulls_downhill_at_every_heading() {
    let truth = Truth {
        slope: Some(crate::truth::Slope { angle_rad: 0.1, direction_rad: 1.0 }),
        ..Truth::default()
    };
    let dynamics = Dynamics::<4>::new(&truth);
    let given = conditions(&truth, Vector3::zeros());
    for heading in [0.0, 0.5, 2.0, -3.0] {
        let mut state = moving(&truth, Vector3::zeros());
        state.pose.z = heading;
        let in_world = world_from_body(heading, &dynamics.force(&state, &given));
        let weight = 15.0 * GRAVITY * 0.1_f64.sin();
        assert!(
            (in_world - Vector3::new(weight * 1_f64.cos(), weight * 1_f64.sin(), 0.0)).amax()
                < 1e-12
        );
    }
}

#[test]
fn a_patch_affects_only_the_wheels_on_it() {
    let patch = crate::truth::Patch {
        from_m: [0.0, 0.0],
        to_m: [1.0, 1.0],
        friction_factor: 3.0,
        grip_factor: 0.5,
    };
    let dynamics = Dynamics::<4>::new(&Truth { patches: vec![patch], ..Truth::default() });
    let floor = dynamics.floor(&Vector3::zeros());
    assert_eq!(floor.friction, Vector4::new(1.0, 3.0, 1.0, 1.0));
    assert_eq!(floor.grip, Vector4::new(1.0, 0.5, 1.0, 1.0));
    let turned = dynamics.floor(&Vector3::new(0.0, 0.0, core::f64::consts::FRAC_PI_2));
    assert_eq!(turned.friction, Vector4::new(3.0, 1.0, 1.0, 1.0));
}

#[test]
fn a_deadband_ignores_small_errors_and_shrinks_large_ones() {
    let truth = Truth { deadband_radps: 2.0, ..Truth::default() };
    let dynamics = Dynamics::<4>::new(&truth);
    let given = conditions(&truth, Vector3::new(1.0, 0.0, 0.0)); // 20 rad/s on every wheel
    let error = dynamics.speed_error(&Vector4::new(18.5, 21.9, 10.0, 30.0), &given);
    assert!((error - Vector4::new(0.0, 0.0, 8.0, -8.0)).amax() < 1e-12, "{error}");
}

#[test]
fn a_speed_loop_at_its_limit_does_not_wind_up() {
    let truth =
        Truth { speed_loop_integral_a_per_rad: 1.0, current_limit_a: 10.0, ..Truth::default() };
    let dynamics = Dynamics::<4>::new(&truth);
    let error = Vector4::new(30.0, -30.0, 30.0, 5.0);
    let integral = Vector4::new(0.0, 0.0, -40.0, 0.0);
    let rate = dynamics.integral_rate(&error, &integral);
    assert_eq!(rate, Vector4::new(0.0, 0.0, 30.0, 5.0));
}
