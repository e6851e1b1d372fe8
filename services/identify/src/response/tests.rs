use super::*;
use robot::Robot;

fn samples(count: usize, input: impl Fn(usize) -> Velocity) -> Vec<Sample> {
    (0..count).map(|number| Sample { input: input(number), ..Sample::default() }).collect()
}

#[test]
fn a_step_after_a_dead_time_between_two_samples_is_the_exact_exponential() {
    let wheels = Robot::example().wheels;
    let samples = samples(50, |number| if number > 10 { [1.0, 0.0, 0.0] } else { [0.0; 3] });
    let response =
        Response { time_constant_s: [0.3; 3], dead_time_s: [0.057; 3], ..Response::default() };
    let run = Simulation::new(&wheels, &samples, 0.1).whole(&response);
    for (number, Motion { velocity, .. }) in run.iter().enumerate() {
        let since = (number + 1) as f64 * 0.1 - 1.0 - 0.057;
        let exact = if since > 0.0 { 1.0 - (-since / 0.3_f64).exp() } else { 0.0 };
        // The step begins within a step of the integration.
        assert!((velocity[0] - exact).abs() < 2e-4, "{number}: {} {exact}", velocity[0]);
    }
}

/// 3 m/s behind, of which 1 m/s acts.
#[test]
fn a_drive_that_saturates_accelerates_as_with_a_smaller_step() {
    let wheels = Robot::example().wheels;
    let response = Response { saturation_mps: 1.0, ..Response::default() };
    let first = |input: f64, response: &Response| {
        let samples = samples(3, |_| [input, 0.0, 0.0]);
        let run = Simulation::new(&wheels, &samples, 0.01).whole(response);
        run.first().map_or(f64::NAN, |motion| motion.velocity[0])
    };
    let (limited, small) = (first(3.0, &response), first(1.0, &Response::default()));
    // The small step gets smaller while the robot accelerates.
    assert!((limited / small - 1.0).abs() < 0.05, "{limited} {small}");
    assert_eq!(first(0.9, &response), first(0.9, &Response::default()));
}

#[test]
fn friction_holds_a_robot_whose_input_is_below_it() {
    let wheels = Robot::example().wheels;
    let samples = samples(100, |_| [0.05, 0.2, 0.0]);
    let response = Response { friction: [0.1; 3], ..Response::default() };
    let held = Simulation::new(&wheels, &samples, 0.02).whole(&response);
    let alone = [[0.05, 0.0, 0.0], [0.0, 0.2, 0.0]];
    for (axis, input) in alone.iter().enumerate() {
        let samples = self::samples(100, |_| *input);
        let run = Simulation::new(&wheels, &samples, 0.02).whole(&response);
        let last = run.last().map_or(f64::NAN, |motion| motion.velocity[axis]);
        let expected = if axis == 0 { 0.01 } else { 0.1 };
        assert!((last - expected).abs() < 0.012, "axis {axis}: {last}");
    }
    // Wheels that roll sideways roll forward as well: friction points against the whole motion.
    assert!(held.last().is_some_and(|motion| motion.velocity[0] > 0.03), "{:?}", held.last());
}
