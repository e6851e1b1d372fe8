//! Promises: the gate stops the robot before an obstacle, whatever is commanded, and leaves a robot
//! alone that nothing is in the way of.

mod any_world;
mod release;
mod world;

use protocol::message::{FallbackLevel, ObstacleSource, Reason};
use robot::{Obstacle, Shape, Surroundings, Velocity};
use world::{PERIOD, RESPONSE_S, World, command, disc, footprint, standing};

const AHEAD: Velocity = [1.0, 0.0, 0.0];

#[test]
fn a_robot_before_an_obstacle_stands_with_the_reason_and_the_level_of_its_command() {
    let mut world = World::new(&standing(&[disc(2.0, 0.0, 0.5)]), [0.0; 3], RESPONSE_S);
    let mut past = Vec::new();
    for _ in 0..60 {
        past.push(world.period(Some(AHEAD), |_, _, _| {}));
    }
    assert_eq!(past.first(), Some(&(FallbackLevel::FreshPlan, Reason::None)));
    assert_eq!(past.last(), Some(&(FallbackLevel::FreshPlan, Reason::ProtectiveStop)));
    // 2 m less the radius, half the length and the clearance.
    let gap = 2.0 - 0.5 - 0.3 - 0.05 - world.pose[0];
    assert!((0.0..0.01).contains(&gap), "{gap}");
}

#[test]
fn the_approach_does_not_swing() {
    for lag_s in [0.0, RESPONSE_S] {
        let mut world = World::new(&standing(&[disc(3.0, 0.0, 0.5)]), [0.0; 3], lag_s);
        let mut before = f64::INFINITY;
        for tick in 0..60 {
            world.period(Some(AHEAD), |_, output, _| {
                assert!(output[0] <= before + 0.02, "tick {tick}: {before} to {output:?}");
                before = output[0];
            });
        }
    }
}

#[test]
fn a_list_that_is_too_old_bounds_the_speed_and_none_at_all_does_not() {
    let surroundings = Surroundings { speed_without_obstacles_mps: 0.3, ..Surroundings::default() };
    let mut world = World::new(&surroundings, [0.0; 3], 0.0);
    let mut last = 0.0;
    let first = world.period(Some(AHEAD), |_, output, _| last = output[0]);
    assert_eq!((first.1, last), (Reason::None, 1.0));
    assert_eq!(world.gate.see_obstacles(ObstacleSource::Robot, &[], PERIOD, PERIOD), Ok(()));
    let fresh = world.period(Some(AHEAD), |_, output, _| last = output[0]);
    assert_eq!((fresh.1, last), (Reason::None, 1.0));
    for _ in 0..5 {
        let old = world.period(Some(AHEAD), |_, output, _| last = output[0]);
        assert_eq!(old, (FallbackLevel::FreshPlan, Reason::ObstaclesUnknown));
    }
    assert!((last - 0.3).abs() < 1e-5, "{last}");
    // A list of the other source does not replace it.
    let now = world.tick * PERIOD;
    assert_eq!(world.gate.see_obstacles(ObstacleSource::Planner, &[], now, 99 * PERIOD), Ok(()));
    assert_eq!(world.period(Some(AHEAD), |_, _, _| {}).1, Reason::ObstaclesUnknown);
    let now = world.tick * PERIOD;
    assert_eq!(world.gate.see_obstacles(ObstacleSource::Robot, &[], now, 99 * PERIOD), Ok(()));
    assert_eq!(world.period(Some(AHEAD), |_, _, _| {}).1, Reason::None);
}

#[test]
fn a_robot_enters_a_zone_with_its_limit_and_leaves_it_with_its_own_speed() {
    let zone = disc(3.0, 0.0, 0.8);
    let surroundings = Surroundings { zones: vec![(zone, 0.4)], ..Surroundings::default() };
    for lag_s in [0.0, RESPONSE_S] {
        let mut world = World::new(&surroundings, [0.0; 3], lag_s);
        let mut fastest: f64 = 0.0;
        for _ in 0..100 {
            let before = world.velocity;
            world.period(Some(AHEAD), |pose, output, _| {
                if footprint().placed(pose).separation(&zone).distance_m < 0.0 {
                    fastest = fastest.max(output[0]);
                }
            });
            let inside = footprint().placed(&world.pose).separation(&zone).distance_m < 0.0;
            let leaving = world.pose[0] > 3.0;
            assert!(!inside || leaving || before[0] < 0.6, "{before:?}");
        }
        assert!((0.39..0.41).contains(&fastest), "{fastest}");
        let past = world.period(Some(AHEAD), |_, _, _| {});
        assert_eq!(past.1, Reason::None);
    }
}

#[test]
fn a_robot_stays_within_its_fence_and_drives_back_from_it() {
    let corners = [[-1.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-1.0, 1.0]];
    let fence = Shape::hull(&corners, 0.0).ok();
    let surroundings = Surroundings { fence, ..Surroundings::default() };
    let mut world = World::new(&surroundings, [0.0; 3], RESPONSE_S);
    let mut past = (FallbackLevel::Waiting, Reason::None);
    for _ in 0..60 {
        past = world.period(Some([1.0, 0.3, 0.0]), |pose, _, _| {
            let corners = footprint().placed(pose);
            assert!(corners.corners().iter().all(|[x, y]| *x <= 1.95 && y.abs() <= 0.95));
        });
    }
    assert_eq!(past, (FallbackLevel::FreshPlan, Reason::Geofence));
    assert_eq!(world.period(Some([-0.5, -0.5, 0.0]), |_, _, _| {}).1, Reason::None);
}

#[test]
fn a_robot_stands_before_an_obstacle_that_comes_reaches_it() {
    let mut world = World::new(&standing(&[]), [0.0; 3], RESPONSE_S);
    let obstacle =
        Obstacle { velocity_mps: [-0.5, 0.0], ..Obstacle::standing(disc(3.0, 0.0, 0.3)) };
    let mut at_contact = None;
    for tick in 0..60 {
        let now = tick * PERIOD;
        let present = obstacle.after(now as f64 * 1e-9);
        assert_eq!(
            world.gate.see_obstacles(ObstacleSource::Robot, &[present], now, 3 * PERIOD),
            Ok(())
        );
        let mut last = AHEAD;
        world.period(Some(AHEAD), |_, output, _| last = output);
        let apart = footprint().placed(&world.pose).separation(&present.shape).distance_m;
        if at_contact.is_none() && apart <= 0.0 {
            at_contact = Some((last[0], world.velocity[0]));
        }
    }
    // The rest of a lag has no end.
    let (output, velocity) = at_contact.unwrap_or_default();
    assert!(at_contact.is_some() && output == 0.0 && velocity < 0.15, "{at_contact:?}");
}

#[test]
fn before_the_first_pose_the_robot_stands() {
    let mut world = World::new(&standing(&[]), [f64::NAN; 3], 0.0);
    let past = world.period(Some(AHEAD), |_, output, _| assert_eq!(output, [0.0; 3]));
    assert_eq!(past, (FallbackLevel::FreshPlan, Reason::ProtectiveStop));
}

#[test]
fn a_list_with_too_many_obstacles_is_refused_and_the_one_before_it_stays() {
    let mut world = World::new(&standing(&[]), [0.0; 3], 0.0);
    let wall = [Obstacle::standing(disc(0.9, 0.0, 0.5))];
    assert_eq!(world.gate.see_obstacles(ObstacleSource::Robot, &wall, 0, u64::MAX), Ok(()));
    let many = [Obstacle::standing(disc(50.0, 0.0, 0.1)); 65];
    assert!(world.gate.see_obstacles(ObstacleSource::Robot, &many, 0, u64::MAX).is_err());
    assert_eq!(world.period(Some(AHEAD), |_, _, _| {}).1, Reason::ProtectiveStop);
}

#[test]
fn a_slowed_period_says_so_even_if_a_command_was_refused_in_it() {
    let mut world = World::new(&standing(&[disc(0.9, 0.0, 0.5)]), [0.0; 3], 0.0);
    let now = world.begin(Some(AHEAD));
    assert_eq!(world.gate.offer(&command(0, AHEAD), now), Err(Reason::NotNewer));
    assert_eq!(world.gate.decide(now).reason, Reason::ProtectiveStop);
    assert_eq!(world.gate.end_period(PERIOD), (FallbackLevel::FreshPlan, Reason::ProtectiveStop));
    assert!(Reason::ProtectiveStop.is_slowed() && !Reason::NotNewer.is_slowed());
}

#[test]
fn a_ramp_that_turns_back_from_an_obstacle_first_comes_closer() {
    let line = [[-1.044, -0.615], [-0.591, -1.655]];
    let wall = Shape::hull(&line, 0.0).unwrap_or(disc(0.0, 0.0, 0.0));
    let mut world = World::new(&standing(&[wall]), [0.0, 0.0, 2.699], RESPONSE_S);
    let asked =
        [[0.0, 1.773, 0.0], [0.0, 0.982, -1.284], [1.375, 1.013, 0.0], [-1.908, 1.364, 0.0]];
    for input in asked.iter().flat_map(|input| std::iter::repeat_n(input, 5)) {
        world.period(Some(*input), |pose, _, _| {
            let apart = footprint().placed(pose).separation(&wall).distance_m;
            assert!(apart > 0.0, "{apart}");
        });
    }
}
