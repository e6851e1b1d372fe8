//! Dead times that plans compensate, and one that they do not.

use super::*;

/// Drives a robot that matches the belief except for a dead time. Returns (answers of the simple
/// controller, largest distance from the reference in the last 10 s \[m\]).
fn with_a_dead_time_of(periods: usize) -> Result<(usize, f64), ControllerError> {
    const PERIOD_S: f64 = 0.02;
    let mut settings = told();
    settings.run.period_nanos = 20_000_000;
    settings.duration_s = 50.0;
    settings.mpc.observer_gain = 1.0;
    settings.mpc.state_limits = StateLimits::default();
    settings.reference.path = PathSettings::Circle { radius_m: 2.0, speed_mps: 0.8 };
    settings.reference.ramp_s = 1.0;
    let main = MainModel::new(&settings.robot, PERIOD_S);
    let belief = Belief::of(&main);
    let mut controller = Controller::new(&settings)?;
    let mut under_way = std::collections::VecDeque::from(vec![[0.0; 3]; periods]);
    let (mut robot, mut given, mut fallback_level) =
        (State::default(), [0.0; 3], FallbackLevel::Waiting);
    let (mut simple, mut farthest) = (0, 0.0_f64);
    for tick in 0..2500 {
        let mut measured = state(tick);
        (measured.pose, measured.velocity) = (robot.pose, robot.velocity);
        (measured.input, measured.fallback_level) = (given, fallback_level.code());
        let command = answer(&mut controller, &measured);
        controller.explain(0);
        controller.prepare_next();
        (given, fallback_level) = (command.input, command.fallback_level());
        simple += usize::from(fallback_level == FallbackLevel::Simple);
        if tick >= 2000 {
            let point = controller.planner.reference().at(tick);
            let [x, y] = [robot.pose[0] - point.pose[0], robot.pose[1] - point.pose[1]];
            farthest = farthest.max(x.hypot(y));
        }
        under_way.push_back(given);
        let acting = under_way.pop_front().unwrap_or_default();
        robot = belief.predict(&robot, &acting);
    }
    Ok((simple, farthest))
}

/// 240 ms: more than the controller can compensate.
#[test]
fn the_simple_controller_drives_where_plans_do_not_hold_the_robot()
-> Result<(), Box<dyn std::error::Error>> {
    let (simple, farthest) = with_a_dead_time_of(12)?;
    assert!(simple > 100 && farthest < 0.05, "{simple} periods, {farthest} m");
    Ok(())
}

#[test]
fn plans_always_drive_where_they_hold_the_robot() -> Result<(), Box<dyn std::error::Error>> {
    for periods in [0, 3, 6] {
        let (simple, farthest) = with_a_dead_time_of(periods)?;
        assert!(simple == 0 && farthest < 0.001, "{periods}: {simple} periods, {farthest} m");
    }
    Ok(())
}
