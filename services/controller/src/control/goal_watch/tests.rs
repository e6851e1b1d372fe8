use super::super::tests::{Robotic, answer, state, told};
use crate::goal::{Course, Demand, GoalRequest, Outlook};
use model::State;
use protocol::message::{GateState, Goal, GoalPhase};
use robot::Surroundings;
use std::error::Error;
use std::ops::Range;

type Outcome = Result<(), Box<dyn Error>>;

/// Period of the settings of these tests \[s\].
const PERIOD_S: f64 = 0.1;
/// Periods within which a goal of some metres is reached for sure.
const LONG: u64 = 150;

/// A pose as a goal that begins with what the robot does now.
fn course(robot: &Robotic, id: u64, to: [f64; 3]) -> Result<Course, Box<dyn Error>> {
    course_of(robot, id, Demand::Pose { to })
}

/// A goal that begins with what the robot does now. Its way ahead is read without an allocation.
fn course_of(robot: &Robotic, id: u64, goal: Demand) -> Result<Course, Box<dyn Error>> {
    let mut outlook = Outlook::with_room(100);
    let heap = allocation_counter::measure(|| assert!(robot.controller.look_out(&mut outlook)));
    assert_eq!(heap.count_total, 0, "{} bytes", heap.bytes_total);
    let request = GoalRequest::of(goal);
    Ok(Course::new(&request, id, &outlook, &told().robot, &Surroundings::default(), PERIOD_S)?)
}

/// Takes the goal at `tick`, without an allocation. What is replaced stays in `course`.
fn follow(robot: &mut Robotic, course: &mut Course, tick: u64) {
    let heap = allocation_counter::measure(|| assert!(robot.controller.follow(course, tick)));
    assert_eq!((heap.count_total, heap.count_current), (0, 0), "{} bytes", heap.bytes_total);
}

/// Drives for `ticks`; the gate accepts every command.
fn drive(robot: &mut Robotic, ticks: Range<u64>) {
    ticks.for_each(|tick| assert_eq!(robot.drive(tick).0, Ok(()), "tick {tick}"));
}

/// What is told of the goals after the answer to `tick`.
fn messages(robot: &mut Robotic, tick: u64) -> Vec<Goal> {
    std::iter::from_fn(|| robot.controller.told_goal(tick)).collect()
}

/// Drives from `tick` on until a goal is reached. Returns what was told, and the tick after.
fn until_reached(robot: &mut Robotic, from: u64) -> (Vec<Goal>, u64) {
    let mut all = Vec::new();
    for tick in from..from + LONG {
        drive(robot, tick..tick + 1);
        all.extend(messages(robot, tick));
        if all.last().is_some_and(|goal| goal.phase() == GoalPhase::Reached) {
            return (all, tick + 1);
        }
    }
    (all, from + LONG)
}

fn phases(goals: &[Goal]) -> Vec<(u64, GoalPhase)> {
    let mut phases: Vec<_> = goals.iter().map(|goal| (goal.id, goal.phase())).collect();
    phases.dedup();
    phases
}

#[test]
fn a_goal_is_taken_without_an_allocation_told_with_its_progress_and_reached() -> Outcome {
    let mut robot = Robotic::new(&told())?;
    drive(&mut robot, 0..20);
    assert!(messages(&mut robot, 19).is_empty(), "there is no goal");
    let to = [robot.state.pose[0] + 1.0, robot.state.pose[1] - 0.5, 0.3];
    let mut first = course(&robot, 5, to)?;
    follow(&mut robot, &mut first, 20);
    let (goals, _) = until_reached(&mut robot, 20);
    assert_eq!(phases(&goals), [(5, GoalPhase::Active), (5, GoalPhase::Reached)]);
    assert!(goals.is_sorted_by(|a, b| a.progress <= b.progress && a.left_m >= b.left_m));
    let end = goals.last().ok_or("nothing was told")?;
    assert_eq!((end.progress, end.left_m, end.left_s), (1.0, 0.0, 0.0));
    let [x, y, _] = robot.state.pose;
    assert!((x - to[0]).hypot(y - to[1]) < 0.01, "{:?}", robot.state.pose);
    Ok(())
}

#[test]
fn a_later_goal_preempts_an_active_one_and_a_late_one_changes_nothing() -> Outcome {
    let mut robot = Robotic::new(&told())?;
    drive(&mut robot, 0..20);
    let mut late = course(&robot, 4, [1.0, 1.0, 0.0])?;
    let mut first = course(&robot, 5, [3.0, 0.0, 0.0])?;
    follow(&mut robot, &mut first, 20);
    drive(&mut robot, 20..25);
    assert_eq!(phases(&messages(&mut robot, 24)), [(5, GoalPhase::Active)]);
    assert!(late.latest_tick < 25 && !robot.controller.follow(&mut late, 25));
    assert!(messages(&mut robot, 24).is_empty());
    let mut second = course(&robot, 6, [0.0, 1.0, 0.0])?;
    follow(&mut robot, &mut second, 25);
    let (goals, _) = until_reached(&mut robot, 25);
    let expected = [(5, GoalPhase::Preempted), (6, GoalPhase::Active), (6, GoalPhase::Reached)];
    assert_eq!(phases(&goals), expected);
    Ok(())
}

#[test]
fn a_restarted_plant_aborts_the_goal_and_the_robot_holds_its_place() -> Outcome {
    let mut robot = Robotic::new(&told())?;
    drive(&mut robot, 0..20);
    let mut first = course(&robot, 5, [3.0, 0.0, 0.0])?;
    follow(&mut robot, &mut first, 20);
    drive(&mut robot, 20..25);
    messages(&mut robot, 24);
    let mut begun = State { pose: [7.0, 8.0, 0.5], ..State::default() };
    for tick in 0..10 {
        let mut measured = state(tick);
        measured.stamp.epoch = 2;
        (measured.pose, measured.velocity) = (begun.pose, begun.velocity);
        let command = answer(&mut robot.controller, &measured);
        begun = robot.controller.knowledge().belief().predict(&begun, &command.input);
        robot.controller.prepare_next();
    }
    let [x, y, _] = begun.pose;
    assert!((x - 7.0).hypot(y - 8.0) < 0.02, "{:?}", begun.pose);
    assert_eq!(phases(&messages(&mut robot, 9)), [(5, GoalPhase::Aborted)]);
    Ok(())
}

/// Answers ticks of a robot that stands while its gate is shut.
fn stand_stopped(robot: &mut Robotic, ticks: Range<u64>) {
    for tick in ticks {
        let mut stopped = state(tick);
        stopped.pose = robot.state.pose;
        stopped.gate = GateState::Stopped.code();
        answer(&mut robot.controller, &stopped);
        robot.controller.prepare_next();
    }
}

#[test]
fn a_velocity_ends_at_its_time_while_the_gate_is_stopped_and_a_pose_waits() -> Outcome {
    let velocity = Demand::Velocity { velocity: [0.3, 0.0, 0.0], valid_s: 1.0 };
    for (goal, phase) in
        [(velocity, GoalPhase::Aborted), (Demand::Pose { to: [3.0, 0.0, 0.0] }, GoalPhase::Active)]
    {
        let mut robot = Robotic::new(&told())?;
        drive(&mut robot, 0..20);
        let mut goal = course_of(&robot, 5, goal)?;
        follow(&mut robot, &mut goal, 20);
        drive(&mut robot, 20..23);
        robot.state.velocity = [0.0; 3];
        let place = robot.state.pose;
        stand_stopped(&mut robot, 23..100);
        assert_eq!(phases(&messages(&mut robot, 99)).last(), Some(&(5, phase)));
        // Its gate is open again.
        for tick in 100..130 {
            let mut measured = state(tick);
            (measured.pose, measured.velocity) = (robot.state.pose, robot.state.velocity);
            let command = answer(&mut robot.controller, &measured);
            let belief = robot.controller.knowledge().belief();
            robot.state = belief.predict(&robot.state, &command.input);
            robot.controller.prepare_next();
        }
        let moved = (robot.state.pose[0] - place[0]).hypot(robot.state.pose[1] - place[1]);
        assert_eq!(moved > 0.1, phase == GoalPhase::Active, "{phase:?}: {moved} m");
    }
    Ok(())
}
