use super::*;
use bytemuck::Zeroable;
use model::residual::bound;
use robot::Robot;

const PERIOD: f64 = 0.1;

fn watch() -> Watch {
    let main = MainModel::new(&Robot::example(), PERIOD);
    Watch::new(main, bound(&main, &Robot::example()))
}

fn state(tick: u64, pose: [f64; 3], velocity: Velocity) -> PlantState {
    let mut state = PlantState::zeroed();
    (state.stamp.tick, state.pose, state.velocity) = (tick, pose, velocity);
    state
}

fn driven(input: Velocity) -> Driven {
    Driven { acted: input, commanded: Some(input) }
}

/// The fault after each of these ticks.
fn faults_of(
    watch: &mut Watch,
    ticks: std::ops::Range<u64>,
    at: impl Fn(u64) -> (PlantState, Driven),
) -> Vec<Option<SensorFault>> {
    let look = |tick| {
        let (state, driven) = at(tick);
        watch.look(&state, &driven)
    };
    ticks.map(look).collect()
}

fn driving(tick: u64) -> (PlantState, Driven) {
    let way = PERIOD * tick as f64;
    (state(tick, [2.7 * way, 0.1 * way, 0.3 * way], [2.7, 0.1, 0.3]), driven([2.8, 0.1, 0.3]))
}

#[test]
fn a_constant_pose_of_a_driving_robot_is_named_after_three_periods_until_it_changes() {
    let mut watch = watch();
    let stuck_from = |first: u64| {
        move |tick: u64| {
            let (mut now, driven) = driving(tick);
            now.pose = driving(tick.min(first)).0.pose;
            (now, driven)
        }
    };
    let faults = faults_of(&mut watch, 0..20, stuck_from(10));
    assert_eq!(faults[..13], [None; 13]);
    assert_eq!(faults[13..], [Some(SensorFault::Position); 7]);
    let (mut standing, _) = stuck_from(10)(20);
    standing.velocity = [0.0; 3];
    assert_eq!(
        watch.look(&standing, &driven([0.0; 3])),
        Some(SensorFault::Position),
        "it has braked, and nothing has moved"
    );
    assert_eq!(watch.look(&driving(21).0, &driven([0.0; 3])), None);
}

#[test]
fn a_constant_heading_of_a_turning_robot_is_named() {
    let turning = |tick: u64| {
        (state(tick, [0.01 * tick as f64, 0.0, 1.0], [0.1, 0.0, -0.5]), driven([0.1, 0.0, -0.5]))
    };
    assert_eq!(
        faults_of(&mut watch(), 0..6, turning)[2..],
        [None, Some(SensorFault::Heading), Some(SensorFault::Heading), Some(SensorFault::Heading)]
    );
}

#[test]
fn a_robot_that_is_driven_hard_with_constant_readings_has_stuck_sensors() {
    let frozen = |tick| (state(tick, [1.0, 2.0, 3.0], [0.0; 3]), driven([2.0, 0.0, 0.0]));
    let faults = faults_of(&mut watch(), 0..6, frozen);
    assert_eq!((faults[2], faults[3]), (None, Some(SensorFault::Everything)));
    // The acting input comes from the same stuck driver; the commands show the fault.
    let silent =
        |tick| (frozen(tick).0, Driven { acted: [0.0; 3], commanded: Some([2.0, 0.0, 0.0]) });
    let faults = faults_of(&mut watch(), 0..20, silent);
    assert_eq!(faults.iter().position(Option::is_some), Some(COMMANDED_PERIODS as usize));
}

#[test]
fn a_robot_that_stands_holds_a_point_or_sticks_to_the_floor_is_never_suspected() {
    let mut watch = watch();
    // Coarse and biased sensors, and an input that is too small to overcome friction.
    let standing =
        |tick| (state(tick, [1.0, 2.0, 3.0], [0.15, -0.05, 0.15]), driven([0.8, 0.3, -0.6]));
    assert!(faults_of(&mut watch, 0..10_000, standing).iter().all(Option::is_none));
    // A pose in steps of a centimetre, with ten control periods per step.
    let creeping = |tick: u64| {
        (
            state(tick, [0.01 * (tick / 10) as f64, 0.0, 0.0], [0.19, 0.0, 0.0]),
            driven([0.2, 0.0, 0.0]),
        )
    };
    assert!(faults_of(&mut watch, 10_000..12_000, creeping).iter().all(Option::is_none));
    assert!(faults_of(&mut watch, 12_000..13_000, driving).iter().all(Option::is_none));
}

#[test]
fn a_constant_velocity_with_a_changing_input_and_a_wrong_position_is_named() {
    // Ten periods ahead, then to the left, then turning. The velocity of the first ten stays in
    // the readings.
    let way = |tick: u64| PERIOD * tick.min(10) as f64;
    let after = |tick: u64| PERIOD * tick.saturating_sub(10) as f64;
    let left = |tick: u64| {
        let input = if tick < 10 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        (state(tick, [way(tick), after(tick), 0.0], [1.0, 0.0, 0.0]), driven(input))
    };
    let faults = faults_of(&mut watch(), 0..30, left);
    assert_eq!(faults.iter().position(Option::is_some), Some(11), "{faults:?}");
    assert_eq!(faults[11..], [Some(SensorFault::Velocity); 19]);
    let turning = |tick: u64| {
        let rate = if tick < 10 { 0.0 } else { 1.0 };
        (state(tick, [0.3, 0.0, after(tick)], [0.0; 3]), driven([0.0, 0.0, rate]))
    };
    assert!(
        faults_of(&mut watch(), 0..30, turning)[12..]
            .iter()
            .all(|fault| *fault == Some(SensorFault::YawRate))
    );
}

#[test]
fn a_constant_velocity_that_fits_the_path_or_a_constant_input_is_not_stuck() {
    assert!(faults_of(&mut watch(), 0..1000, driving).iter().all(Option::is_none));
    // Slipping wheels with coarse encoders: the robot is slower than the encoders report.
    let slipping = |tick: u64| {
        (state(tick, [0.05 * tick as f64, 0.0, 0.0], [1.0, 0.0, 0.0]), driven([1.05, 0.0, 0.0]))
    };
    assert!(faults_of(&mut watch(), 0..1000, slipping).iter().all(Option::is_none));
}

#[test]
fn a_state_that_is_not_finite_is_named_until_it_is_finite() {
    let mut watch = watch();
    let (mut blind, driven) = driving(0);
    blind.velocity[1] = f64::NAN;
    assert_eq!(watch.look(&blind, &driven), Some(SensorFault::NotFinite));
    assert_eq!(watch.look(&driving(1).0, &driven), None);
}
