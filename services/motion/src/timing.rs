//! A curve → the fastest motion along it within the limits.
//!
//! With x = ṡ² and u = s̈, velocity and acceleration of the pose are q' √x and q' u + q'' x. All
//! limits are linear in (u, x) at each place. A pass from the end backwards finds the largest x
//! from which the robot can still stop. A pass forwards accelerates as much as that allows (Pham
//! and Pham, TOPP-RA, IEEE Transactions on Robotics 34, 2018). The limits hold at the places of a
//! grid. Between them, near a reversal, an acceleration can be some percent higher.

use crate::curve::{Curve, Heading, Place, Waypoint};
use crate::{Course, Limits, Moment, Motion, MotionError};
use robot::AXES;

/// Largest distance of a path's first point from the robot \[m\].
const START_MAX_M: f64 = 1.0;
/// Grid points per sample of the curve.
const GRID: usize = 10;
/// Bisections of one largest x.
const BISECTIONS: usize = 50;
/// Share of the acceleration that is available along the path, and across it: together they are at
/// most the whole one.
const SHARE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A curve with a time at each place of its grid.
#[derive(Debug, Clone)]
pub(crate) struct TimedCurve {
    curve: Curve,
    /// Distance of two grid points, in the curve's parameter.
    step: f64,
    /// x at each grid point.
    speeds: Vec<f64>,
    /// Time at each grid point \[s\].
    times: Vec<f64>,
}

/// The fastest motion from standing at `from` through `points`, to a standstill at the last one.
/// `speed_at` is the largest speed at a pose \[m/s\], beside that of the points and `limits`.
///
/// # Errors
/// [`MotionError`] if the points are no path, or begin elsewhere.
pub fn along(
    from: [f64; AXES],
    points: &[Waypoint],
    heading: Heading,
    limits: &Limits,
    speed_at: impl Fn(&[f64; AXES]) -> f64,
) -> Result<Motion, MotionError> {
    let curve = Curve::through(from, points, heading)?;
    let first = points.first().map_or([from[0], from[1]], |point| point.position);
    let distance_m = (first[0] - from[0]).hypot(first[1] - from[1]);
    if distance_m > START_MAX_M {
        return Err(MotionError::StartsElsewhere { distance_m, most_m: START_MAX_M });
    }
    let timed = TimedCurve::new(curve, limits, speed_at);
    let duration_s = timed.times.last().copied().unwrap_or(0.0);
    if !duration_s.is_finite() {
        return Err(MotionError::NotFound { reason: "the path cannot be driven".into() });
    }
    Ok(Motion { course: Course::Path(timed), duration_s })
}

/// (a, b, c) of |a u + b x| ≤ c: along the path, across it, and for the heading.
type Rows = [(f64, f64, f64); 3];

/// The limits of one interval of the curve, in u and in the x of its begin.
struct Stage {
    /// Largest x by the speeds.
    x_max: f64,
    /// At the begin and at the end of the interval.
    rows: [Rows; 2],
}

impl Stage {
    /// `speed_max` is the largest planar speed in it \[m/s\].
    fn new(begin: &Place, end: &Place, step: f64, limits: &Limits, speed_max: f64) -> Self {
        let unit = Moment { pose: begin.pose, velocity: begin.first, ..Moment::default() };
        let (speed, planar) = (limits.speed_use(&unit), begin.first[0].hypot(begin.first[1]));
        let by_limits = if speed > 0.0 { speed.powi(-2) } else { f64::MAX };
        // x at the end is x + 2 step u.
        let at_end = rows(end, limits).map(|(a, b, c)| (a + 2.0 * step * b, b, c));
        Self {
            x_max: by_limits.min((speed_max / planar).powi(2)),
            rows: [rows(begin, limits), at_end],
        }
    }

    /// Range of u at x; empty if x is too large.
    fn accelerations(&self, x: f64) -> (f64, f64) {
        let mut range = (f64::MIN, f64::MAX);
        for &(a, b, c) in self.rows.as_flattened() {
            let rest = b * x;
            if a.abs() > 1e-12 {
                let (low, high) = ((-c - rest) / a, (c - rest) / a);
                range = (range.0.max(low.min(high)), range.1.min(low.max(high)));
            } else if rest.abs() > c {
                range = (f64::MAX, f64::MIN);
            }
        }
        range
    }

    /// Whether x can become at most `next` within `step`, and not negative.
    fn reaches(&self, x: f64, next: f64, step: f64) -> bool {
        let (low, high) = self.accelerations(x);
        let (least, most) = (-x / (2.0 * step), (next - x) / (2.0 * step));
        low.max(least) <= high.min(most)
    }

    /// The largest x from which x can become at most `next` within `step`.
    fn controllable(&self, next: f64, step: f64) -> f64 {
        let (mut low, mut high) = (0.0, self.x_max);
        if self.reaches(high, next, step) {
            return high;
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if self.reaches(middle, next, step) {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }
}

fn rows(place: &Place, limits: &Limits) -> Rows {
    let ([x, y, yaw], [ddx, ddy, ddyaw]) = (place.first, place.second);
    let length = x.hypot(y);
    let (along, across) = if length > 0.0 {
        ((x * ddx + y * ddy) / length, (x * ddy - y * ddx) / length)
    } else {
        (ddx.hypot(ddy), 0.0)
    };
    let acceleration = SHARE * limits.acceleration_mps2;
    [
        (length, along, acceleration),
        (0.0, across, acceleration),
        (yaw, ddyaw, limits.yaw_acceleration_radps2),
    ]
}

impl TimedCurve {
    fn new(curve: Curve, limits: &Limits, speed_at: impl Fn(&[f64; AXES]) -> f64) -> Self {
        let intervals = (curve.end() as usize * GRID).max(1);
        let step = curve.end() / intervals as f64;
        let places: Vec<Place> =
            (0..=intervals).map(|index| curve.at(step * index as f64)).collect();
        // At the samples: between two of them the lower speed counts.
        let speeds_at: Vec<f64> =
            places.iter().step_by(GRID).map(|place| speed_at(&place.pose)).collect();
        let speed_max = |index: usize| {
            let around = speeds_at.iter().skip(index / GRID).take(2);
            around.copied().fold(curve.speed_max(step * index as f64), f64::min)
        };
        let stages: Vec<Stage> = places
            .windows(2)
            .enumerate()
            .map(|(index, pair)| Stage::new(&pair[0], &pair[1], step, limits, speed_max(index)))
            .collect();
        // Backwards, to a standstill at the end.
        let mut speeds = vec![0.0; intervals + 1];
        for index in (0..intervals).rev() {
            speeds[index] = stages[index].controllable(speeds[index + 1], step);
        }
        // Forwards, from a standstill.
        speeds[0] = 0.0;
        for index in 0..intervals {
            let (_, fastest) = stages[index].accelerations(speeds[index]);
            let reached = speeds[index] + 2.0 * step * fastest;
            speeds[index + 1] = speeds[index + 1].min(reached.max(0.0));
        }
        let mut time = 0.0;
        let times = std::iter::once(0.0)
            .chain(speeds.windows(2).map(|pair| {
                time += 2.0 * step / (pair[0].sqrt() + pair[1].sqrt());
                time
            }))
            .collect();
        Self { curve, step, speeds, times }
    }

    pub(crate) fn at(&self, time: f64) -> Moment {
        let index = self.times.partition_point(|&at| at <= time).saturating_sub(1);
        let entry = |values: &[f64], index: usize| {
            values.get(index).or(values.last()).copied().unwrap_or(0.0)
        };
        let (begin, from, to) =
            (entry(&self.times, index), entry(&self.speeds, index), entry(&self.speeds, index + 1));
        let rate = (to - from) / (2.0 * self.step);
        let since = time - begin;
        let speed = (from.sqrt() + rate * since).max(0.0);
        let moved = since * (from.sqrt() + 0.5 * rate * since);
        let place = self.curve.at((self.step * index as f64 + moved).min(self.curve.end()));
        Moment {
            pose: place.pose,
            velocity: place.first.map(|first| first * speed),
            acceleration: std::array::from_fn(|axis| {
                place.first[axis] * rate + place.second[axis] * speed * speed
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
        super::along(from, points, heading, limits, |_| f64::INFINITY)
    }

    fn moments(motion: &Motion) -> Vec<Moment> {
        (0..=2000).map(|i| motion.at(motion.duration_s() * f64::from(i) / 2000.0)).collect()
    }

    #[test]
    fn a_straight_line_takes_the_time_of_the_trapezoid() -> Result<(), MotionError> {
        let limits = limits();
        let motion =
            along([0.0; 3], &waypoints(&[[1.0, 0.0], [20.0, 0.0]]), Heading::Keep, &limits)?;
        let (speed, acceleration) = (limits.speed_mps, SHARE * limits.acceleration_mps2);
        let expected = 20.0 / speed + speed / acceleration;
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
        let motion = super::along([0.0; 3], &points, Heading::Keep, &limits(), in_zone)?;
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
    fn paths_that_cannot_be_driven_are_refused() {
        let refused = |points: &[[f64; 2]]| {
            along([0.0; 3], &waypoints(points), Heading::Keep, &limits()).err()
        };
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
}
