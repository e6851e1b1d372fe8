//! A curve → the fastest motion along it within the limits.
//!
//! With x = ṡ² and u = s̈, velocity and acceleration of the pose are q' √x and q' u + q'' x. All
//! limits are linear in (u, x) at each place. A pass from the end backwards finds the largest x
//! from which the robot can still stop. A pass forwards accelerates as much as that allows (Pham
//! and Pham, TOPP-RA, IEEE Transactions on Robotics 34, 2018). The limits hold at the places of a
//! grid. Between them, near a reversal, an acceleration can be some percent higher.
//!
//! The motion is averaged over a time T, which limits the jerk along the path ([`TimeLaw`]). The
//! mean would be faster than the slowest place allows, so each x is held for T/2 before and behind
//! its place. The third derivative of the heading by its place is limited likewise, and on an entry
//! that of the position. The jerk across the rest of a path follows from its curve, and is not
//! limited.

use crate::curve::{Curve, Path, Place};
use crate::entry::Begin;
use crate::time_law::{Start, TimeLaw};
use crate::{Course, Limits, Moment, Motion, MotionError};
use robot::AXES;

/// Largest distance of a path's first point from the robot \[m\].
pub(crate) const START_MAX_M: f64 = 1.0;
/// Grid points per sample of the curve.
pub(crate) const GRID: usize = 10;
/// Bisections of one largest x.
const BISECTIONS: usize = 50;
/// Share of the acceleration that is available along the path, and across it: together they are at
/// most the whole one.
pub(crate) const SHARE: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Excess of a speed at the begin that counts as none: that of rounding.
const ROUNDING: f64 = 1e-6;
/// Part of the acceleration along the path with which a robot that is too fast brakes.
const BRAKING: f64 = 0.7;

/// A curve with the place of the robot at each time.
#[derive(Debug, Clone)]
pub(crate) struct TimedCurve {
    curve: Curve,
    law: TimeLaw,
}

/// The fastest motion from standing at `from` along `path`, to a standstill at its last point.
/// `speed_at` is the largest speed at a pose \[m/s\], beside that of the points and `limits`.
///
/// # Errors
/// [`MotionError`] if the points are no path, or begin elsewhere.
pub fn along(
    from: [f64; AXES],
    path: Path<'_>,
    limits: &Limits,
    speed_at: impl Fn(&[f64; AXES]) -> f64,
) -> Result<Motion, MotionError> {
    let curve = Curve::through(from, path)?;
    let first = path.points.first().map_or([from[0], from[1]], |point| point.position);
    let distance_m = (first[0] - from[0]).hypot(first[1] - from[1]);
    if distance_m > START_MAX_M {
        return Err(MotionError::StartsElsewhere { distance_m, most_m: START_MAX_M });
    }
    TimedCurve::new(curve, None, limits, speed_at, GRID)
        .map(TimedCurve::motion)
        .ok_or_else(|| MotionError::NotFound { reason: "the path cannot be driven".into() })
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
    /// `shares` of the acceleration are available along and across.
    fn new([begin, end]: [&Place; 2], step: f64, limits: &Limits, shares: [f64; 2]) -> Self {
        let unit = Moment { pose: begin.pose, velocity: begin.first, ..Moment::default() };
        let speed = limits.speed_use(&unit);
        // x at the end is x + 2 step u.
        let at_end = rows(end, limits, shares).map(|(a, b, c)| (a + 2.0 * step * b, b, c));
        Self {
            x_max: if speed > 0.0 { speed.powi(-2) } else { f64::MAX },
            rows: [rows(begin, limits, shares), at_end],
        }
    }

    /// Largest x with which u can be 0, by the acceleration across and that of the heading.
    fn steady(&self) -> f64 {
        let [[_, across, heading], _] = &self.rows;
        [across, heading].into_iter().fold(f64::INFINITY, |least, (_, b, c)| least.min(c / b.abs()))
    }

    /// Whether u and x are allowed, beside what the begin of a motion has anyway.
    fn allows(&self, x: f64, u: f64) -> bool {
        let [begin, _] = &self.rows;
        let within =
            |(a, b, c): &(f64, f64, f64)| (a * u + b * x).abs() <= c.max(1.05 * (a * u).abs());
        x <= self.x_max * (1.0 + ROUNDING) && begin.iter().all(within)
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

fn rows(place: &Place, limits: &Limits, shares: [f64; 2]) -> Rows {
    let ([x, y, yaw], [ddx, ddy, ddyaw]) = (place.first, place.second);
    let length = x.hypot(y);
    let (along, across) = if length > 0.0 {
        ((x * ddx + y * ddy) / length, (x * ddy - y * ddx) / length)
    } else {
        (ddx.hypot(ddy), 0.0)
    };
    let [most_along, most_across] = shares.map(|share| share * limits.acceleration_mps2);
    [
        (length, along, most_along),
        (0.0, across, most_across),
        (yaw, ddyaw, limits.yaw_acceleration_radps2),
    ]
}

impl TimedCurve {
    /// The motion along `curve`, from `begin` or from standing, on a grid of `grid` points per
    /// sample. None if there is no such motion: the begin may be too fast for what follows.
    pub(crate) fn new(
        curve: Curve,
        begin: Option<&Begin>,
        limits: &Limits,
        speed_at: impl Fn(&[f64; AXES]) -> f64,
        grid: usize,
    ) -> Option<Self> {
        let intervals = (curve.end() as usize * grid).max(1);
        let step = curve.end() / intervals as f64;
        let (speed, rate) = begin.map_or((0.0, 0.0), |begin| (begin.speed, begin.rate));
        let start = Start::averaged(speed, rate, window_s(limits))?;
        let grid = Grid { curve: &curve, begin, step, per_sample: grid };
        let first = grid.first(&start);
        let x = |index: usize| start.square_at(step * index as f64);
        let stages = grid.stages(&start, limits, speed_at);
        // Before its first grid point the motion is what it is.
        let is_within =
            |index| stages.get(index).is_some_and(|stage: &Stage| stage.allows(x(index), rate));
        if x(first) < 0.0 || first >= intervals || !(1..first).all(is_within) {
            return None;
        }
        let stages = stages.get(first..)?;
        // Backwards, to a standstill at the end.
        let mut speeds = vec![0.0; stages.len() + 1];
        for (index, stage) in stages.iter().enumerate().rev() {
            speeds[index] = stage.controllable(speeds[index + 1], step);
        }
        if x(first) > speeds[0] * (1.0 + ROUNDING) {
            return None;
        }
        // Forwards, from the begin.
        speeds[0] = x(first);
        for (index, stage) in stages.iter().enumerate() {
            let (_, fastest) = stage.accelerations(speeds[index]);
            let reached = speeds[index] + 2.0 * step * fastest;
            speeds[index + 1] = speeds[index + 1].min(reached.max(0.0));
        }
        let law = TimeLaw::new(start, step, first, &speeds);
        law.duration_s().is_finite().then_some(Self { curve, law })
    }

    pub(crate) fn duration_s(&self) -> f64 {
        self.law.duration_s()
    }

    pub(crate) fn motion(self) -> Motion {
        Motion { duration_s: self.duration_s(), course: Course::Path(Box::new(self)) }
    }

    pub(crate) fn at(&self, time: f64) -> Moment {
        let [parameter, speed, rate] = self.law.at(time);
        let place = self.curve.at(parameter.min(self.curve.end()));
        Moment {
            pose: place.pose,
            velocity: place.first.map(|first| first * speed),
            acceleration: std::array::from_fn(|axis| {
                place.first[axis] * rate + place.second[axis] * speed * speed
            }),
        }
    }
}

/// Time over which a motion is averaged \[s\]: from the largest acceleration along the path to the
/// largest deceleration, with the largest jerk.
fn window_s(limits: &Limits) -> f64 {
    2.0 * SHARE * limits.acceleration_mps2 / limits.jerk_mps3
}

/// The places of a curve at which its limits hold.
struct Grid<'a> {
    curve: &'a Curve,
    begin: Option<&'a Begin>,
    /// Distance of two grid points, in the curve's parameter.
    step: f64,
    per_sample: usize,
}

impl Grid<'_> {
    fn parameter(&self, index: usize) -> f64 {
        self.step * index as f64
    }

    /// Number of the first grid point that a motion reaches.
    fn first(&self, start: &Start) -> usize {
        (start.at() / self.step).ceil() as usize
    }

    /// The limits of all intervals, for a motion that begins with `start`.
    fn stages(
        &self,
        start: &Start,
        limits: &Limits,
        speed_at: impl Fn(&[f64; AXES]) -> f64,
    ) -> Vec<Stage> {
        let &Self { curve, begin, step, per_sample } = self;
        let (samples, window_s) = (curve.end() as usize, start.window_s());
        let places: Vec<Place> =
            (0..=samples * per_sample).map(|index| curve.at(self.parameter(index))).collect();
        let shares = |index: usize| {
            let done = self.parameter(index) / curve.entry_length();
            begin.map_or([SHARE; 2], |begin| begin.shares(done, limits))
        };
        let mut stages: Vec<Stage> = places
            .windows(2)
            .enumerate()
            .map(|(index, pair)| Stage::new([&pair[0], &pair[1]], step, limits, shares(index)))
            .collect();
        // At the samples: between two of them the lower speed counts.
        let speeds_at: Vec<f64> =
            places.iter().step_by(per_sample).map(|place| speed_at(&place.pose)).collect();
        let squared =
            |speed: f64, place: &Place| (speed / place.first[0].hypot(place.first[1])).powi(2);
        let by_limits: Vec<f64> = stages
            .iter()
            .zip(&places)
            .enumerate()
            .map(|(index, (stage, place))| {
                stage.x_max.min(squared(curve.speed_max(self.parameter(index)), place))
            })
            .collect();
        let by_limits = self.with_begin(held(&by_limits, step, window_s), start, limits);
        let by_place: Vec<f64> = stages
            .iter()
            .zip(&places)
            .zip(&by_limits)
            .enumerate()
            .map(|(index, ((stage, place), by_limits))| {
                let around = speeds_at.iter().skip(index / per_sample).take(2);
                let slowest = around.copied().fold(f64::INFINITY, f64::min);
                let [third, yaw_third] = curve.third_at(self.parameter(index));
                let steepest = (third / limits.jerk_mps3).max(yaw_third / limits.yaw_jerk_radps3);
                let by_jerk = steepest.powf(-2.0 / 3.0);
                let x_max = stage.steady().min(squared(slowest, place)).min(by_jerk);
                // A higher one does not count.
                if x_max < *by_limits { x_max } else { f64::INFINITY }
            })
            .collect();
        let by_place = held(&by_place, step, window_s);
        for (stage, x_max) in stages.iter_mut().zip(by_limits.iter().zip(by_place)) {
            stage.x_max = x_max.0.min(x_max.1);
        }
        stages
    }

    /// `by_limits`, and from a begin that is faster down to it.
    fn with_begin(&self, mut by_limits: Vec<f64>, start: &Start, limits: &Limits) -> Vec<f64> {
        let braking = BRAKING * SHARE * limits.acceleration_mps2 / self.curve.sample_m();
        let first = self.first(start);
        let x = start.square_at(self.parameter(first)).max(start.square_at(0.0));
        for (index, x_max) in by_limits.iter_mut().enumerate() {
            let driven = self.parameter(index.saturating_sub(first));
            *x_max = x_max.max(x - 2.0 * braking * driven);
        }
        by_limits
    }
}

/// Each of these x for half of `window_s` before and behind its place.
fn held(x_max: &[f64], step: f64, window_s: f64) -> Vec<f64> {
    let mut held = x_max.to_vec();
    for (index, x) in x_max.iter().enumerate().filter(|(_, x)| x.is_finite()) {
        let reach = (0.5 * window_s * x.sqrt() / step).min(x_max.len() as f64) as usize + 1;
        let around = held.iter_mut().take(index + reach + 1);
        for place in around.skip(index.saturating_sub(reach)) {
            *place = place.min(*x);
        }
    }
    held
}

#[cfg(test)]
mod tests;
