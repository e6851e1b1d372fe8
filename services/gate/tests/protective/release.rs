//! Promises for a robot that the gate holds, and then releases.

use crate::world::{PERIOD, SLICE, command, disc, robot, slow_robot, standing};
use gate::{Bounds, Gate};
use protocol::message::{FallbackLevel, ObstacleSource, Reason};
use robot::Obstacle;

#[test]
fn a_robot_that_is_held_is_driven_again_as_soon_as_the_obstacle_is_gone() {
    let mut robot = robot();
    (robot.limits.input_rate_mps2, robot.limits.yaw_input_rate_radps2) = (2.0, 4.0);
    let mut gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(&standing(&[]), &robot);
    let disc = [Obstacle::standing(disc(0.9, 0.0, 0.5))];
    let mut mean = 0.0;
    for tick in 0..40 {
        let now = tick * PERIOD;
        gate.begin_period(tick, now);
        gate.see_pose(&[0.0; 3], &[0.0; 3]);
        let list: &[Obstacle] = if (10..20).contains(&tick) { &disc } else { &[] };
        assert_eq!(gate.see_obstacles(ObstacleSource::Planner, list, now, 2 * PERIOD), Ok(()));
        // A controller starts from the mean output of the last period, and keeps its rate.
        let asked: f64 = 1.0_f64.min(mean + 0.2);
        assert_eq!(gate.offer(&command(tick, [asked, 0.0, 0.0]), now), Ok(()), "tick {tick}");
        let outputs = (0..50).map(|slice| gate.decide(now + slice * SLICE).input[0]);
        mean = outputs.sum::<f64>() / 50.0;
        let (level, reason) = gate.end_period(now + PERIOD);
        assert_eq!(level, FallbackLevel::FreshPlan);
        let slowed = (10..20).contains(&tick);
        assert_eq!(reason == Reason::ProtectiveStop, slowed, "tick {tick}: {reason}");
        if tick == 19 {
            assert!(mean.abs() < 0.2, "{mean}");
        }
    }
    assert!((mean - 1.0).abs() < 1e-9, "{mean}");
}

#[test]
fn while_the_gate_brakes_before_an_obstacle_the_next_command_is_accepted() {
    let robot = slow_robot();
    let mut gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(&standing(&[]), &robot);
    for tick in 0..8 {
        let now = tick * PERIOD;
        gate.begin_period(tick, now);
        gate.see_pose(&[0.0; 3], &[0.0; 3]);
        assert_eq!(gate.offer(&command(tick, [0.2 * tick as f64, 0.0, 0.0]), now), Ok(()));
        gate.decide(now);
    }
    let now = 8 * PERIOD;
    gate.begin_period(8, now);
    gate.see_pose(&[0.0; 3], &[1.4, 0.0, 0.0]);
    let wall = [Obstacle::standing(disc(0.8, 0.0, 0.3))];
    assert_eq!(gate.see_obstacles(ObstacleSource::Robot, &wall, now, PERIOD), Ok(()));
    let slowed = gate.decide(now + PERIOD - SLICE);
    assert!(slowed.input[0] < 1.0 && slowed.reason == Reason::ProtectiveStop, "{slowed:?}");
    let next = command(8, [1.6, 0.0, 0.0]);
    assert_eq!(gate.offer(&next, now + PERIOD - SLICE), Ok(()));
}

#[test]
fn a_stored_tail_that_is_released_gets_faster_by_one_change_per_period() {
    let robot = slow_robot();
    let mut gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(&standing(&[]), &robot);
    let mut outputs = Vec::new();
    for tick in 0..11 {
        let now = tick * PERIOD;
        gate.begin_period(tick, now);
        gate.see_pose(&[0.0; 3], &[0.0; 3]);
        let wall = [Obstacle::standing(disc(0.8, 0.0, 0.5))];
        let list = if tick == 8 { &wall[..] } else { &[] };
        assert_eq!(gate.see_obstacles(ObstacleSource::Robot, list, now, 9 * PERIOD), Ok(()));
        if tick < 9 {
            let asked = 1.4_f64.min(0.2 * tick as f64);
            assert_eq!(gate.offer(&command(tick, [asked, 0.0, 0.0]), now), Ok(()));
        }
        let last = (0..50).map(|slice| gate.decide(now + slice * SLICE).input[0]).last();
        outputs.push((last.unwrap_or_default(), gate.end_period(now + PERIOD).1));
    }
    let [(before, _), (slowed, reason), (released, still), (next, _)] = outputs[7..] else {
        unreachable!("eleven periods")
    };
    assert!((before - 1.4).abs() < 1e-9 && slowed < 1.0, "{outputs:?}");
    assert_eq!((reason, still), (Reason::ProtectiveStop, Reason::ProtectiveStop));
    assert!((released - slowed - 0.22).abs() < 1e-9, "{outputs:?}");
    assert!((next - released - 0.22).abs() < 1e-9 || (next - 1.4).abs() < 1e-9, "{outputs:?}");
}

#[test]
fn a_released_robot_whose_command_has_gone_ahead_slows_down_by_the_ramp_and_one_change() {
    let mut robot = slow_robot();
    (robot.limits.brake_mps2, robot.limits.yaw_brake_radps2) = (2.0, 4.0);
    let mut gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(&standing(&[]), &robot);
    let mut last = 0.0;
    for tick in 0..13 {
        let now = tick * PERIOD;
        gate.begin_period(tick, now);
        gate.see_pose(&[0.0; 3], &[0.0; 3]);
        let wall = [Obstacle::standing(disc(0.8, 0.0, 0.5))];
        let list = if (8..11).contains(&tick) { &wall[..] } else { &[] };
        assert_eq!(gate.see_obstacles(ObstacleSource::Robot, list, now, 9 * PERIOD), Ok(()));
        let asked =
            if tick < 8 { 0.2 * tick as f64 } else { (1.4 - 0.44 * (tick - 7) as f64).max(0.08) };
        assert_eq!(gate.offer(&command(tick, [asked, 0.0, 0.0]), now), Ok(()), "tick {tick}");
        let before = last;
        last = (0..50).map(|slice| gate.decide(now + slice * SLICE).input[0]).last().unwrap_or(0.0);
        if tick >= 11 {
            assert!(before - last < 0.22 + 0.2 + 1e-9, "tick {tick}: {before} to {last}");
        }
        let reason = gate.end_period(now + PERIOD).1;
        assert_eq!(reason == Reason::ProtectiveStop, (8..13).contains(&tick), "tick {tick}");
    }
    assert!((last - 0.08).abs() < 1e-9, "{last}");
}
