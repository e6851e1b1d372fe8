//! Promises: the gate stops the robot before an obstacle, whatever is commanded, and leaves a robot
//! alone that nothing is in the way of.

use gate::{Bounds, Gate};
use proptest::prelude::*;
use protocol::message::{Command, FallbackLevel, ObstacleSource, Reason};
use robot::{Footprint, Obstacle, Response, Robot, Shape, Surroundings, Velocity};

const PERIOD: u64 = 100_000_000;
const SLICE: u64 = 2_000_000;
const RESPONSE_S: f64 = 0.3;

fn robot() -> Robot {
    let mut robot = Robot::example();
    let response = Response { time_constant_s: [RESPONSE_S; 3], ..Response::default() };
    (robot.body, robot.drive, robot.response) = (None, None, Some(response));
    // A controller may command anything in every period.
    (robot.limits.input_rate_mps2, robot.limits.yaw_input_rate_radps2) = (1e3, 1e3);
    (robot.limits.brake_mps2, robot.limits.yaw_brake_radps2) = (2.0, 4.0);
    robot.footprint = Some(Footprint { length_m: 0.6, width_m: 0.4, clearance_m: 0.05 });
    robot
}

fn command(tick: u64, input: Velocity) -> Command {
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.stamp.epoch, command.stamp.tick, command.plant_epoch) = (1, tick, 7);
    (command.fallback_level, command.input) = (FallbackLevel::FreshPlan.code(), input);
    (command.tail, command.tail_len) = ([input; 4], 4);
    command
}

/// A robot behind its gate that follows the output with a lag.
struct World {
    gate: Gate,
    pose: [f64; 3],
    velocity: Velocity,
    lag_s: f64,
    tick: u64,
}

impl World {
    fn new(surroundings: &Surroundings, pose: [f64; 3], lag_s: f64) -> Self {
        let robot = robot();
        let gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(surroundings, &robot);
        Self { gate, pose, velocity: [0.0; 3], lag_s, tick: 0 }
    }

    /// Begins a period with a command; without one the tail acts, and then the brake.
    fn begin(&mut self, input: Option<Velocity>) -> u64 {
        let now = self.tick * PERIOD;
        self.gate.begin_period(self.tick, now);
        self.gate.see_pose(&self.pose, &self.velocity);
        if let Some(input) = input {
            assert_eq!(self.gate.offer(&command(self.tick, input), now), Ok(()), "{input:?}");
        }
        now
    }

    /// One period; calls `each` with the pose, the output and its reason after every slice.
    fn period(
        &mut self,
        input: Option<Velocity>,
        mut each: impl FnMut(&[f64; 3], Velocity, Reason),
    ) -> (FallbackLevel, Reason) {
        let now = self.begin(input);
        for slice in 0..PERIOD / SLICE {
            let decision = self.gate.decide(now + slice * SLICE);
            self.follow(&decision.input);
            each(&self.pose, decision.input, decision.reason);
        }
        self.tick += 1;
        self.gate.end_period(now + PERIOD)
    }

    fn follow(&mut self, input: &Velocity) {
        let seconds = SLICE as f64 * 1e-9;
        let kept = if self.lag_s > 0.0 { (-seconds / self.lag_s).exp() } else { 0.0 };
        for (velocity, input) in self.velocity.iter_mut().zip(input) {
            *velocity = kept * *velocity + (1.0 - kept) * input;
        }
        let [ahead, left, yaw] = self.velocity.map(|value| value * seconds);
        let (sin, cos) = (self.pose[2] + 0.5 * yaw).sin_cos();
        let by = [cos * ahead - sin * left, sin * ahead + cos * left, yaw];
        self.pose.iter_mut().zip(by).for_each(|(value, by)| *value += by);
    }
}

fn standing(shapes: &[Shape]) -> Surroundings {
    let obstacles = shapes.iter().copied().map(Obstacle::standing).collect();
    Surroundings { obstacles, ..Surroundings::default() }
}

/// The footprint with its clearance.
fn footprint() -> Shape {
    let footprint = robot().footprint();
    footprint.shape().grown(footprint.clearance_m)
}

fn disc(x: f64, y: f64, radius: f64) -> Shape {
    Shape::hull(&[[x, y]], radius).unwrap_or(Shape::rectangle(0.0, 0.0))
}

fn shapes() -> impl Strategy<Value = Shape> {
    let corner = prop::array::uniform2(-0.7..0.7);
    let place = prop::array::uniform2(-2.5..2.5);
    (prop::collection::vec(corner, 1..=6), 0.0..0.4, place)
        .prop_filter_map("a shape", |(corners, radius, place)| {
            Shape::hull(&corners, radius).ok().map(|s| s.moved(place))
        })
}

fn twists() -> impl Strategy<Value = Velocity> {
    (-2.0..2.0, -2.0..2.0, prop_oneof![Just(0.0), -3.0..3.0]).prop_map(|(x, y, yaw)| [x, y, yaw])
}

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

/// One that brakes faster than a controller may change its commands.
fn slow_robot() -> Robot {
    let mut robot = robot();
    (robot.limits.input_rate_mps2, robot.limits.yaw_input_rate_radps2) = (2.0, 4.0);
    (robot.limits.brake_mps2, robot.limits.yaw_brake_radps2) = (5.0, 10.0);
    if let Some(response) = &mut robot.response {
        response.wheel_speed_limit_radps = Some(70.0);
    }
    robot
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
