//! Every input of the motors leaves the true world finite.

use driver::Start;
use plant_sim::truth::{Patch, Payload, Push, RandomForce, Slope, Truth, WheelSlip, World};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A random world, with every effect on in about half of them.
fn any_truth(generator: &mut Pcg64Mcg) -> Truth {
    let wheel_slip =
        generator.random_bool(0.5).then_some(WheelSlip { grip: 0.6, slip_speed_scale_mps: 0.05 });
    let grip_factor = if wheel_slip.is_some() { 0.1 } else { 1.0 };
    let patch = Patch { from_m: [0.0, -9.0], to_m: [9.0, 9.0], friction_factor: 5.0, grip_factor };
    Truth {
        drag_n_s2_per_m2: generator.random_range(0.0..5.0),
        motor_gain: generator.random::<[f64; 4]>().to_vec(),
        current_lag_s: if generator.random_bool(0.5) { 0.005 } else { 0.0 },
        speed_loop_integral_a_per_rad: generator.random_range(0.0..5.0),
        deadband_radps: generator.random_range(0.0..2.0),
        command_delay_s: if generator.random_bool(0.5) { 0.02 } else { 0.0 },
        slope: generator.random_bool(0.5).then_some(Slope { angle_rad: 0.2, direction_rad: 1.0 }),
        push: generator
            .random_bool(0.5)
            .then_some(Push { force_n: [5.0, -9.0], ..Push::default() }),
        payload: generator.random_bool(0.5).then_some(Payload {
            mass_kg: 9.0,
            yaw_inertia_kg_m2: 0.0,
            offset_m: [0.1, -0.1],
            at_s: 0.1,
            until_s: None,
        }),
        patches: if generator.random_bool(0.5) { vec![patch] } else { Vec::new() },
        wheel_slip,
        random_force: Some(RandomForce { bound_n: 1.0, bound_nm: 0.1, correlation_s: 0.5 }),
        ..Truth::default()
    }
}

#[test]
fn any_input_leaves_a_finite_state() {
    let start = Start { pose: [0.0, -1.0, 0.3], velocity: [1.0, -2.0, 3.0] };
    let mut generator = Pcg64Mcg::seed_from_u64(99);
    for seed in 0..200 {
        let truth = any_truth(&mut generator);
        assert_eq!(truth.check(), Ok(()));
        let mut world = World::new(&truth, start, seed);
        for _ in 0..20 {
            // Any bits at all: huge, tiny, infinite, NaN.
            let input: [f64; 3] = generator.random::<[u64; 3]>().map(f64::from_bits);
            world.advance(20_000_000, input);
            let (state, seen) = (world.state(), world.measure());
            let numbers =
                state.pose.into_iter().chain(state.velocity).chain(state.force).chain(seen.pose);
            let wheels = state.wheel_speed.into_iter().chain(state.current).chain(seen.wheel_speed);
            assert!(
                numbers.chain(wheels).all(f64::is_finite),
                "{input:?} gives {state:?} with {truth:?}"
            );
            assert!(
                state
                    .current
                    .iter()
                    .all(|current| current.abs() <= truth.current_limit_a * (1.0 + 1e-9))
            );
        }
    }
}
