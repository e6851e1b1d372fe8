use super::*;
use crate::{Heading, Waypoint};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, TAU};

fn limits() -> Limits {
    Limits::of(&robot::Robot::example())
}

fn waypoints(points: &[[f64; 2]]) -> Vec<Waypoint> {
    points.iter().copied().map(Waypoint::at).collect()
}

/// Without a speed of a place.
fn along(
    from: [f64; AXES],
    points: &[Waypoint],
    heading: Heading,
    limits: &Limits,
) -> Result<Motion, MotionError> {
    super::along(from, Path { points, heading }, limits, |_| f64::INFINITY)
}

fn moments(motion: &Motion) -> Vec<Moment> {
    (0..=2000).map(|i| motion.at(motion.duration_s() * f64::from(i) / 2000.0)).collect()
}

#[test]
fn a_straight_line_takes_the_time_of_the_trapezoid() -> Result<(), MotionError> {
    let limits = limits();
    let motion = along([0.0; 3], &waypoints(&[[1.0, 0.0], [20.0, 0.0]]), Heading::Keep, &limits)?;
    let (speed, acceleration) = (limits.speed_mps, SHARE * limits.acceleration_mps2);
    let expected = 20.0 / speed + speed / acceleration + window_s(&limits);
    assert!((motion.duration_s() / expected - 1.0).abs() < 0.01, "{}", motion.duration_s());
    Ok(())
}

#[test]
fn a_circle_is_driven_with_its_largest_centripetal_acceleration() -> Result<(), MotionError> {
    let (limits, radius) = (limits(), 1.0);
    let points: Vec<[f64; 2]> = (1..=200)
        .map(|i| (TAU * f64::from(i) / 100.0).sin_cos())
        .map(|(sin, cos)| [radius * sin, radius * (1.0 - cos)])
        .collect();
    let motion = along([0.0; 3], &waypoints(&points), Heading::Keep, &limits)?;
    let fastest = moments(&motion).into_iter().map(|m| m.velocity[0].hypot(m.velocity[1]));
    let expected = (SHARE * limits.acceleration_mps2 * radius).sqrt();
    let fastest = fastest.fold(0.0, f64::max);
    assert!((fastest / expected - 1.0).abs() < 0.05, "{fastest}, expected {expected}");
    Ok(())
}

#[test]
fn the_heading_is_kept_tangent_fixed_or_given() -> Result<(), MotionError> {
    let corner = [[1.0, 0.0], [1.0, 2.0]];
    let end = |heading, points: &[Waypoint]| -> Result<f64, MotionError> {
        let motion = along([0.0; 3], points, heading, &limits())?;
        Ok(motion.at(motion.duration_s()).pose[2])
    };
    let points = waypoints(&corner);
    assert!(end(Heading::Keep, &points)?.abs() < 1e-9);
    assert!((end(Heading::Tangent, &points)? - FRAC_PI_2).abs() < 1e-9);
    assert!((end(Heading::FixedRad(-1.0), &points)? + 1.0).abs() < 1e-9);
    let given: Vec<Waypoint> = points
        .iter()
        .zip([Some(3.0), Some(-3.0)])
        .map(|(point, yaw)| Waypoint { yaw, ..*point })
        .collect();
    assert!((end(Heading::Given, &given)? - (TAU - 3.0)).abs() < 1e-9, "by the shorter turn");
    Ok(())
}

#[test]
fn points_and_places_lower_the_speed() -> Result<(), MotionError> {
    let mut points = waypoints(&[[0.5, 0.0], [2.0, 0.0], [4.0, 0.0], [6.0, 0.0]]);
    points[2].speed_mps = Some(0.2);
    let in_zone = |pose: &[f64; AXES]| if pose[0] > 5.0 { 0.4 } else { f64::INFINITY };
    let path = Path { points: &points, heading: Heading::Keep };
    let motion = super::along([0.0; 3], path, &limits(), in_zone)?;
    let fastest = |from: f64, to: f64| {
        let moments = moments(&motion).into_iter();
        let there = moments.filter(|moment| (from..to).contains(&moment.pose[0]));
        there.map(|moment| moment.velocity[0]).fold(0.0, f64::max)
    };
    assert!(fastest(0.0, 1.9) > 0.5);
    assert!((fastest(2.1, 3.9) - 0.2).abs() < 1e-3, "{}", fastest(2.1, 3.9));
    assert!((fastest(5.0, 6.0) - 0.4).abs() < 1e-3, "{}", fastest(5.0, 6.0));
    points[0].speed_mps = Some(0.0);
    let refused = along([0.0; 3], &points, Heading::Keep, &limits()).err();
    assert_eq!(refused, Some(MotionError::Speed { point: 1, speed_mps: 0.0 }));
    Ok(())
}

#[test]
fn the_acceleration_along_a_path_changes_with_the_largest_jerk() -> Result<(), MotionError> {
    let limits = limits();
    let in_zone = |pose: &[f64; AXES]| if pose[0] > 3.0 { 0.4 } else { f64::INFINITY };
    // There and back: the robot brakes, turns round, and accelerates.
    let points = waypoints(&[[0.5, 0.0], [4.0, 0.0], [-1.0, 0.0]]);
    let path = Path { points: &points, heading: Heading::Keep };
    let motion = super::along([0.0; 3], path, &limits, in_zone)?;
    let step_s = 1e-3;
    let steps = (motion.duration_s() / step_s) as usize + 1;
    let accelerations: Vec<f64> = std::iter::once(0.0)
        .chain((0..=steps).map(|step| motion.at(step as f64 * step_s).acceleration[0]))
        .collect();
    let jerks = accelerations.windows(2).map(|pair| (pair[1] - pair[0]).abs() / step_s);
    let largest = jerks.fold(0.0, f64::max);
    assert!((0.9..1.05).contains(&(largest / limits.jerk_mps3)), "{largest} m/s³");
    Ok(())
}

#[test]
fn paths_that_cannot_be_driven_are_refused() {
    let refused =
        |points: &[[f64; 2]]| along([0.0; 3], &waypoints(points), Heading::Keep, &limits()).err();
    assert_eq!(refused(&[]), Some(MotionError::Points { points: 0 }));
    let many = vec![[0.0, 0.0]; 10_001];
    assert_eq!(refused(&many), Some(MotionError::Points { points: 10_001 }));
    let bad = MotionError::NotFinite { what: "point 2".into() };
    assert_eq!(refused(&[[0.0, 0.0], [f64::NAN, 1.0]]), Some(bad));
    assert_eq!(refused(&[[0.0, 0.0]]), Some(MotionError::TooShort { length_m: 0.0 }));
    let far = MotionError::StartsElsewhere { distance_m: 5.0, most_m: START_MAX_M };
    assert_eq!(refused(&[[5.0, 0.0]]), Some(far));
    let long = MotionError::TooLong { length_m: 3000.0 };
    assert_eq!(refused(&[[1.0, 0.0], [3000.0, 0.0]]), Some(long));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn a_timed_path_stays_within_the_limits_and_near_its_points(
        points in prop::collection::vec(prop::array::uniform2(-3.0..3.0_f64), 1..8),
        yaws in prop::collection::vec(-3.0..3.0_f64, 8),
        heading in prop::sample::select(vec![Heading::Keep, Heading::Tangent, Heading::Given]),
    ) {
        let limits = limits();
        let points: Vec<Waypoint> = points
            .iter()
            .zip(yaws)
            .map(|(&position, yaw)| Waypoint { yaw: Some(yaw), ..Waypoint::at(position) })
            .collect();
        let [x, y] = points[0].position;
        let motion = along([x + 0.5, y, 0.3], &points, heading, &limits)
            .map_err(|error| TestCaseError::fail(error.to_string()))?;
        let moments = moments(&motion);
        for moment in &moments {
            prop_assert!(limits.speed_use(moment) < 1.02, "{moment:?}");
            prop_assert!(limits.acceleration_use(moment) < 1.2, "{moment:?}");
        }
        for point in &points {
            let near = moments.iter().map(|moment| {
                (moment.pose[0] - point.position[0]).hypot(moment.pose[1] - point.position[1])
            });
            prop_assert!(near.fold(f64::MAX, f64::min) < 0.05);
        }
    }
}
