use super::*;
use crate::{Heading, Waypoint};
use proptest::prelude::*;
use std::io::{self, Write};

type Outcome = Result<(), Box<dyn std::error::Error>>;

fn limits() -> Limits {
    Limits::of(&robot::Robot::example())
}

fn waypoints(points: &[[f64; 2]]) -> Vec<Waypoint> {
    points.iter().copied().map(Waypoint::at).collect()
}

/// Onto the path without obstacles and zones.
fn joined(begin: &Moment, points: &[[f64; 2]], heading: Heading) -> Option<Motion> {
    let points = waypoints(points);
    along_in_motion(
        begin,
        Path { points: &points, heading },
        &limits(),
        |_| f64::INFINITY,
        |_| true,
    )
}

/// Time of the motion that stops before it enters the path \[s\].
fn with_stop_s(
    begin: &Moment,
    points: &[[f64; 2]],
    heading: Heading,
) -> Result<f64, crate::MotionError> {
    let stop = to_standstill(begin, &limits())?;
    let points = waypoints(points);
    let path = Path { points: &points, heading };
    let from = stop.at(stop.duration_s()).pose;
    Ok(stop.duration_s() + along(from, path, &limits(), |_| f64::INFINITY)?.duration_s())
}

fn forward(speed: f64) -> Moment {
    Moment { velocity: [speed, 0.0, 0.0], ..Moment::default() }
}

/// Moments of the whole motion, every `step_s`.
fn moments(motion: &Motion, step_s: f64) -> Vec<Moment> {
    let steps = (motion.duration_s() / step_s).ceil() as usize;
    (0..=steps).map(|step| motion.at(step as f64 * step_s)).collect()
}

fn planar(values: &[f64; AXES]) -> f64 {
    values[0].hypot(values[1])
}

/// Smallest planar speed until `before_end_s` before the end \[m/s\].
fn slowest(motion: &Motion, before_end_s: f64) -> f64 {
    let moments = moments(motion, 0.01);
    let driven = moments.len().saturating_sub((before_end_s / 0.01) as usize);
    moments.iter().take(driven).map(|moment| planar(&moment.velocity)).fold(f64::MAX, f64::min)
}

#[test]
fn a_path_ahead_is_joined_at_the_present_speed() -> Outcome {
    for (first, speed) in [(0.4, 0.3), (0.0, 1.0), (-0.4, 1.0), (0.8, 2.5)] {
        let points = [[first, 0.1], [6.0, 0.1]];
        let motion = joined(&forward(speed), &points, Heading::Keep).ok_or("no motion")?;
        assert!(slowest(&motion, 1.0) > 0.95 * speed, "{first} m, {speed} m/s");
        let with_stop_s = with_stop_s(&forward(speed), &points, Heading::Keep)?;
        let changes = moments(&motion, 1e-3);
        let change = changes.windows(2).map(|pair| {
            let [a, b] = [pair[0].acceleration, pair[1].acceleration];
            planar(&[b[0] - a[0], b[1] - a[1], 0.0])
        });
        writeln!(
            io::stdout(),
            "first point at {first} m, {speed} m/s: {:.2} s, with a stop {with_stop_s:.2} s; the \
             acceleration changes by at most {:.3} m/s² in 1 ms",
            motion.duration_s(),
            change.fold(0.0, f64::max),
        )?;
        assert!(motion.duration_s() < with_stop_s - 0.1, "{first} m, {speed} m/s");
        // The first metre of the path may be left out.
        let aside = moments(&motion, 0.01).into_iter().filter(|moment| moment.pose[0] > 4.5);
        for moment in aside {
            assert!((moment.pose[1] - 0.1).abs() < 1e-3, "{moment:?}");
        }
    }
    Ok(())
}

#[test]
fn a_path_to_the_side_is_joined_in_a_curve() -> Outcome {
    let points = [[0.3, 0.0], [0.3, 5.0]];
    for heading in [Heading::Keep, Heading::Tangent] {
        let motion = joined(&forward(1.0), &points, heading).ok_or("no motion")?;
        assert!(slowest(&motion, 1.0) > 0.2, "{heading:?}: {}", slowest(&motion, 1.0));
        assert!(motion.duration_s() < with_stop_s(&forward(1.0), &points, heading)?);
    }
    Ok(())
}

#[test]
fn a_robot_that_may_not_join_stops_first() {
    let points = [[0.4, 0.0], [6.0, 0.0]];
    let onto = |begin: &Moment, speed: f64, is_clear: bool| {
        let points = waypoints(&points);
        let path = Path { points: &points, heading: Heading::Keep };
        along_in_motion(begin, path, &limits(), |_| speed, |_| is_clear).is_some()
    };
    assert!(onto(&forward(1.0), f64::INFINITY, true));
    assert!(!onto(&forward(0.0), f64::INFINITY, true), "it stands");
    assert!(!onto(&forward(1.0), 0.3, true), "it is too fast for the zone");
    assert!(!onto(&forward(1.0), f64::INFINITY, false), "an obstacle is beside the path");
    let far = Moment { pose: [-1.0, 0.0, 0.0], ..forward(1.0) };
    assert!(!onto(&far, f64::INFINITY, true), "the path begins elsewhere");
}

#[test]
fn a_robot_that_is_faster_than_its_new_limit_slows_down_without_a_stop() -> Outcome {
    let stated = crate::limits::Stated { speed_mps: Some(0.4), ..Default::default() };
    let limits = limits().stricter(&stated);
    let points = waypoints(&[[0.2, 0.0], [6.0, 0.0]]);
    let path = Path { points: &points, heading: Heading::Keep };
    let motion = along_in_motion(&forward(1.5), path, &limits, |_| f64::INFINITY, |_| true)
        .ok_or("no motion")?;
    assert!(slowest(&motion, 0.5) > 0.35);
    let moments = moments(&motion, 0.01);
    let slower = moments.windows(2).all(|pair| pair[1].velocity[0] < pair[0].velocity[0] + 1e-3);
    assert!(slower, "it gets slower");
    assert!(
        moments
            .iter()
            .filter(|moment| moment.pose[0] > 2.0)
            .all(|moment| moment.velocity[0] < 0.401)
    );
    Ok(())
}

#[test]
fn the_entry_keeps_clear() -> Outcome {
    // From the side onto a path along x: an entry that overshoots is not allowed.
    let begin = Moment { pose: [0.0, -0.6, 0.0], velocity: [0.0, 1.2, 0.0], ..Moment::default() };
    let points = waypoints(&[[0.0, 0.0], [5.0, 0.0]]);
    let path = Path { points: &points, heading: Heading::Keep };
    let highest = |border: f64| {
        let is_clear = |pose: &[f64; AXES]| pose[1] <= border;
        let motion = along_in_motion(&begin, path, &limits(), |_| f64::INFINITY, is_clear)?;
        Some(moments(&motion, 0.01).iter().map(|moment| moment.pose[1]).fold(f64::MIN, f64::max))
    };
    assert!(highest(f64::MAX).ok_or("no motion")? > -0.01);
    assert!(highest(0.02).ok_or("no motion")? < 0.03);
    assert_eq!(highest(-0.59), None);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn a_path_begins_as_the_robot_moves_and_stays_within_the_limits(
        (speed, course, rate) in (0.05..2.5_f64, -3.1..3.1_f64, -1.0..1.0_f64),
        acceleration in prop::array::uniform3(-2.5..2.5_f64),
        points in prop::collection::vec(prop::array::uniform2(-3.0..3.0_f64), 1..6),
        heading in prop::sample::select(vec![Heading::Keep, Heading::Tangent, Heading::FixedRad(1.0)]),
    ) {
        let limits = limits();
        let velocity = [speed * course.cos(), speed * course.sin(), rate];
        let [x, y] = points[0];
        let begin = Moment { pose: [x + 0.3, y - 0.2, 0.4], velocity, acceleration };
        let Some(motion) = joined(&begin, &points, heading) else { return Ok(()) };
        let first = motion.at(0.0);
        for axis in 0..AXES {
            prop_assert!((first.pose[axis] - begin.pose[axis]).abs() < 1e-9);
            prop_assert!((first.velocity[axis] - velocity[axis]).abs() < 1e-9);
            prop_assert!((first.acceleration[axis] - acceleration[axis]).abs() < 1e-6);
        }
        let step_s = 1e-3;
        let moments = moments(&motion, step_s);
        let allowed = limits.speed_use_turned(&begin).max(1.0);
        for moment in &moments {
            prop_assert!(limits.speed_use(moment) < 1.02 * allowed, "{moment:?}");
            prop_assert!(limits.acceleration_use(moment) < 1.25, "{moment:?}");
        }
        for pair in moments.windows(2) {
            let [a, b] = [pair[0], pair[1]];
            for axis in 0..AXES {
                let explained =
                    |low: [f64; AXES], high: [f64; AXES]| 0.5 * step_s * (low[axis] + high[axis]);
                let moved = b.pose[axis] - a.pose[axis] - explained(a.velocity, b.velocity);
                prop_assert!(moved.abs() < 1e-4, "{a:?} {b:?}");
                let faster = b.velocity[axis]
                    - a.velocity[axis]
                    - explained(a.acceleration, b.acceleration);
                prop_assert!(faster.abs() < 1e-3, "{a:?} {b:?}");
                let change = (b.acceleration[axis] - a.acceleration[axis]).abs();
                prop_assert!(change < [0.2, 0.2, 0.3][axis], "{a:?} {b:?}");
            }
        }
        let end = motion.at(motion.duration_s());
        let last = points[points.len() - 1];
        prop_assert!(end.velocity.iter().all(|value| value.abs() < 1e-6), "{end:?}");
        prop_assert!((end.pose[0] - last[0]).hypot(end.pose[1] - last[1]) < 1e-6, "{end:?}");
    }
}
