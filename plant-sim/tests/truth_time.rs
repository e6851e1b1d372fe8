//! Time in the true world: the same bits for every division of the time, and an exact delay.

use driver::Start;
use plant_sim::truth::{
    Fault, Push, RandomForce, Sensor, TrueState, Truth, Wheel, WheelSlip, World,
};

const MILLI: u64 = 1_000_000;

/// A world with as many effects as possible.
fn eventful() -> Truth {
    Truth {
        random_force: Some(RandomForce { bound_n: 3.0, bound_nm: 0.3, correlation_s: 0.02 }),
        wheel_slip: Some(WheelSlip { grip: 0.6, slip_speed_scale_mps: 0.05 }),
        push: Some(Push {
            force_n: [2.0, 1.0],
            torque_nm: 0.1,
            from_s: 0.013,
            until_s: Some(0.05),
        }),
        faults: vec![Fault { wheel: Wheel::RearRight, gain: 0.5, at_s: 0.0305, until_s: None }],
        command_delay_s: 0.0071,
        current_lag_s: 0.003,
        sensor: Sensor { position_noise_m: 0.01, current_noise_a: 0.1, ..Sensor::default() },
        ..Truth::default()
    }
}

fn bits(state: &TrueState) -> Vec<u64> {
    let TrueState { pose, velocity, wheel_speed, current, force } = state;
    [&pose[..], velocity, wheel_speed, current, force]
        .concat()
        .into_iter()
        .map(f64::to_bits)
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let run = |seed: u64| {
        let mut world = World::new(&eventful(), Start::default(), seed);
        let mut seen = Vec::new();
        for step in 0..20 {
            world.advance(5 * MILLI, [1.0, 0.1 * f64::from(step), -0.5]);
            seen.extend(bits(&world.state()));
            seen.extend(world.measure().pose.map(f64::to_bits));
        }
        seen
    };
    assert_eq!(run(4), run(4));
    assert_ne!(run(4), run(5));
}

#[test]
fn time_divided_otherwise_gives_the_same_bits() {
    let input = [1.0, -0.4, 0.7];
    let run = |pieces: &[u64]| {
        let mut world = World::new(&eventful(), Start::default(), 4);
        for &piece in pieces {
            world.advance(piece, input);
        }
        assert_eq!(world.time_nanos(), 100 * MILLI);
        bits(&world.state())
    };
    let whole = run(&[100 * MILLI]);
    assert_eq!(whole, run(&[World::STEP_NANOS; 1000]));
    assert_eq!(whole, run(&[37 * MILLI, 0, 62 * MILLI + 900_000, 100_000]));
    assert_eq!(whole, run(&[33_333_333, 33_333_333, 33_333_334]));
}

#[test]
fn reading_the_sensors_does_not_change_the_world() {
    let mut watched = World::new(&eventful(), Start::default(), 4);
    let mut alone = watched.clone();
    for _ in 0..50 {
        watched.advance(MILLI, [1.0, 0.0, 0.0]);
        watched.measure();
        alone.advance(MILLI, [1.0, 0.0, 0.0]);
    }
    assert_eq!(bits(&watched.state()), bits(&alone.state()));
}

#[test]
fn the_rest_of_a_duration_is_added_to_the_next() {
    let mut world = World::new(&Truth::default(), Start::default(), 1);
    world.advance(World::STEP_NANOS - 1, [1.0, 0.0, 0.0]);
    assert_eq!(world.time_nanos(), 0);
    world.advance(1, [1.0, 0.0, 0.0]);
    assert_eq!(world.time_nanos(), World::STEP_NANOS);
}

#[test]
fn a_command_arrives_after_exactly_the_delay() {
    let input = [1.0, -0.4, 0.7];
    let delay_steps = 123;
    let mut late =
        World::new(&Truth { command_delay_s: 0.0123, ..Truth::default() }, Start::default(), 1);
    let mut prompt = World::new(&Truth::default(), Start::default(), 1);

    late.advance(delay_steps * World::STEP_NANOS, input);
    assert_eq!((late.input_applied(), late.state().velocity), ([0.0; 3], [0.0; 3]));
    for _ in 0..500 {
        late.advance(World::STEP_NANOS, input);
        prompt.advance(World::STEP_NANOS, input);
        assert_eq!(late.input_applied().map(f64::to_bits), input.map(f64::to_bits));
        assert_eq!(bits(&late.state()), bits(&prompt.state()));
    }
}

#[test]
fn the_mean_input_is_that_of_the_wheels_and_not_that_of_the_gate() {
    let mut world =
        World::new(&Truth { command_delay_s: 0.025, ..Truth::default() }, Start::default(), 1);
    world.advance(100 * MILLI, [1.0, 0.0, -2.0]);
    let [forward, left, yaw] = world.take_mean_input();
    assert!((forward - 0.75).abs() < 1e-12 && left.abs() < 1e-12 && (yaw + 1.5).abs() < 1e-12);
    world.advance(50 * MILLI, [0.0; 3]);
    let [forward, ..] = world.take_mean_input();
    assert!((forward - 0.5).abs() < 1e-12, "{forward}");
}
