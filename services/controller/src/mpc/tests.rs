use super::*;
use crate::settings::{
    DelaySetting, Identify, Linearise, Method, Observers, SolverSetting, StateLimits, Weights,
};
use model::delay::Delay;
use model::learned::{Moment, Residual, Response};
use proptest::prelude::*;
use robot::Drive;

pub(crate) fn settings() -> MpcSettings {
    MpcSettings {
        horizon_steps: 6,
        control_horizon_steps: 3,
        weights: Weights {
            position: 10.0,
            heading: 5.0,
            velocity: 2.0,
            yaw_rate: 1.0,
            input: 0.05,
            input_change: 0.2,
            terminal_factor: 3.0,
        },
        state_limits: StateLimits {
            heading_rad: Some(1.0),
            speed_mps: Some(3.5),
            ..StateLimits::default()
        },
        observer_gain: 0.3,
        method: Method::Mpc,
        delay: DelaySetting::Estimated,
        identify: Identify::Response,
        observers: Observers::Gains,
        no_harm: true,
        linearise: Linearise::Measured,
        solver: SolverSetting::ActiveSet,
        budget_share: 0.5,
    }
}

/// Points on a circle of radius 2 m at 1.5 m/s.
pub(crate) fn circle(from: u64, count: usize) -> Vec<ReferencePoint> {
    (from..).take(count).map(|tick| circle_at(0.1 * tick as f64)).collect()
}

fn circle_at(time: f64) -> ReferencePoint {
    let yaw = 0.75 * time;
    ReferencePoint {
        pose: [2.0 * yaw.sin(), 2.0 * (1.0 - yaw.cos()), yaw],
        velocity: [1.5, 0.0, 0.75],
        course: yaw,
    }
}

/// The cost in the module's head, without slacks, of the current plan of `mpc`.
fn true_cost(
    mpc: &Mpc,
    state: &State,
    deviation: &[Velocity],
    last_input: &Velocity,
    reference: &[ReferencePoint],
    belief: &Belief<'_>,
) -> f64 {
    let w = settings().weights;
    let q = [w.position, w.position, w.heading, w.velocity, w.velocity, w.yaw_rate];
    let (mut at, mut before, mut cost) = (*state, *last_input, 0.0);
    for (k, stage) in mpc.stages.iter().enumerate() {
        let deviation = deviation[k.min(mpc.blocks - 1)];
        let input: Velocity = std::array::from_fn(|axis| stage.target[axis] + deviation[axis]);
        at = belief.predict(&at, belief.acting(&before, &input));
        let factor = if k + 1 == mpc.horizon { w.terminal_factor } else { 1.0 };
        let error = TrackingError::new(&at, &reference[k + 1]);
        cost += 0.5 * factor * error.value.iter().zip(q).map(|(e, q)| q * e * e).sum::<f64>();
        for axis in 0..3 {
            cost += 0.5 * w.input * deviation[axis].powi(2);
            cost += 0.5
                * w.input_change
                * if k < mpc.blocks { (input[axis] - before[axis]).powi(2) } else { 0.0 };
        }
        before = input;
    }
    cost
}

/// A residual that depends on the input of the previous period.
#[derive(Debug)]
struct Echo;

impl Residual for Echo {
    fn mean(&self, at: &Moment) -> Velocity {
        at.before.map(|input| 0.125 * input)
    }

    fn response(&self, at: &Moment) -> Response {
        let by_before = std::array::from_fn(|row| {
            std::array::from_fn(|column| if row == column { 0.125 } else { 0.0 })
        });
        Response { mean: self.mean(at), by_before, ..Response::NONE }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_programs_gradient_is_that_of_the_cost(
        pose in prop::array::uniform3(-0.4..0.4_f64),
        velocity in prop::array::uniform3(-0.8..0.8_f64),
        input in prop::array::uniform3(-0.5..0.5_f64),
        dead_time in prop_oneof![Just(0.0), 0.0..1.0_f64], echoes in any::<bool>()
    ) {
        let main = MainModel::new(&Robot::example(), 0.1);
        let learned = echoes.then_some(&Echo as &dyn Residual);
        let belief = Belief {
            main: &main,
            learned,
            foresight: None,
            disturbance: [0.02, -0.01, 0.03],
            split: Delay::of_periods(dead_time, &main).split(),
        };
        let mut mpc = Mpc::new(&settings(), &Robot::example(), &main)
            .map_err(|e| TestCaseError::fail(e.to_string()))?;
        let (state, reference) = (State { pose, velocity, ..State::default() }, circle(0, 7));
        mpc.begin_at(&state);
        mpc.prepare(&reference, &belief);
        mpc.roll_out(&state, &input, &belief);
        mpc.program.set_dynamics(&mpc.steps, &belief.split);
        mpc.build(&input, &reference);
        let gradient = oracle::Dense::of(&mpc.program).gradient;
        let deviation = mpc.deviation.clone();
        let step = 1e-6;
        for variable in 0..9 {
            let moved = |by: f64| {
                let mut deviation = deviation.clone();
                deviation[variable / 3][variable % 3] += by;
                true_cost(&mpc, &state, &deviation, &input, &reference, &belief)
            };
            let numeric = (moved(step) - moved(-step)) / (2.0 * step);
            let written = gradient[variable];
            prop_assert!(
                (numeric - written).abs() < 1e-5 * (1.0 + numeric.abs()),
                "variable {}: {} is not {}", variable, written, numeric
            );
        }
    }

    #[test]
    fn there_is_an_input_within_the_limits_for_every_state(
        pose in prop::array::uniform3(-50.0..50.0_f64),
        velocity in prop::array::uniform3(-8.0..8.0_f64),
        last in prop::array::uniform3(-4.0..4.0_f64)
    ) {
        let main = MainModel::new(&Robot::example(), 0.1);
        let belief = Belief::of(&main);
        let mut mpc = Mpc::new(&settings(), &Robot::example(), &main)
            .map_err(|e| TestCaseError::fail(e.to_string()))?;
        let last = mpc.limits.clamp(&last);
        mpc.prepare(&circle(0, 7), &belief);
        let solved = mpc.iterate(
            &State { pose, velocity, ..State::default() },
            &last,
            &circle(0, 7),
            &belief,
        );
        prop_assert!(solved.outcome.usable(), "{:?}", solved.outcome);
        let input = mpc.stages[0].input;
        for (value, bound) in input.iter().zip([5.0, 5.0, 6.0]) {
            prop_assert!(value.abs() <= bound + 1e-9);
        }
        for (value, before, change) in
            [(input[0], last[0], 6.0), (input[1], last[1], 6.0), (input[2], last[2], 12.0)]
        {
            prop_assert!((value - before).abs() <= change + 1e-4);
        }
    }
}

/// Points on a straight line at 1.5 m/s.
fn line(from: u64, count: usize) -> Vec<ReferencePoint> {
    let at = |tick: u64| ReferencePoint {
        pose: [0.15 * tick as f64, 0.0, 0.0],
        velocity: [1.5, 0.0, 0.0],
        course: 0.0,
    };
    (from..).take(count).map(at).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Without rotation, prediction and error are linear, so the point of linearisation makes no
    /// difference; turning has a very high weight here. A residual that depends on the input is an
    /// exception: a current row keeps the plan's residual. In that case currents are not limited.
    #[test]
    fn on_a_straight_line_a_surprise_is_answered_like_a_known_state(
        place in prop::array::uniform2(-0.5..0.5_f64),
        velocity in prop::array::uniform2(-0.6..0.6_f64),
        acted in prop::array::uniform2(-0.5..0.5_f64),
        push in prop::array::uniform2(-0.05..0.05_f64),
        dead_time in prop_oneof![Just(0.0), 0.0..1.0_f64], echoes in any::<bool>()
    ) {
        let main = MainModel::new(&Robot::example(), 0.1);
        let learned = echoes.then_some(&Echo as &dyn Residual);
        let belief = Belief {
            main: &main,
            learned,
            foresight: None,
            disturbance: [0.01, -0.02, 0.0],
            split: Delay::of_periods(dead_time, &main).split(),
        };
        let surprised = Belief { disturbance: [push[0], push[1], 0.0], ..belief };
        let start =
            State { pose: [0.0, 0.1, 0.0], velocity: [1.4, 0.0, 0.0], acted: [1.5, 0.0, 0.0] };
        let mut robot = Robot::example();
        if echoes {
            robot.drive = robot.drive.map(|drive| Drive { current_limit_a: 1e6, ..drive });
        }
        let mut plans = Vec::new();
        for linearise in [Linearise::Measured, Linearise::Expected] {
            let weights = Weights { heading: 1e7, yaw_rate: 1e7, ..settings().weights };
            let settings = MpcSettings { weights, linearise, ..settings() };
            let mut mpc = Mpc::new(&settings, &robot, &main)
                .map_err(|e| TestCaseError::fail(e.to_string()))?;
            mpc.begin_at(&start);
            mpc.prepare(&line(0, 7), &belief);
            let last = [1.5, 0.0, 0.0];
            mpc.iterate(&start, &last, &line(0, 7), &belief);
            let last = mpc.stages()[0].input;
            mpc.prepare(&line(1, 7), &belief);
            mpc.expect(&last, &line(1, 7), &belief);
            prop_assert_eq!(mpc.expectation.is_some(), linearise == Linearise::Expected);
            mpc.rehearse(&last, &line(1, 7), &belief);
            let seen = State {
                pose: [0.15 + place[0], 0.1 + place[1], 0.0],
                velocity: [1.4 + velocity[0], velocity[1], 0.0],
                acted: [1.5 + acted[0], acted[1], 0.0],
            };
            let solved = mpc.iterate(&seen, &last, &line(1, 7), &surprised);
            prop_assert!(solved.outcome.usable(), "{:?}", solved.outcome);
            let states = mpc.stages().iter().map(|stage| stage.state).chain([mpc.terminal]);
            let numbers = states
                .flat_map(|state| state.to_array())
                .chain(mpc.stages().iter().flat_map(|stage| stage.input));
            plans.push(numbers.collect::<Vec<f64>>());
        }
        for (measured, expected) in plans[0].iter().zip(&plans[1]) {
            prop_assert!((measured - expected).abs() < 1e-6, "{} is not {}", expected, measured);
        }
    }
}

#[test]
fn an_unexpected_state_is_answered_from_the_measurement() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let belief = Belief::of(&main);
    let settings = MpcSettings { linearise: Linearise::Expected, ..settings() };
    let start = State { velocity: [1.5, 0.0, 0.75], ..State::default() };
    let turned = State { pose: [0.0, 0.0, 0.075 - std::f64::consts::TAU], ..start };
    for (state, last) in [(turned, [1.5, 0.0, 0.75]), (start, [1.0, 0.0, 0.0])] {
        let (mut ready, mut other) = (
            Mpc::new(&settings, &Robot::example(), &main)?,
            Mpc::new(&settings, &Robot::example(), &main)?,
        );
        for mpc in [&mut ready, &mut other] {
            mpc.begin_on(&circle(0, 7));
            mpc.prepare(&circle(0, 7), &belief);
        }
        ready.expect(&[1.5, 0.0, 0.75], &circle(0, 7), &belief);
        for mpc in [&mut ready, &mut other] {
            mpc.iterate(&state, &last, &circle(0, 7), &belief);
        }
        assert_eq!(ready.stages()[0].input, other.stages()[0].input);
        assert_eq!(ready.stages()[0].state, state);
    }
    Ok(())
}

#[test]
fn without_active_limits_the_answer_is_the_newton_step() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let belief = Belief::of(&main);
    let mut mpc = Mpc::new(&settings(), &Robot::example(), &main)?;
    let state = State { pose: [0.02, -0.03, 0.01], velocity: [1.4, 0.0, 0.7], ..State::default() };
    mpc.prepare(&circle(0, 7), &belief);
    let outcome = mpc.iterate(&state, &[1.5, 0.0, 0.75], &circle(0, 7), &belief).outcome;
    assert_eq!(outcome.status, Status::Solved);
    let program = oracle::Dense::of(&mpc.program);
    let newton = program.hessian.view((0, 0), (9, 9)).lu().solve(&-program.gradient.rows(0, 9));
    let newton = newton.unwrap_or_else(|| nalgebra::DVector::zeros(9));
    for (ours, exact) in mpc.solution.iter().zip(newton.iter()) {
        assert!((ours - exact).abs() < 1e-6, "{ours} is not {exact}");
    }
    Ok(())
}

#[test]
fn a_robot_that_matches_the_belief_converges_to_its_reference() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let belief = Belief::of(&main);
    let mut mpc = Mpc::new(&settings(), &Robot::example(), &main)?;
    let (mut state, mut input) =
        (State { pose: [0.0, -0.8, 0.3], velocity: [0.0; 3], ..State::default() }, [0.0; 3]);
    for tick in 0..40 {
        mpc.prepare(&circle(tick, 7), &belief);
        assert!(mpc.iterate(&state, &input, &circle(tick, 7), &belief).outcome.usable());
        input = mpc.stages[0].input;
        state = belief.predict(&state, &input);
    }
    let end = circle(40, 1)[0];
    let error = TrackingError::new(&state, &end).value;
    assert!(error.rows(0, 2).norm() < 5e-3, "{error}");
    Ok(())
}

#[test]
fn the_observer_compensates_a_constant_push() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let mut mpc = Mpc::new(&settings(), &Robot::example(), &main)?;
    let mut disturbance = [0.0; 3];
    let still = vec![ReferencePoint::default(); 7];
    let push = [0.05, -0.03, 0.02];
    let (mut state, mut input) = (State::default(), [0.0; 3]);
    for _ in 0..120 {
        let belief = Belief { disturbance, ..Belief::of(&main) };
        mpc.prepare(&still, &belief);
        assert!(mpc.iterate(&state, &input, &still, &belief).outcome.usable());
        input = mpc.stages[0].input;
        let next = Belief { disturbance: push, ..belief }.predict(&state, &input);
        let residual = model::residual::residual(&main, &state.velocity, &input, &next.velocity);
        for (d, seen) in disturbance.iter_mut().zip(residual) {
            *d += 0.3 * (seen - *d);
        }
        state = next;
    }
    assert!(state.pose[0].hypot(state.pose[1]) < 1e-4, "{:?}", state.pose);
    Ok(())
}

#[test]
fn an_optimiser_at_its_deadline_stops_and_the_next_answer_is_unaffected() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let belief = Belief::of(&main);
    for solver in [SolverSetting::ActiveSet, SolverSetting::Clarabel] {
        let settings = MpcSettings { solver, ..settings() };
        let (mut stopped, mut other) = (
            Mpc::new(&settings, &Robot::example(), &main)?,
            Mpc::new(&settings, &Robot::example(), &main)?,
        );
        let state = State { pose: [0.4, -0.3, 0.1], velocity: [1.0, 0.0, 0.7], ..State::default() };
        for mpc in [&mut stopped, &mut other] {
            mpc.prepare(&circle(0, 7), &belief);
        }
        stopped.take_turn(Turn { tick: Some(0), until: Some(0) });
        assert_eq!(
            stopped.iterate(&state, &[0.0; 3], &circle(0, 7), &belief).outcome.status,
            Status::OutOfTime,
            "{solver:?}"
        );
        stopped.take_turn(Turn { tick: Some(0), until: Some(u64::MAX - 1) });
        for mpc in [&mut stopped, &mut other] {
            assert_eq!(
                mpc.iterate(&state, &[0.0; 3], &circle(0, 7), &belief).outcome.status,
                Status::Solved,
                "{solver:?}"
            );
        }
        assert_eq!(stopped.stages()[0].input, other.stages()[0].input, "{solver:?}");
    }
    Ok(())
}
