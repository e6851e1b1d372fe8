use super::*;
use crate::mpc::MpcError;
use crate::mpc::tests::{circle, settings};
use crate::settings::{MpcSettings, StateLimits};
use model::predict::Belief;
use robot::Robot;

#[test]
fn the_fallback_takes_one_level_after_the_other() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let mpc = Mpc::new(&settings(), &Robot::example(), &main)?;
    let mut fallback_choice = FallbackChoice::default();
    let mut fallback_level = |status| {
        let outcome = Outcome { status, iterations: 1 };
        fallback_choice
            .choose(outcome, &mpc, &[0.0; 3])
            .map_or(FallbackLevel::Simple, |(fallback_level, _)| fallback_level)
    };
    let (good, bad) = (Status::Solved, Status::OutOfIterations);
    assert_eq!(fallback_level(bad), FallbackLevel::Simple);
    assert_eq!(fallback_level(good), FallbackLevel::FreshPlan);
    assert_eq!(
        (fallback_level(bad), fallback_level(bad), fallback_level(bad)),
        (FallbackLevel::ShiftedPlan, FallbackLevel::ShiftedPlan, FallbackLevel::Simple)
    );
    assert_eq!(
        (fallback_level(good), fallback_level(Status::Unpredictable)),
        (FallbackLevel::FreshPlan, FallbackLevel::Simple)
    );
    // A plan that was not renewed while another controller drove is not shifted.
    for (status, expected) in [(bad, FallbackLevel::Simple), (good, FallbackLevel::ShiftedPlan)] {
        fallback_choice.look(Outcome { status, iterations: 1 });
        let outcome = Outcome { status: bad, iterations: 1 };
        let chosen = fallback_choice.choose(outcome, &mpc, &[0.0; 3]);
        assert_eq!(
            chosen.map_or(FallbackLevel::Simple, |(fallback_level, _)| fallback_level),
            expected
        );
    }
    Ok(())
}

#[test]
fn the_lqr_alone_brings_the_robot_to_its_reference() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let belief = Belief::of(&main);
    let settings = MpcSettings { state_limits: StateLimits::default(), ..settings() };
    let mpc = Mpc::new(&settings, &Robot::example(), &main)?;
    let (mut state, mut input) =
        (State { pose: [0.3, -0.2, 0.2], velocity: [0.0; 3], ..State::default() }, [0.0; 3]);
    for tick in 0..80 {
        let point = &circle(tick, 1)[0];
        let target = mpc.main_target(&main, point, state.pose[2], &[0.0; 3]);
        input = lqr(&mpc, &state, point, &target, &input);
        state = belief.predict(&state, &input);
    }
    let error = TrackingError::new(&state, &circle(80, 1)[0]).value;
    assert!(error.iter().all(|value| value.abs() < 0.1), "{error:?}");
    Ok(())
}

#[test]
fn the_simple_controller_alone_brings_the_robot_to_its_reference() -> Result<(), MpcError> {
    let main = MainModel::new(&Robot::example(), 0.1);
    let belief = Belief::of(&main);
    let settings = MpcSettings { state_limits: StateLimits::default(), ..settings() };
    let mpc = Mpc::new(&settings, &Robot::example(), &main)?;
    let (mut state, mut input) =
        (State { pose: [0.3, -0.2, 0.2], velocity: [0.0; 3], ..State::default() }, [0.0; 3]);
    for tick in 0..80 {
        input = simple(&mpc, &main, &state.pose, &circle(tick, 1)[0], &input);
        state = belief.predict(&state, &input);
    }
    let error = TrackingError::new(&state, &circle(80, 1)[0]).value;
    assert!(error.rows(0, 2).norm() < 0.05, "{error}");
    Ok(())
}
