use super::*;
use motion::limits::Stated;
use motion::{Heading, Waypoint};
use protocol::message::GoalKind;
use robot::Shape;
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
    let request = GoalRequest::of(demand);
    Course::new(&request, 1, outlook, &Robot::example(), &Surroundings::default(), PERIOD_S)
}

fn demands() -> Vec<Demand> {
    let points = [[0.6, 0.0], [1.5, 1.0], [3.0, 1.0]];
    let points = points.map(Waypoint::at).to_vec();
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

/// Smallest speed of the reference until `before_end` ticks before its end \[m/s\].
fn slowest(course: &Course, before_end: u64) -> f64 {
    let ticks = course.goal.begins_at_tick..course.goal.ends_at_tick - before_end;
    let speeds = ticks.map(|tick| course.reference.at(tick).velocity);
    speeds.map(|[forward, left, _]| forward.hypot(left)).fold(f64::MAX, f64::min)
}

#[test]
fn a_path_that_is_given_in_motion_is_driven_without_a_stop() -> Outcome {
    for (first, heading) in [([0.6, 0.0], Heading::Keep), ([-0.1, 0.1], Heading::Tangent)] {
        let points = [first, [2.0, 0.5], [4.0, 0.5]].map(Waypoint::at).to_vec();
        let course = course(Demand::Path { points, heading }, &driving())?;
        let slowest = slowest(&course, 30);
        assert!(slowest > 0.3, "{first:?}: {slowest} m/s");
    }
    Ok(())
}

#[test]
fn a_path_that_leads_back_or_through_a_slow_zone_begins_with_a_stop() -> Outcome {
    let zone = Shape::hull(&[[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]], 0.0)?;
    let slow = Surroundings { zones: vec![(zone, 0.2)], ..Surroundings::default() };
    for (map, points) in
        [(Surroundings::default(), [[0.0, 0.0], [-3.0, 0.0]]), (slow, [[0.6, 0.0], [3.0, 0.0]])]
    {
        let points = points.map(Waypoint::at).to_vec();
        let request = GoalRequest::of(Demand::Path { points, heading: Heading::Keep });
        let course = Course::new(&request, 1, &driving(), &Robot::example(), &map, PERIOD_S)?;
        assert!(slowest(&course, 30) < 0.02, "{request:?}: {} m/s", slowest(&course, 30));
    }
    Ok(())
}

#[test]
fn a_goal_keeps_the_speed_of_a_zone() -> Outcome {
    let (robot, limit) = (Robot::example(), 0.3);
    let zone = Shape::hull(&[[2.0, -1.0], [3.0, -1.0], [3.0, 1.0], [2.0, 1.0]], 0.0)?;
    let map = Surroundings { zones: vec![(zone, limit)], ..Surroundings::default() };
    let standing = Outlook { velocity: [0.0; 3], points: Vec::new(), ..driving() };
    let path = Demand::Path {
        points: vec![Waypoint::at([0.1, 0.0]), Waypoint::at([5.0, 0.0])],
        heading: Heading::Keep,
    };
    for demand in [Demand::Pose { to: [5.0, 0.0, 0.0] }, path] {
        let request = GoalRequest::of(demand);
        for outlook in [&driving(), &standing] {
            let course = Course::new(&request, 1, outlook, &robot, &map, PERIOD_S)?;
            let ticks = outlook.tick..course.goal.ends_at_tick;
            let points: Vec<_> = ticks.map(|tick| course.reference.at(tick)).collect();
            let speed = |point: &ReferencePoint| point.velocity[0].hypot(point.velocity[1]);
            let touches = |point: &&ReferencePoint| {
                robot.footprint().shape().placed(&point.pose).separation(&zone).distance_m <= 0.0
            };
            let inside = points.iter().filter(touches).map(speed).fold(0.0, f64::max);
            assert!((0.2..=limit + 1e-6).contains(&inside), "{request:?}: {inside} m/s");
            let fastest = points.iter().map(speed).fold(0.0, f64::max);
            assert!(fastest > 2.0 * limit, "{request:?}: {fastest} m/s outside of the zone");
        }
    }
    Ok(())
}

#[test]
fn a_robot_that_is_too_fast_in_a_zone_stops_and_turns_where_it_stands() -> Outcome {
    let zone = Shape::hull(&[[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]], 0.0)?;
    let map = Surroundings { zones: vec![(zone, 0.2)], ..Surroundings::default() };
    let (robot, outlook) = (Robot::example(), driving());
    let hold = Course::new(&GoalRequest::of(Demand::Hold {}), 1, &outlook, &robot, &map, PERIOD_S)?;
    let [x, y, _] = hold.goal.target;
    let turn = GoalRequest::of(Demand::Pose { to: [x, y, 1.0] });
    let course = Course::new(&turn, 2, &outlook, &robot, &map, PERIOD_S)?;
    let [end_x, end_y, heading] = course.reference.at(course.goal.ends_at_tick).pose;
    assert_eq!([end_x, end_y], [x, y]);
    assert!((heading - 1.0).abs() < 1e-12, "{heading}");
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
        let request = GoalRequest { goal, limits, valid_s: Some(2.5) };
        assert_eq!(GoalRequest::parse(&request.text())?, request);
    }
    Ok(())
}

#[test]
fn a_goal_that_is_taken_after_its_time_is_refused() {
    for goal in demands() {
        let is_velocity = goal.kind() == GoalKind::Velocity;
        let request = GoalRequest::of(goal);
        assert!(request.check_age(1.9).is_ok());
        let late = request.check_age(2.1);
        assert_eq!(matches!(late, Err(GoalError::Ended { .. })), is_velocity, "{request:?}");
        let soon = GoalRequest { valid_s: Some(0.5), ..request };
        assert!(soon.check_age(0.4).is_ok());
        assert!(matches!(soon.check_age(0.6), Err(GoalError::Ended { .. })), "{soon:?}");
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
    let never = "valid_s = 0.0\n[goal.hold]";
    assert!(matches!(refused(never), Some(GoalError::BeginsWithin { .. })));

    let far = course(Demand::Pose { to: [f64::NAN, 0.0, 0.0] }, &driving()).err();
    assert!(matches!(far, Some(GoalError::Motion(MotionError::NotFinite { .. }))));
    let slow = Stated { speed_mps: Some(1e-3), ..Stated::default() };
    let request =
        GoalRequest { limits: slow, ..GoalRequest::of(Demand::Pose { to: [900.0, 0.0, 0.0] }) };
    let long =
        Course::new(&request, 1, &driving(), &Robot::example(), &Surroundings::default(), PERIOD_S)
            .err();
    assert!(matches!(long, Some(GoalError::TooLong { .. })), "{long:?}");
    for gate in [GateState::Disarmed, GateState::Stopped] {
        let shut = course(Demand::Hold {}, &Outlook { gate, ..driving() }).err();
        assert!(matches!(shut, Some(GoalError::Shut { state }) if state == gate));
    }
}
