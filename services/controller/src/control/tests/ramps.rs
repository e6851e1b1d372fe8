//! Drives that change the set points of their wheels at a limited rate.

use super::*;
use robot::{PerWheel, WHEELS_MAX};

/// A drive of 1.2 m/s² at the rims, on a course that asks for 3 m/s².
const RATE_MPS2: f64 = 1.2;

/// Drives a robot whose wheels follow their set points as the belief says. Returns (the ramp that
/// was found, largest distance from the reference in the last 10 s \[m\]).
fn driven(with_wheels: bool) -> Result<(Option<f64>, f64), ControllerError> {
    const PERIOD_S: f64 = 0.02;
    let mut settings = told();
    settings.run.period_nanos = 20_000_000;
    settings.duration_s = 40.0;
    settings.mpc.observer_gain = 1.0;
    (settings.mpc.horizon_steps, settings.mpc.control_horizon_steps) = (20, 10);
    settings.mpc.state_limits = StateLimits::default();
    settings.reference.path = PathSettings::StopAndGo {
        stretch_m: 1.0,
        speed_mps: 0.8,
        acceleration_mps2: 3.0,
        pause_s: 0.5,
    };
    let (main, wheels) = (MainModel::new(&settings.robot, PERIOD_S), settings.robot.wheels);
    let belief = Belief::of(&main);
    let mut controller = Controller::new(&settings)?;
    let (mut robot, mut given) = (State::default(), [0.0; 3]);
    let (mut set_points, mut farthest): (PerWheel, f64) = ([0.0; WHEELS_MAX], 0.0);
    for tick in 0..2000 {
        let mut measured = state(tick);
        (measured.pose, measured.velocity) = (robot.pose, robot.velocity);
        measured.input = given;
        if with_wheels {
            measured.wheel_speed = wheels.speeds(robot.velocity);
            (measured.wheels, measured.wheel_speed_valid) = (wheels.count() as u32, 1);
        }
        given = answer(&mut controller, &measured).input;
        controller.explain(0);
        controller.prepare_next();
        if tick >= 1500 {
            let point = controller.planner.reference().at(tick);
            let [x, y] = [robot.pose[0] - point.pose[0], robot.pose[1] - point.pose[1]];
            farthest = farthest.max(x.hypot(y));
        }
        let mut means = set_points;
        for (wheel, (goal, radius)) in wheels.speeds(given).iter().zip(wheels.radii_m()).enumerate()
        {
            let most = RATE_MPS2 * PERIOD_S / radius;
            let change = (goal - set_points[wheel]).clamp(-most, most);
            set_points[wheel] += change;
            means[wheel] += 0.5 * change;
        }
        robot = belief.predict(&robot, &wheels.body(&means));
    }
    Ok((controller.knowledge().ramp_mps2(), farthest))
}

#[test]
fn plans_keep_to_the_ramp_of_a_drive_that_reports_its_wheels()
-> Result<(), Box<dyn std::error::Error>> {
    let ((found, farthest), (none, without)) = (driven(true)?, driven(false)?);
    let found = found.ok_or("no ramp was found")?;
    assert!((found / RATE_MPS2 - 1.0).abs() < 0.2, "{found}");
    assert_eq!(none, None);
    assert!(farthest < 0.8 * without, "{farthest} m, without wheels {without} m");
    Ok(())
}
