use super::*;
use std::error::Error;

type Outcome = Result<(), Box<dyn Error>>;

const PERIOD_S: f64 = 0.02;

/// A robot that follows its reference forward at 0.5 m/s.
pub(super) fn driving() -> Outlook {
    let points = (0..40).map(|tick| ReferencePoint {
        pose: [0.5 * PERIOD_S * f64::from(tick), 0.0, 0.0],
        velocity: [0.5, 0.0, 0.0],
        course: 0.0,
    });
    Outlook {
        plant_epoch: 3,
        tick: 100,
        points: points.collect(),
        pose: [0.0; 3],
        velocity: [0.5, 0.0, 0.0],
        gate: GateState::Driving,
        obstacles: Vec::new(),
        goal: None,
        held_up: false,
    }
}

fn course(demand: Demand, outlook: &Outlook) -> Result<Course, GoalError> {
    let request = GoalRequest { goal: demand, limits: Stated::default() };
    Course::new(&request, 1, outlook, &Robot::example(), &Surroundings::default(), PERIOD_S)
}

fn demands() -> Vec<Demand> {
    let points = [[0.6, 0.0], [1.5, 1.0], [3.0, 1.0]];
    let points = points.map(|position| Waypoint { position, yaw: None }).to_vec();
    vec![
        Demand::Hold {},
        Demand::Pose { to: [2.0, 1.0, 1.5] },
        Demand::Path { points, heading: Heading::Tangent },
        Demand::Velocity { velocity: [0.3, 0.2, 0.4], valid_s: 2.0 },
    ]
}

#[test]
fn a_goal_continues_the_reference_without_a_jump_and_ends_at_rest() -> Outcome {
    let (robot, outlook) = (Robot::example(), driving());
    let most = Limits::of(&robot).acceleration_mps2 * PERIOD_S * 1.5;
    for demand in demands() {
        let course = course(demand.clone(), &outlook)?;
        for (tick, point) in (outlook.tick..course.latest_tick).zip(&outlook.points) {
            assert_eq!(course.reference.at(tick), *point, "{demand:?}, tick {tick}");
        }
        for tick in outlook.tick..course.goal.ends_at_tick {
            let [a, b] = [tick, tick + 1].map(|tick| course.reference.at(tick));
            let [before, after] = [a, b].map(|point| in_world(&point.pose, &point.velocity));
            for axis in 0..2 {
                let change = (after[axis] - before[axis]).abs();
                assert!(change < most, "{demand:?}, tick {tick}, axis {axis}: {change} m/s");
                let moved = b.pose[axis] - a.pose[axis];
                let mean = 0.5 * PERIOD_S * (before[axis] + after[axis]);
                assert!((moved - mean).abs() < 2e-3, "{demand:?}, tick {tick}: {moved} {mean}");
            }
        }
        let end = course.reference.at(course.goal.ends_at_tick);
        assert_eq!((end.velocity, end.pose), ([0.0; 3], course.goal.target), "{demand:?}");
        assert_eq!(course.left_m.last(), Some(&0.0));
        assert_eq!(course.goal.kind(), demand.kind());
    }
    Ok(())
}

#[test]
fn a_robot_that_is_far_from_its_reference_begins_where_it_is() -> Outcome {
    let mut outlook = driving();
    (outlook.pose, outlook.velocity) = ([5.0, 5.0, 1.0], [0.0; 3]);
    let course = course(Demand::Pose { to: [6.0, 5.0, 1.0] }, &outlook)?;
    assert_eq!(course.reference.at(outlook.tick).pose, [5.0, 5.0, 1.0]);
    Ok(())
}

#[test]
fn a_request_is_the_same_after_its_text() -> Outcome {
    for goal in demands() {
        let limits = Stated { speed_mps: Some(0.4), ..Stated::default() };
        let request = GoalRequest { goal, limits };
        assert_eq!(GoalRequest::parse(&request.text())?, request);
    }
    Ok(())
}

#[test]
fn a_velocity_that_is_taken_after_its_time_is_refused_and_a_pose_is_not() {
    for goal in demands() {
        let is_velocity = goal.kind() == GoalKind::Velocity;
        let request = GoalRequest { goal, limits: Stated::default() };
        assert!(request.check_age(1.9).is_ok());
        let late = request.check_age(2.1);
        assert_eq!(matches!(late, Err(GoalError::Ended { .. })), is_velocity, "{request:?}");
    }
}

#[test]
fn goals_that_no_robot_can_do_are_refused() {
    let refused = |text: &str| GoalRequest::parse(text).err();
    assert!(matches!(refused("goal = 3"), Some(GoalError::Syntax { .. })));
    assert!(matches!(refused("[goal.pose]\nto = [1.0, 2.0]"), Some(GoalError::Syntax { .. })));
    assert!(matches!(refused("[goal.hold]\nnow = true"), Some(GoalError::Syntax { .. })));
    let slow = "[goal.hold]\n[limits]\nspeed_mps = -1.0";
    assert!(matches!(refused(slow), Some(GoalError::Limit { key: "speed_mps", .. })));
    let forever = "[goal.velocity]\nvelocity = [0.1, 0.0, 0.0]\nvalid_s = 1e9";
    assert!(matches!(refused(forever), Some(GoalError::Validity { .. })));

    let far = course(Demand::Pose { to: [f64::NAN, 0.0, 0.0] }, &driving()).err();
    assert!(matches!(far, Some(GoalError::Motion(MotionError::NotFinite { .. }))));
    let slow = Stated { speed_mps: Some(1e-3), ..Stated::default() };
    let request = GoalRequest { goal: Demand::Pose { to: [900.0, 0.0, 0.0] }, limits: slow };
    let long =
        Course::new(&request, 1, &driving(), &Robot::example(), &Surroundings::default(), PERIOD_S)
            .err();
    assert!(matches!(long, Some(GoalError::TooLong { .. })), "{long:?}");
    for gate in [GateState::Disarmed, GateState::Stopped] {
        let shut = course(Demand::Hold {}, &Outlook { gate, ..driving() }).err();
        assert!(matches!(shut, Some(GoalError::Shut { state }) if state == gate));
    }
}
