//! Promise: the gate has no heap after start.

use gate::{Bounds, Gate};
use protocol::message::{Command, FallbackLevel, OBSTACLES_MAX, ObstacleSource};
use robot::{Obstacle, Robot, Shape, Surroundings};

const PERIOD: u64 = 20_000_000;

/// Commands of every kind: valid ones, and one for each reason of rejection.
fn offered(tick: u64) -> Command {
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.stamp.epoch, command.stamp.writer, command.stamp.tick) = (2, 1, tick);
    (command.plant_epoch, command.fallback_level, command.tail_len) =
        (7, FallbackLevel::FreshPlan.code(), 4);
    command.input = [1e-3 * (tick % 1000) as f64, 0.0, 0.0];
    command.tail = [command.input; 4];
    match tick % 13 {
        1 => command.input[1] = f64::NAN,
        2 => command.input[0] = 1e9,
        3 => command.plant_epoch = 6,
        4 => command.stamp.epoch = 1,
        5 => command.stamp.writer = 2,
        6 => command.stamp.tick += 1,
        7 => command.tail[2][1] = -4.0,
        8 => command.tail_len = u32::MAX,
        9 => command.stamp.tick = tick.saturating_sub(5),
        _ => {}
    }
    command
}

#[test]
fn the_gate_allocates_nothing_for_any_command() {
    let mut gate = Gate::new(Bounds::new(&Robot::example(), PERIOD, 0), 7);
    let mut fallback_levels = [0; 8];
    let heap = allocation_counter::measure(|| {
        for tick in 0..10_000 {
            let now = tick * PERIOD;
            gate.begin_period(tick, now);
            // Every 500 periods a second of silence: the tail, the brake, and the recovery.
            if tick % 500 > 50 {
                let _ = gate.offer(&offered(tick), now + PERIOD / 4);
            }
            for part in 0..4 {
                gate.decide(now + part * PERIOD / 4);
            }
            fallback_levels[gate.end_period(now + PERIOD - 1).0.code() as usize] += 1;
        }
    });
    assert_eq!((heap.count_total, heap.bytes_total), (0, 0));
    assert!(
        fallback_levels.iter().filter(|&&periods| periods > 0).count() >= 3,
        "fresh plans, tails and brakes: {fallback_levels:?}"
    );
    assert!(gate.refused() > 1000, "{}", gate.refused());
}

#[test]
fn the_gate_allocates_nothing_among_obstacles() -> Result<(), robot::ImpossibleShape> {
    let robot = Robot::example();
    let disc = Obstacle::standing(Shape::hull(&[[0.36, 0.0]], 0.1)?);
    let surroundings = Surroundings {
        obstacles: vec![disc; 100],
        zones: vec![(disc.shape, 0.1); 100],
        fence: Some(Shape::rectangle(4.0, 4.0)),
        speed_without_obstacles_mps: 0.1,
    };
    let mut gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(&surroundings, &robot);
    let mut slowed = 0;
    let heap = allocation_counter::measure(|| {
        for tick in 0..500 {
            let now = tick * PERIOD;
            gate.begin_period(tick, now);
            gate.see_pose(&[0.0; 3], &[0.0; 3]);
            for source in [ObstacleSource::Robot, ObstacleSource::Planner] {
                let _ = gate.see_obstacles(source, &[disc; OBSTACLES_MAX], now, PERIOD);
            }
            let _ = gate.offer(&offered(tick), now);
            gate.decide(now + PERIOD / 2);
            slowed += u32::from(gate.end_period(now + PERIOD - 1).1.is_slowed());
        }
    });
    assert_eq!((heap.count_total, heap.bytes_total), (0, 0));
    assert!(slowed > 50, "{slowed}");
    Ok(())
}
