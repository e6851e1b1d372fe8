use super::*;
use crate::mpc::tests::settings;
use crate::mpc::{Mpc, MpcError};
use crate::reference::ReferencePoint;
use crate::settings::{MpcSettings, Weights};
use model::main_model::MainModel;
use model::predict::Belief;
use robot::ImpossibleShape;

const PERIOD_S: f64 = 0.1;

fn disc(x: f64, y: f64, velocity_mps: Point) -> Result<Obstacle, ImpossibleShape> {
    Ok(Obstacle { shape: Shape::hull(&[[x, y]], 0.25)?, velocity_mps })
}

/// Drives along the x axis at 0.8 m/s for `ticks`, among `obstacles`. Returns the smallest
/// distance of the footprint from them, and the last state.
fn driven(obstacles: &[Obstacle], ticks: usize) -> Result<(f64, State), MpcError> {
    driven_by(true, 0.8, obstacles, ticks).map(|(least, _, state)| (least, state))
}

/// The same with another speed, and the largest speed; `knows` whether the program has rows for
/// them.
fn driven_by(
    knows: bool,
    speed_mps: f64,
    obstacles: &[Obstacle],
    ticks: usize,
) -> Result<(f64, f64, State), MpcError> {
    let robot = Robot::example();
    let main = MainModel::new(&robot, PERIOD_S);
    let belief = Belief::of(&main);
    let settings = MpcSettings { horizon_steps: 20, control_horizon_steps: 10, ..settings() };
    let map = Surroundings::default();
    let mut mpc = if knows {
        Mpc::among_obstacles(&settings, &robot, &main, &map)?
    } else {
        Mpc::new(&settings, &robot, &main)?
    };
    let (mut state, mut input) = (State::default(), [0.0; 3]);
    let (mut least, mut fastest) = (f64::INFINITY, 0.0_f64);
    mpc.begin_at(&state);
    for tick in 0..ticks {
        let point = |k: usize| ReferencePoint {
            pose: [speed_mps * PERIOD_S * (tick + k) as f64, 0.0, 0.0],
            velocity: [speed_mps, 0.0, 0.0],
            course: 0.0,
        };
        let reference: Vec<ReferencePoint> = (0..=20).map(point).collect();
        let seconds = tick as f64 * PERIOD_S;
        let now: Vec<Obstacle> = obstacles.iter().map(|one| one.after(seconds)).collect();
        mpc.see_obstacles(now.iter().copied());
        mpc.prepare(&reference, &belief);
        assert!(mpc.iterate(&state, &input, &reference, &belief).outcome.usable(), "{tick}");
        input = mpc.stages()[0].input;
        state = belief.predict(&state, &input);
        fastest = fastest.max(state.velocity[0].hypot(state.velocity[1]));
        let footprint = robot.footprint().shape().placed(&state.pose);
        let apart = now
            .iter()
            .map(|one| footprint.separation(&one.after(PERIOD_S).shape).distance_m)
            .fold(f64::INFINITY, f64::min);
        least = least.min(apart);
    }
    Ok((least, fastest, state))
}

#[test]
fn a_disc_beside_the_way_is_passed_without_a_touch() -> Result<(), Box<dyn std::error::Error>> {
    let (least, state) = driven(&[disc(2.5, 0.2, [0.0; 2])?], 70)?;
    assert!(least > 0.03, "{least}");
    assert!((state.pose[0] - 5.6).abs() < 0.1 && state.pose[1].abs() < 0.05, "{state:?}");
    Ok(())
}

#[test]
fn a_disc_that_crosses_the_way_is_not_touched() -> Result<(), Box<dyn std::error::Error>> {
    for speed in [0.3, 0.6] {
        let meets_at = 2.5 / 0.8;
        let crossing = disc(2.5, -speed * meets_at, [0.0, speed])?;
        let (least, state) = driven(&[crossing], 80)?;
        assert!(least > 0.0, "at {speed} m/s: {least}");
        assert!((state.pose[0] - 6.4).abs() < 0.15, "{state:?}");
    }
    Ok(())
}

#[test]
fn a_disc_that_comes_towards_a_robot_makes_it_give_way() -> Result<(), Box<dyn std::error::Error>> {
    let (least, _) = driven(&[disc(4.0, 0.1, [-0.5, 0.0])?], 70)?;
    assert!(least > 0.0, "{least}");
    Ok(())
}

#[test]
fn obstacles_out_of_reach_change_no_bit() -> Result<(), Box<dyn std::error::Error>> {
    let far: Vec<Obstacle> =
        (0..64).map(|i| disc(200.0 + f64::from(i), 90.0, [0.1, 0.0])).collect::<Result<_, _>>()?;
    let ((_, with), (_, _, without)) = (driven(&far, 40)?, driven_by(false, 0.8, &far, 40)?);
    assert_eq!(with, without);
    assert_eq!(driven(&[], 40)?.1, without);
    Ok(())
}

#[test]
fn a_robot_inside_an_obstacle_leaves_it() -> Result<(), Box<dyn std::error::Error>> {
    let (_, state) = driven(&[disc(-0.1, 0.0, [0.0; 2])?], 40)?;
    assert!(state.pose[0] > 2.0, "{state:?}");
    Ok(())
}

#[test]
fn a_robot_that_stands_leaves_what_touches_it_slowly() -> Result<(), Box<dyn std::error::Error>> {
    for at in [[0.02, 0.05], [-0.25, 0.0], [0.0, 0.3]] {
        let touching = disc(at[0], at[1], [0.0; 2])?;
        let (_, fastest, state) = driven_by(true, 0.0, &[touching], 60)?;
        let footprint = Robot::example().footprint().shape().placed(&state.pose);
        let apart = footprint.separation(&touching.shape).distance_m;
        assert!(apart > 0.0 && fastest < 0.6, "{at:?}: {apart} m, {fastest} m/s");
    }
    Ok(())
}

#[test]
fn a_turn_leads_away_from_no_obstacle_in_front_of_an_edge() -> Result<(), Box<dyn std::error::Error>>
{
    let robot = Robot::example();
    let map =
        Surroundings { obstacles: vec![disc(0.6, 0.1, [0.0; 2])?], ..Surroundings::default() };
    let mut around = Around::new(&robot, &map, PERIOD_S);
    let state = State::default();
    around.choose(&state, 20, std::iter::empty());
    let mut approach = around.approaches(&state)[0];
    around.advance(0, 0, &state, &mut approach);
    let rows = [0, 1].map(|corner| {
        let mut row = Row {
            stage: 1,
            first: 0,
            by_state: [0.0; 3],
            by_input: [0.0; 3],
            slack: None,
            bounds: [1.0; 2],
            recurs: true,
        };
        approach.write(corner, &mut row);
        row
    });
    let [left, right] = rows.map(|row| row.by_state[2]);
    assert!(left * right < 0.0 && (left + right).abs() < 1e-9, "{left} and {right}");
    assert!((rows[0].bounds[0] - rows[1].bounds[0]).abs() < 1e-9, "{rows:?}");
    Ok(())
}

/// A robot that the gate stops before a gap, while a disc closes the gap. Returns the least
/// distance from both discs along the plan.
fn held_before_a_gap(plans_again: bool) -> Result<f64, Box<dyn std::error::Error>> {
    const PERIOD_S: f64 = 0.02;
    let robot = Robot::example();
    let main = MainModel::new(&robot, PERIOD_S);
    let belief = Belief::of(&main);
    let weights = Weights {
        position: 300.0,
        heading: 5.0,
        velocity: 5.0,
        input: 0.05,
        input_change: 0.3,
        ..settings().weights
    };
    let settings =
        MpcSettings { horizon_steps: 20, control_horizon_steps: 10, weights, ..settings() };
    let mut mpc = Mpc::among_obstacles(&settings, &robot, &main, &Surroundings::default())?;
    let stands = Obstacle::standing(Shape::hull(&[[3.07, -0.59]], 0.18)?);
    let comes = Obstacle { shape: Shape::hull(&[[2.64, 0.5]], 0.4)?, velocity_mps: [0.11, -0.2] };
    let state = State { pose: [2.84, -0.21, -0.76], ..State::default() };
    mpc.begin_at(&state);
    let mut least = f64::INFINITY;
    for tick in 0..26 {
        let opens = tick < 20;
        let goal = if opens { [3.95, 0.55, -1.73] } else { state.pose };
        let point = ReferencePoint { pose: goal, velocity: [0.0; 3], course: 0.0 };
        let reference = [point; 21];
        let comes = comes.after(f64::from(tick.max(20) - 20) * PERIOD_S);
        mpc.see_obstacles([stands, comes].into_iter().take(if opens { 1 } else { 2 }));
        if plans_again && !opens {
            mpc.begin_again(&state);
        }
        mpc.prepare(&reference, &belief);
        assert!(mpc.iterate(&state, &[0.0; 3], &reference, &belief).outcome.usable());
        let distances = mpc.stages().iter().enumerate().flat_map(|(k, stage)| {
            let footprint = robot.footprint().shape().placed(&stage.state.pose);
            [stands, comes.after(k as f64 * PERIOD_S)]
                .map(|one| footprint.separation(&one.shape).distance_m)
        });
        least = distances.fold(f64::INFINITY, f64::min);
    }
    Ok(least)
}

#[test]
fn a_plan_through_a_gap_that_closes_ends_when_it_is_made_again()
-> Result<(), Box<dyn std::error::Error>> {
    let clearance_m = Robot::example().footprint().clearance_m;
    assert!(held_before_a_gap(false)? < clearance_m);
    assert!(held_before_a_gap(true)? > clearance_m);
    Ok(())
}
