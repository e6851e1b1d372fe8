//! Faults of the optimiser and of sensors, and what is driven instead.

use super::*;

#[test]
fn no_answer_of_a_faulty_optimiser_is_driven_and_every_command_is_valid()
-> Result<(), Box<dyn std::error::Error>> {
    for kind in [
        SolverFaultKind::Infeasible,
        SolverFaultKind::OutOfIterations,
        SolverFaultKind::Nan,
        SolverFaultKind::Wrong,
    ] {
        let fault = SolverFault { kind, from_tick: 20, until_tick: Some(1020), probability: 1.0 };
        let mut settings = told();
        (settings.duration_s, settings.solver_faults) =
            (110.0, SolverFaults { seed: 5, solver: vec![fault] });
        let mut robot = Robotic::new(&settings)?;
        let mut fallback_levels = [0; 3];
        for tick in 0..1060 {
            let (verdict, command) = robot.drive(tick);
            assert_eq!((verdict, command.stamp.tick), (Ok(()), tick), "{kind:?}");
            match (command.fallback_level(), (20..1020).contains(&tick)) {
                (FallbackLevel::FreshPlan, false) => fallback_levels[0] += 1,
                (FallbackLevel::ShiftedPlan, true) => fallback_levels[1] += 1,
                (FallbackLevel::Simple, true) => fallback_levels[2] += 1,
                (fallback_level, _) => {
                    return Err(format!("{kind:?}: {fallback_level} at tick {tick}").into());
                }
            }
        }
        assert_eq!(fallback_levels, [60, 2, 998], "{kind:?}");
    }
    Ok(())
}

#[test]
fn occasional_faults_are_answered_by_shifted_plans_and_the_next_plan_is_fresh()
-> Result<(), Box<dyn std::error::Error>> {
    let mut settings = told();
    let fault = |kind| SolverFault { kind, from_tick: 5, until_tick: None, probability: 0.2 };
    settings.duration_s = 30.0;
    settings.mpc.state_limits = StateLimits::default();
    settings.solver_faults = SolverFaults {
        seed: 9,
        solver: vec![fault(SolverFaultKind::Wrong), fault(SolverFaultKind::Nan)],
    };
    let mut robot = Robotic::new(&settings)?;
    let mut fallback_levels = Vec::new();
    for tick in 0..250 {
        let (verdict, command) = robot.drive(tick);
        let well = settings.solver_faults.strike(tick).is_none();
        assert_eq!(
            (verdict, command.fallback_level() == FallbackLevel::FreshPlan),
            (Ok(()), well),
            "{tick}"
        );
        fallback_levels.push(command.fallback_level());
    }
    assert!(fallback_levels.contains(&FallbackLevel::ShiftedPlan));
    Ok(())
}

#[test]
fn a_command_that_the_gate_would_refuse_is_replaced_by_the_next_fallback_level()
-> Result<(), Box<dyn std::error::Error>> {
    let mut controller = controller()?;
    let mut weak = told().robot;
    (weak.limits.input_mps, weak.limits.yaw_input_radps) = (0.1, 0.1);
    controller.guard.bounds = Bounds::new(&weak, PERIOD_NANOS, 0);
    for tick in 0..5 {
        let command = answer(&mut controller, &state(tick));
        assert_eq!(
            (command.fallback_level(), command.input, command.tail),
            (FallbackLevel::Brake, [0.0; 3], [[0.0; 3]; TAIL_MAX]),
            "plan and simple controller are too fast"
        );
    }
    controller.guard.bounds = Bounds::new(&told().robot, PERIOD_NANOS, 0);
    assert_eq!(answer(&mut controller, &state(5)).fallback_level(), FallbackLevel::FreshPlan);
    Ok(())
}

#[test]
fn stuck_sensors_are_answered_with_the_brake_until_they_move_again()
-> Result<(), Box<dyn std::error::Error>> {
    let mut robot = Robotic::new(&told())?;
    for tick in 0..30 {
        assert_eq!(robot.drive(tick).1.fallback_level(), FallbackLevel::FreshPlan);
    }
    robot.stuck = Some(robot.state);
    let fallback_levels: Vec<FallbackLevel> =
        (30..50).map(|tick| robot.drive(tick).1.fallback_level()).collect();
    assert_eq!(
        (&fallback_levels[..3], &fallback_levels[3..]),
        (&[FallbackLevel::FreshPlan; 3][..], &[FallbackLevel::Brake; 17][..])
    );
    assert_eq!(
        robot.controller.sensor_fault(),
        Some(SensorFault::Everything),
        "not even the brake changes anything"
    );
    robot.stuck = None;
    assert_eq!(robot.drive(50).1.fallback_level(), FallbackLevel::FreshPlan);
    Ok(())
}

#[test]
fn a_blind_robot_brakes_to_rest_with_small_input_changes() -> Result<(), Box<dyn std::error::Error>>
{
    let mut settings = told();
    settings.robot.limits.input_rate_mps2 = 2.0;
    settings.robot.limits.yaw_input_rate_radps2 = 4.0;
    let mut robot = Robotic::new(&settings)?;
    for tick in 0..30 {
        assert_eq!(robot.drive(tick).0, Ok(()), "tick {tick}");
    }
    let speed = robot.input[0].hypot(robot.input[1]);
    assert!(speed > 3.0 * 0.2, "{speed} m/s is less than some changes of a period");
    robot.stuck = Some(robot.state);
    for tick in 30..80 {
        assert_eq!(robot.drive(tick).0, Ok(()), "tick {tick}");
    }
    assert_eq!(robot.input, [0.0; 3]);
    Ok(())
}
