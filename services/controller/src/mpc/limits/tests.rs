use super::*;
use crate::mpc::MpcError;
use crate::mpc::constraint::InputLimits;
use crate::mpc::tests::{circle, settings};
use model::Velocity;
use model::main_model::MainModel;
use model::predict::Belief;
use robot::{Drive, Robot};

/// A plan that begins with a jump of 1 m, and the largest motor current that it predicts.
fn most_foretold(mpc: &mut Mpc, belief: &Belief<'_>) -> f64 {
    let reference = circle(0, 7);
    mpc.reset();
    for _ in 0..3 {
        mpc.prepare(&reference, belief);
        let begin = State { pose: [-1.0, 0.0, 0.0], ..State::default() };
        let _solved = mpc.iterate(&begin, &[0.0; 3], &reference, belief);
    }
    mpc.foretold_currents().start.into_iter().fold(0.0, |most, share| share.abs().max(most))
}

#[test]
fn a_dropped_row_is_inactive_and_a_restored_row_is_active() -> Result<(), MpcError> {
    let mut robot = Robot::example();
    robot.drive = robot.drive.map(|drive| Drive { current_limit_a: 2.0, ..drive });
    let main = MainModel::new(&robot, 0.1);
    let belief = Belief::of(&main);
    let mut mpc = Mpc::new(&settings(), &robot, &main)?;
    let bound = most_foretold(&mut mpc, &belief);
    assert!((0.9..1.1).contains(&bound), "{bound}");
    mpc.drop_current_rows([true; WHEELS_MAX]);
    let free = most_foretold(&mut mpc, &belief);
    assert!(free > 1.5, "{free}");
    // An optimiser that inherits a plan keeps the dropped rows.
    let mut heir = Mpc::new(&settings(), &robot, &main)?;
    heir.inherit(&mpc);
    assert!(most_foretold(&mut heir, &belief) > 1.5);
    mpc.drop_current_rows([false; WHEELS_MAX]);
    let bound = most_foretold(&mut mpc, &belief);
    assert!((0.9..1.1).contains(&bound), "{bound}");
    Ok(())
}

#[test]
fn plans_and_fallbacks_keep_to_the_ramp_of_a_drive() -> Result<(), MpcError> {
    let (robot, rim) = (Robot::example(), 0.12);
    let main = MainModel::new(&robot, 0.1);
    let belief = Belief::of(&main);
    let mut mpc = Mpc::new(&settings(), &robot, &main)?;
    let without = Mpc::new(&settings(), &robot, &main)?;
    mpc.keep_to_ramp(Some(rim));
    let largest = |from: &Velocity, to: &Velocity| {
        let change: Velocity = std::array::from_fn(|axis| to[axis] - from[axis]);
        let rims = robot.wheels.rows().iter().map(|row| (0..3).map(|i| row[i] * change[i]).sum());
        rims.fold(0.0, |most: f64, rim: f64| most.max(rim.abs()))
    };
    // The robot rests, and the reference drives away.
    let (mut state, mut input) = (State::default(), [0.0; 3]);
    mpc.begin_at(&state);
    let mut reached = 0;
    for tick in 0..40 {
        let reference = circle(tick, mpc.horizon() + 1);
        mpc.prepare(&reference, &belief);
        assert!(mpc.iterate(&state, &input, &reference, &belief).outcome.usable());
        let inputs = mpc.stages().iter().take(mpc.blocks).map(|stage| stage.input);
        let mut before = input;
        for planned in inputs {
            assert!(largest(&before, &planned) < 1.001 * rim, "{before:?} to {planned:?}");
            before = planned;
        }
        reached += usize::from(mpc.reached_limit() == Some(RobotLimit::Ramp));
        let slower = mpc.limits().reach(&[0.0; 3], &input);
        assert!(largest(&input, &slower) < 1.001 * rim);
        // A robot in danger does not brake more slowly because of what was identified.
        assert_eq!(mpc.limits().brake(&input), without.limits().reach(&[0.0; 3], &input));
        input = mpc.stages()[0].input;
        state = belief.predict(&state, &input);
    }
    assert!(reached > 5, "{reached}");
    mpc.keep_to_ramp(None);
    assert!(largest(&[0.0; 3], &mpc.limits().reach(&[0.5, 0.0, 0.0], &[0.0; 3])) > 2.0 * rim);
    Ok(())
}

/// Largest motor current at the start of such a plan, whose robot rests, as a share of its limit.
fn largest_at_rest(mpc: &mut Mpc, robot: &Robot, belief: &Belief<'_>) -> f64 {
    most_foretold(mpc, belief);
    let rows = InputLimits::of(robot, belief.main.period).current.unwrap_or_default();
    let input = mpc.stages()[0].input;
    let shares = rows.map(|row| (0..3).map(|axis| row[axis] * input[axis]).sum::<f64>().abs());
    shares.into_iter().fold(0.0, f64::max)
}

#[test]
fn plans_keep_to_the_grip_of_the_floor_in_the_mean_over_a_period() -> Result<(), MpcError> {
    let mut robot = Robot::example();
    robot.drive = robot.drive.map(|drive| Drive { current_limit_a: 4.0, ..drive });
    for period in [0.1, 0.02] {
        let main = MainModel::new(&robot, period);
        let belief = Belief::of(&main);
        let mut mpc = Mpc::new(&settings(), &robot, &main)?;
        mpc.keep_to_grip(0.3);
        // The current decays by A in a period, so its mean is smaller than at its start.
        let bound = 0.3 * -main.decay[0].ln() / (1.0 - main.decay[0]);
        let largest = largest_at_rest(&mut mpc, &robot, &belief);
        assert!((0.99 * bound..1.01 * bound).contains(&largest), "{largest} is not {bound}");
        assert_eq!(mpc.reached_limit(), Some(RobotLimit::Grip));
        // An optimiser that inherits a plan keeps to it too.
        let mut heir = Mpc::new(&settings(), &robot, &main)?;
        heir.inherit(&mpc);
        assert!(largest_at_rest(&mut heir, &robot, &belief) < 1.01 * bound);
        mpc.keep_to_grip(1.0);
        assert!(largest_at_rest(&mut mpc, &robot, &belief) > 2.0 * bound);
        assert_eq!(mpc.reached_limit(), Some(RobotLimit::MotorCurrent));
    }
    Ok(())
}

#[test]
fn a_stiff_loop_may_saturate_at_the_start_of_a_long_period() -> Result<(), MpcError> {
    let mut robot = Robot::example();
    // The mean of the current is 0.34 of its start at 0.1 s with the fourfold gain.
    for (period, stiffer, most) in
        [(0.1, 1.0, 1.0), (0.1, 4.0, 1.8), (0.1, 20.0, 2.0), (0.02, 4.0, 1.0)]
    {
        robot.drive = Robot::example().drive.map(|drive| Drive {
            current_limit_a: 4.0,
            speed_loop_gain_a_s_per_rad: stiffer * drive.speed_loop_gain_a_s_per_rad,
            ..drive
        });
        let main = MainModel::new(&robot, period);
        let mut mpc = Mpc::new(&settings(), &robot, &main)?;
        let largest = largest_at_rest(&mut mpc, &robot, &Belief::of(&main));
        assert!((largest - most).abs() < 0.03, "{largest} is not {most}, {period} s, {stiffer}");
        assert_eq!(mpc.foretold_currents().most, mpc.limits().current_share());
    }
    Ok(())
}
