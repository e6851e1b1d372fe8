//! Laws that the true robot obeys with all settings.

use driver::Start;
use plant_sim::truth::{Fault, Payload, RandomForce, Truth, Wheel, WheelSlip, World};

const SECOND: u64 = 1_000_000_000;
const GRIPPING: WheelSlip = WheelSlip { grip: 0.6, slip_speed_scale_mps: 0.05 };

fn frictionless() -> Truth {
    Truth { wheel_viscous_friction_nms: 0.0, rolling_friction: 0.0, ..Truth::default() }
}

/// The reference scenario's robot.
fn mismatched() -> Truth {
    Truth {
        mass_kg: 22.0,
        yaw_inertia_kg_m2: 0.88,
        wheel_viscous_friction_nms: 4e-3,
        rolling_friction: 0.05,
        drag_n_s2_per_m2: 0.5,
        motor_gain: vec![0.85, 1.0, 1.0, 1.0],
        random_force: Some(RandomForce { bound_n: 1.0, bound_nm: 0.1, correlation_s: 0.5 }),
        ..Truth::default()
    }
}

fn moving(velocity: [f64; 3]) -> Start {
    Start { pose: [0.0, -1.0, 0.3], velocity }
}

fn kinetic_energy(truth: &Truth, world: &World) -> f64 {
    let state = world.state();
    let [forward, left, yaw] = state.velocity;
    let wheels: f64 = state.wheel_speed.iter().map(|w| w * w).sum();
    0.5 * (truth.mass_kg * (forward * forward + left * left)
        + truth.yaw_inertia_kg_m2 * yaw * yaw
        + truth.wheel_inertia_kg_m2 * wheels)
}

#[test]
fn without_input_and_force_energy_never_grows_and_the_robot_comes_to_rest() {
    for wheel_slip in [None, Some(GRIPPING)] {
        let truth = Truth { wheel_slip, random_force: None, ..mismatched() };
        assert_eq!(truth.check(), Ok(()));
        let mut world = World::new(&truth, moving([2.0, -1.0, 3.0]), 1);
        let mut energy = kinetic_energy(&truth, &world);
        for _ in 0..100_000 {
            world.advance(World::STEP_NANOS, [0.0; 3]);
            let now = kinetic_energy(&truth, &world);
            assert!(now <= energy * (1.0 + 1e-12), "{now} J after {energy} J");
            energy = now;
        }
        assert!(energy < 1e-12, "{energy} J left");
    }
}

#[test]
fn friction_alone_brings_the_robot_to_rest() {
    let truth = Truth { speed_loop_gain_a_s_per_rad: 0.0, ..Truth::default() };
    let mut world = World::new(&truth, moving([1.0, 0.5, -1.0]), 1);
    world.advance(60 * SECOND, [0.0; 3]);
    assert!(kinetic_energy(&truth, &world) < 1e-9);
}

#[test]
fn without_motors_and_friction_a_spinning_robot_moves_straight() {
    // The Coriolis term makes Newton's first law hold. The wheels are massless, because the floor
    // acts on the momentum of others.
    let truth =
        Truth { speed_loop_gain_a_s_per_rad: 0.0, wheel_inertia_kg_m2: 0.0, ..frictionless() };
    assert_eq!(truth.check(), Ok(()));
    let mut world = World::new(&truth, Start { pose: [0.0; 3], velocity: [1.5, -0.5, 4.0] }, 1);
    world.advance(5 * SECOND, [0.0; 3]);
    let [x, y, heading] = world.state().pose;
    assert!(
        (x - 7.5).abs() < 1e-8 && (y + 2.5).abs() < 1e-8 && (heading - 20.0).abs() < 1e-8,
        "{x} {y} {heading}"
    );
}

#[test]
fn without_motors_and_friction_energy_is_constant() {
    let truth = Truth { speed_loop_gain_a_s_per_rad: 0.0, ..frictionless() };
    let mut world = World::new(&truth, moving([1.5, -0.5, 4.0]), 1);
    let before = kinetic_energy(&truth, &world);
    world.advance(10 * SECOND, [0.0; 3]);
    assert!((kinetic_energy(&truth, &world) / before - 1.0).abs() < 1e-10);
}

#[test]
fn each_axis_responds_as_a_first_order_system() {
    // v(t) = κ/(κ+f) u (1 − e^(−(κ+f) t/λ)), with viscous friction only.
    let truth = Truth { rolling_friction: 0.0, ..Truth::default() };
    let (kappa, f, r, arm) = (4.0 * 0.04 * 0.5, 2e-3, 0.05, 0.275);
    let straight = 15.0 * r * r / 4.0 + 2e-3;
    let turning = 0.6 * r * r / (4.0 * arm * arm) + 2e-3;
    for (axis, inertia) in [straight, straight, turning].into_iter().enumerate() {
        let mut input = [0.0; 3];
        input[axis] = 0.8;
        let mut world = World::new(&truth, Start::default(), 1);
        for millis in (100..=2000).step_by(100) {
            world.advance(SECOND / 10, input);
            let grown = 1.0 - (-(kappa + f) / inertia * f64::from(millis) * 1e-3).exp();
            let expected = kappa / (kappa + f) * 0.8 * grown;
            let velocity = world.state().velocity;
            assert!(
                (velocity[axis] - expected).abs() < 1e-10,
                "axis {axis}: {} for {expected}",
                velocity[axis]
            );
            let others: f64 = velocity.iter().map(|v| v.abs()).sum::<f64>() - velocity[axis].abs();
            assert!(others < 1e-12);
        }
    }
}

#[test]
fn an_integral_part_leaves_no_steady_error() {
    let truth = Truth {
        speed_loop_integral_a_per_rad: 1.0,
        ..Truth { random_force: None, ..mismatched() }
    };
    let mut world = World::new(&truth, Start::default(), 1);
    world.advance(30 * SECOND, [1.0, 0.0, 0.0]);
    let [forward, left, yaw] = world.state().velocity;
    assert!(
        (forward - 1.0).abs() < 1e-6 && left.abs() < 1e-6 && yaw.abs() < 1e-6,
        "{forward} {left} {yaw}"
    );
}

#[test]
fn left_and_right_are_mirror_images() {
    for wheel_slip in [None, Some(GRIPPING)] {
        let truth = Truth {
            wheel_slip,
            current_lag_s: 0.01,
            motor_gain: vec![0.8, 1.0, 0.9, 1.0],
            ..Truth::default()
        };
        let mirrored = Truth { motor_gain: vec![1.0, 0.8, 1.0, 0.9], ..truth.clone() };
        let mut one = World::new(&truth, Start::default(), 1);
        let mut other = World::new(&mirrored, Start::default(), 1);
        for _ in 0..20 {
            one.advance(SECOND / 10, [1.0, 0.6, 0.8]);
            other.advance(SECOND / 10, [1.0, -0.6, -0.8]);
            let ([x, y, heading], [x_other, y_other, heading_other]) =
                (one.state().pose, other.state().pose);
            assert!((x - x_other).abs() < 1e-12 && (y + y_other).abs() < 1e-12);
            assert!((heading + heading_other).abs() < 1e-12);
        }
    }
}

#[test]
fn a_weak_motor_turns_the_robot_towards_its_side() {
    let weak_right = Truth { motor_gain: vec![0.85, 1.0, 1.0, 1.0], ..Truth::default() };
    let weak_left = Truth { motor_gain: vec![1.0, 0.85, 1.0, 1.0], ..Truth::default() };
    for (truth, sign) in [(weak_right, -1.0), (weak_left, 1.0), (Truth::default(), 0.0)] {
        let mut world = World::new(&truth, Start::default(), 1);
        world.advance(SECOND, [1.0, 0.0, 0.0]);
        let heading = world.state().pose[2];
        assert!(
            if sign == 0.0 { heading.abs() < 1e-12 } else { heading * sign > 1e-3 },
            "{heading}"
        );
    }
}

#[test]
fn a_motor_fault_turns_the_robot_from_its_beginning() {
    let fault = Fault { wheel: Wheel::FrontRight, gain: 0.0, at_s: 1.0, until_s: None };
    let mut world =
        World::new(&Truth { faults: vec![fault], ..Truth::default() }, Start::default(), 1);
    world.advance(SECOND, [1.0, 0.0, 0.0]);
    assert!(world.state().pose[2].abs() < 1e-12);
    world.advance(SECOND, [1.0, 0.0, 0.0]);
    assert!(world.state().pose[2] < -1e-2);
}

#[test]
fn a_payload_makes_the_robot_slower_to_start() {
    let payload = Payload {
        mass_kg: 15.0,
        yaw_inertia_kg_m2: 0.2,
        offset_m: [0.0; 2],
        at_s: 0.0,
        until_s: None,
    };
    let speed_after_start = |truth: &Truth| {
        let mut world = World::new(truth, Start::default(), 1);
        world.advance(SECOND / 10, [1.0, 0.0, 0.0]);
        world.state().velocity[0]
    };
    let loaded = speed_after_start(&Truth { payload: Some(payload), ..Truth::default() });
    assert!(loaded < 0.8 * speed_after_start(&Truth::default()));
}

#[test]
fn wheels_with_grip_roll_and_wheels_on_ice_spin() {
    let slip_after_start = |grip: f64| {
        let truth = Truth { wheel_slip: Some(WheelSlip { grip, ..GRIPPING }), ..Truth::default() };
        let mut world = World::new(&truth, Start::default(), 1);
        world.advance(SECOND / 10, [3.0, 0.0, 0.0]);
        let state = world.state();
        state.wheel_speed[0] * 0.05 - state.velocity[0]
    };
    assert!(slip_after_start(20.0) < 0.01, "{}", slip_after_start(20.0));
    assert!(slip_after_start(0.05) > 1.0, "{}", slip_after_start(0.05));
}

#[test]
fn the_limit_of_large_grip_is_no_slip() {
    let mut rolling = World::new(&Truth::default(), Start::default(), 1);
    let firm = WheelSlip { grip: 10.0, slip_speed_scale_mps: 0.5 };
    let mut gripping =
        World::new(&Truth { wheel_slip: Some(firm), ..Truth::default() }, Start::default(), 1);
    for world in [&mut rolling, &mut gripping] {
        world.advance(2 * SECOND, [1.0, 0.3, 0.5]);
    }
    for (rolled, gripped) in rolling.state().velocity.into_iter().zip(gripping.state().velocity) {
        assert!((rolled - gripped).abs() < 0.01, "{rolled} {gripped}");
    }
}

#[test]
fn the_reference_robot_almost_reaches_the_commanded_velocity() {
    let mut world =
        World::new(&mismatched(), Start { pose: [0.0, -1.0, 0.0], velocity: [0.0; 3] }, 1);
    world.advance(3 * SECOND, [2.7, 0.0, 0.0]);
    let speed = world.state().velocity[0];
    assert!((1.5..2.7).contains(&speed), "{speed}");
}

#[test]
fn drag_alone_decelerates_by_the_quadratic_law() {
    // v(t) = v₀ / (1 + c v₀ t / m), along a straight line.
    let truth = Truth {
        speed_loop_gain_a_s_per_rad: 0.0,
        wheel_inertia_kg_m2: 0.0,
        drag_n_s2_per_m2: 3.0,
        ..frictionless()
    };
    let mut world = World::new(&truth, moving([3.0, 4.0, 0.0]), 1);
    world.advance(2 * SECOND, [0.0; 3]);
    let [forward, left, yaw] = world.state().velocity;
    let slower = 1.0 + 3.0 * 5.0 * 2.0 / 15.0;
    assert!((forward - 3.0 / slower).abs() < 1e-10 && (left - 4.0 / slower).abs() < 1e-10);
    assert!(yaw.abs() < 1e-12);
}

#[test]
fn a_current_follows_the_request_with_its_lag() {
    // A robot too heavy to move keeps the request constant: k_p J u / r.
    let truth =
        Truth { mass_kg: 1e9, current_lag_s: 0.02, rolling_friction: 0.0, ..Truth::default() };
    let mut world = World::new(&truth, Start::default(), 1);
    world.advance(SECOND / 50, [0.5, 0.0, 0.0]);
    let expected = 0.5 * 0.5 / 0.05 * (1.0 - (-1.0_f64).exp());
    for current in world.state().current.into_iter().take(4) {
        assert!((current - expected).abs() < 1e-6, "{current} for {expected}");
    }
}
