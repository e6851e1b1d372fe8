//! Promises that hold for any obstacles and commands.

use crate::world::{
    PERIOD, RESPONSE_S, SLICE, World, command, disc, footprint, robot, shapes, slow_robot,
    standing, twists,
};
use gate::{Bounds, Gate};
use proptest::prelude::*;
use protocol::message::{FallbackLevel, ObstacleSource, Reason};
use robot::{Obstacle, Shape, Velocity};

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2000,
        max_global_rejects: 100_000,
        ..ProptestConfig::default()
    })]

    #[test]
    fn the_footprint_never_touches_a_standing_obstacle_whatever_is_commanded(
        shapes in prop::collection::vec(shapes(), 1..5),
        heading in -3.0..3.0_f64,
        commands in prop::collection::vec(prop::option::weighted(0.9, twists()), 1..6),
        repeats in 1..6_usize,
        lag_s in prop_oneof![Just(0.0), Just(RESPONSE_S), 0.0..RESPONSE_S],
    ) {
        let start = [0.0, 0.0, heading];
        let apart = |pose: &[f64; 3]| {
            let placed = footprint().placed(pose);
            shapes.iter().map(|shape| placed.separation(shape).distance_m)
                .fold(f64::INFINITY, f64::min)
        };
        prop_assume!(apart(&start) > 0.0);
        let mut world = World::new(&standing(&shapes), start, lag_s);
        let mut least = f64::INFINITY;
        for input in commands.iter().flat_map(|input| std::iter::repeat_n(input, repeats)) {
            world.period(*input, |pose, _, _| least = least.min(apart(pose)));
        }
        prop_assert!(least > -1e-6, "{least}");
    }
}

/// Change of one period, and ramp of one period, of [`slow_robot`].
const CHANGE: Velocity = [0.2, 0.2, 0.4];
const RAMP: Velocity = [0.5, 0.5, 1.0];

/// One period of a controller among obstacles.
#[derive(Debug, Clone)]
struct Period {
    /// What it wants to reach.
    target: Velocity,
    /// Whether it asks for that at once, and not by its rate.
    wild: bool,
    obstacle: Option<Shape>,
}

/// Some targets and obstacles, each for some periods.
fn periods() -> impl Strategy<Value = Vec<Period>> {
    let some = (twists(), prop::option::weighted(0.5, shapes()), 2..8_usize);
    let wild = prop::bool::weighted(0.1);
    prop::collection::vec((some, prop::collection::vec(wild, 8)), 1..8).prop_map(|stretches| {
        let period = |((target, obstacle, count), wild): &((Velocity, Option<Shape>, usize), _)| {
            let wild: &Vec<bool> = wild;
            let period = |wild: &bool| Period { target: *target, wild: *wild, obstacle: *obstacle };
            wild.iter().take(*count).map(period).collect::<Vec<Period>>()
        };
        stretches.iter().flat_map(period).collect()
    })
}

/// `from` after one period towards `to`.
fn towards(from: &Velocity, to: &Velocity) -> Velocity {
    std::array::from_fn(|axis| {
        from[axis] + (to[axis] - from[axis]).clamp(-CHANGE[axis], CHANGE[axis])
    })
}

proptest! {
    #[test]
    fn a_robot_whose_whole_way_to_standstill_leads_away_is_never_slowed(
        shape in shapes(),
        heading in -3.0..3.0_f64,
        speed in 0.0..2.0_f64,
        asked_yaw in -3.0..3.0,
    ) {
        let placed = footprint().placed(&[0.0, 0.0, heading]);
        let apart = placed.separation(&shape);
        // Beyond its reach a robot may turn as it likes; near an obstacle a turn can touch it.
        let yaw = if apart.distance_m > 4.0 { asked_yaw } else { 0.0 };
        let (sin, cos) = heading.sin_cos();
        let away = apart.normal.map(|value| -(speed * value));
        let input = [cos * away[0] + sin * away[1], cos * away[1] - sin * away[0], yaw];
        let mut world = World::new(&standing(&[shape]), [0.0, 0.0, heading], 0.0);
        world.velocity = input;
        for _ in 0..5 {
            let past = world.period(Some(input), |_, output, _| assert_eq!(output, input));
            prop_assert_eq!(past, (FallbackLevel::FreshPlan, Reason::None));
        }
    }

    #[test]
    fn the_output_falls_no_faster_than_the_ramp_of_the_brake(
        shapes in prop::collection::vec(shapes(), 1..5),
        twist in twists(),
        after in 1..6_u64,
    ) {
        let mut world = World::new(&standing(&[]), [0.0; 3], RESPONSE_S);
        let mut before = twist;
        let all: Vec<Obstacle> = shapes.iter().copied().map(Obstacle::standing).collect();
        for tick in 0..8 {
            if tick == after {
                let now = tick * PERIOD;
                let source = ObstacleSource::Robot;
                prop_assert!(world.gate.see_obstacles(source, &all, now, u64::MAX).is_ok());
            }
            world.period(Some(twist), |_, output, _| {
                for axis in 0..3 {
                    let step = [2.0, 2.0, 4.0][axis] * SLICE as f64 * 1e-9 + 1e-9;
                    let fell = before[axis].abs() - output[axis].abs();
                    assert!(fell <= step, "{before:?} to {output:?}");
                }
                before = output;
            });
        }
    }

    #[test]
    fn among_obstacles_that_come_and_go_no_command_makes_the_output_leap(
        periods in periods(),
    ) {
        let robot = slow_robot();
        let bounds = Bounds::new(&robot, PERIOD, 0);
        let mut gate = Gate::new(bounds, 7).among(&standing(&[]), &robot);
        let (mut asked, mut last) = ([0.0; 3], [0.0; 3]);
        for (tick, Period { target, wild, obstacle }) in (0..).zip(periods) {
            let now = tick * PERIOD;
            gate.begin_period(tick, now);
            gate.see_pose(&[0.0; 3], &[0.0; 3]);
            let list: Vec<Obstacle> = obstacle.into_iter().map(Obstacle::standing).collect();
            prop_assert!(gate.see_obstacles(ObstacleSource::Robot, &list, now, u64::MAX).is_ok());
            let next = if wild { target } else { towards(&asked, &target) };
            // The gate may reject what is too fast.
            if gate.offer(&command(tick, next), now).is_ok() {
                asked = next;
            }
            let begun_with = last;
            for slice in 0..PERIOD / SLICE {
                last = gate.decide(now + slice * SLICE).input;
                prop_assert!(bounds.contain(&last), "{last:?}");
                for axis in 0..3 {
                    // A command that slows down by itself, and the ramp from there on.
                    let most = (2.2 * CHANGE[axis]).max(1.1 * CHANGE[axis] + RAMP[axis]);
                    let leap = (last[axis] - begun_with[axis]).abs();
                    prop_assert!(leap <= most + 1e-5, "{begun_with:?} to {last:?}");
                }
            }
            gate.end_period(now + PERIOD);
        }
    }

    #[test]
    fn with_the_rates_of_a_robot_the_footprint_never_touches_a_standing_obstacle(
        shapes in prop::collection::vec(shapes(), 1..5),
        periods in periods(),
        lag_s in prop_oneof![Just(0.0), Just(RESPONSE_S), 0.0..RESPONSE_S],
    ) {
        let apart = |pose: &[f64; 3]| {
            let placed = footprint().placed(pose);
            shapes.iter().map(|shape| placed.separation(shape).distance_m)
                .fold(f64::INFINITY, f64::min)
        };
        prop_assume!(apart(&[0.0; 3]) > 0.0);
        let robot = slow_robot();
        let mut world = World::new(&standing(&shapes), [0.0; 3], lag_s);
        world.gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(&standing(&shapes), &robot);
        let mut asked = [0.0; 3];
        for Period { target, wild, .. } in periods {
            let next = if wild { target } else { towards(&asked, &target) };
            let now = world.tick * PERIOD;
            world.gate.begin_period(world.tick, now);
            world.gate.see_pose(&world.pose, &world.velocity);
            if world.gate.offer(&command(world.tick, next), now).is_ok() {
                asked = next;
            }
            for slice in 0..PERIOD / SLICE {
                let decision = world.gate.decide(now + slice * SLICE);
                world.follow(&decision.input);
                prop_assert!(apart(&world.pose) > -1e-6, "{:?}", world.pose);
            }
            world.tick += 1;
            world.gate.end_period(now + PERIOD);
        }
    }

    #[test]
    fn without_anything_near_the_output_has_the_same_bits_as_without_surroundings(
        commands in prop::collection::vec(prop::option::weighted(0.8, twists()), 1..12),
    ) {
        let robot = robot();
        let mut plain = Gate::new(Bounds::new(&robot, PERIOD, 0), 7);
        let mut world = World::new(&standing(&[disc(1e4, 0.0, 1.0)]), [0.0; 3], 0.0);
        for (tick, input) in (0..).zip(commands) {
            let now = tick * PERIOD;
            plain.begin_period(tick, now);
            if let Some(input) = input {
                prop_assert_eq!(plain.offer(&command(tick, input), now), Ok(()));
            }
            let mut at = now;
            let past = world.period(input, |_, output, reason| {
                let decision = plain.decide(at);
                assert_eq!((output, reason), (decision.input, decision.reason));
                at += SLICE;
            });
            prop_assert_eq!(past, plain.end_period(now + PERIOD));
        }
    }
}
