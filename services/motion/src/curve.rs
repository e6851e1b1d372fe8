//! Points → a smooth curve with headings.
//!
//! The polyline through the points is sampled at equal distances h. The samples are the control
//! points of a uniform cubic B-spline: twice continuously differentiable, through the first and the
//! last point, and at most h/3 beside the polyline (de Boor, A Practical Guide to Splines, 1978).

use crate::entry::Entry;
use crate::{MotionError, PATH_LENGTH_MAX_M, PATH_LENGTH_MIN_M, PLACE_MAX, POINTS_MAX};
use robot::AXES;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// How far the curve may be beside a corner of the polyline \[m\].
const CORNER_M: f64 = 0.02;
/// Distance of the samples \[m\].
const SAMPLE_M: f64 = 3.0 * CORNER_M;
/// Points that are closer together count as one \[m\].
const SAME_M: f64 = 1e-4;
/// Fewest samples of a curve.
const SAMPLES_MIN: usize = 4;
/// Way in which the robot turns from its present heading to that of the path \[m\].
const TURN_M: f64 = 0.5;

/// A point of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// x, y in the world \[m\].
    pub position: [f64; 2],
    /// Heading there, for [`Heading::Given`] \[rad\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw: Option<f64>,
    /// Largest speed on the way to it, beside the limits of the goal \[m/s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_mps: Option<f64>,
}

impl Waypoint {
    /// A point without heading and speed of its own.
    pub const fn at(position: [f64; 2]) -> Self {
        Self { position, yaw: None, speed_mps: None }
    }
}

/// Heading along a path.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Heading {
    /// The present one.
    #[default]
    Keep,
    /// That of the path.
    Tangent,
    /// Always this one \[rad\].
    FixedRad(f64),
    /// Those of the points, and between them by the shorter turn; the present one before the first.
    Given,
}

/// Points, and the heading between them.
#[derive(Debug, Clone, Copy)]
pub struct Path<'a> {
    /// The points.
    pub points: &'a [Waypoint],
    /// Heading on the way.
    pub heading: Heading,
}

/// Place on a curve with its derivatives by the curve's parameter, which counts samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Place {
    pub(crate) pose: [f64; AXES],
    pub(crate) first: [f64; AXES],
    pub(crate) second: [f64; AXES],
}

/// A curve of poses.
#[derive(Debug, Clone)]
pub(crate) struct Curve {
    /// Before the first sample, if the robot joins the path from a motion.
    entry: Option<Entry>,
    /// One before the first sample to one behind the last.
    control: Vec<[f64; AXES]>,
    /// Largest speed from each sample to the next, by the points \[m/s\]. An entry has that of the
    /// first sample.
    speeds: Vec<f64>,
    /// Distance of two samples along the polyline \[m\].
    sample_m: f64,
}

impl Curve {
    /// The curve from the pose `from` through the points of a path.
    ///
    /// # Errors
    /// [`MotionError`] if the points are no path.
    pub(crate) fn through(
        from: [f64; AXES],
        Path { points, heading }: Path<'_>,
    ) -> Result<Self, MotionError> {
        check(points, heading)?;
        let line = line(from, points);
        let along = lengths(&line);
        let length = along.last().copied().unwrap_or(0.0);
        if length > PATH_LENGTH_MAX_M {
            return Err(MotionError::TooLong { length_m: length });
        }
        if length < PATH_LENGTH_MIN_M {
            return Err(MotionError::TooShort { length_m: length });
        }
        let samples = ((length / SAMPLE_M).ceil() as usize).max(SAMPLES_MIN);
        let step = length / samples as f64;
        let (mut segment, mut yaw_before) = (0, from[2]);
        let mut speeds = vec![f64::INFINITY; samples];
        let control = (0..=samples).map(|sample| {
            let at = step * sample as f64;
            while segment + 2 < line.len() && along[segment + 1] <= at {
                segment += 1;
            }
            let (a, b) = (line[segment], line[segment + 1]);
            // A stretch between two samples may belong to two segments.
            for stretch in speeds.iter_mut().take(sample + 1).skip(sample.saturating_sub(1)) {
                *stretch = stretch.min(b.speed_mps.unwrap_or(f64::INFINITY));
            }
            let share = ((at - along[segment]) / (along[segment + 1] - along[segment])).min(1.0);
            let way = [b.position[0] - a.position[0], b.position[1] - a.position[1]];
            let turned = (at / TURN_M.min(length)).min(1.0);
            let wanted = match heading {
                Heading::Keep => from[2],
                Heading::Tangent => blend(from[2], way[1].atan2(way[0]), turned),
                Heading::FixedRad(yaw) => blend(from[2], yaw, turned),
                Heading::Given => {
                    let begin = a.yaw.unwrap_or(yaw_before);
                    blend(begin, b.yaw.unwrap_or(begin), share)
                }
            };
            yaw_before += nearest_turn(wanted - yaw_before);
            [a.position[0] + share * way[0], a.position[1] + share * way[1], yaw_before]
        });
        let control = control.collect();
        Ok(Self { entry: None, control: with_ends(control), speeds, sample_m: step })
    }

    /// The same from the sample `sample` on, with `entry` in place of what is before it.
    pub(crate) fn joined(&self, sample: usize, entry: Entry) -> Self {
        let mut joined = self.from(sample);
        // Also as slow as the points that are left out demand.
        let left_out = self.speeds.iter().take(sample + 1).copied().fold(f64::INFINITY, f64::min);
        joined.speeds.splice(0..0, vec![left_out; entry.length() as usize]);
        joined.entry = Some(entry);
        joined
    }

    fn from(&self, sample: usize) -> Self {
        let rest = |values: &[f64]| values.get(sample..).unwrap_or_default().to_vec();
        Self {
            entry: None,
            control: self.control.get(sample..).unwrap_or_default().to_vec(),
            speeds: rest(&self.speeds),
            sample_m: self.sample_m,
        }
    }

    /// The same up to the sample `sample`.
    pub(crate) fn until(&self, sample: usize) -> Self {
        let mut until = self.clone();
        until.control.truncate(sample + 3);
        until
    }

    /// Distance of two samples along the polyline \[m\].
    pub(crate) fn sample_m(&self) -> f64 {
        self.sample_m
    }

    /// Length of the entry in samples; 0 without one.
    pub(crate) fn entry_length(&self) -> f64 {
        self.entry.as_ref().map_or(0.0, Entry::length)
    }

    /// Largest speed between the samples around `parameter`, by the points \[m/s\].
    pub(crate) fn speed_max(&self, parameter: f64) -> f64 {
        self.speeds.get(parameter.max(0.0) as usize).copied().unwrap_or(f64::INFINITY)
    }

    /// Largest parameter.
    pub(crate) fn end(&self) -> f64 {
        self.entry_length() + self.control.len().saturating_sub(3) as f64
    }

    /// Third derivatives: the length of that of the position on an entry, 0 behind it, and the size
    /// of that of the heading.
    pub(crate) fn third_at(&self, parameter: f64) -> [f64; 2] {
        if let Some(entry) = self.entry.as_ref().filter(|entry| parameter < entry.length()) {
            return entry.third_at(parameter);
        }
        let (span, _) = self.span(parameter - self.entry_length());
        let yaw = self.control.get(span..span + 4).unwrap_or_default();
        let third = yaw.iter().zip([-1.0, 3.0, -3.0, 1.0]).map(|(point, weight)| weight * point[2]);
        [0.0, third.sum::<f64>().abs()]
    }

    /// The number of the span of the spline at `parameter`, and the place in it from 0 to 1.
    fn span(&self, parameter: f64) -> (usize, f64) {
        let last = self.control.len().saturating_sub(4);
        let span = (parameter.max(0.0) as usize).min(last);
        (span, parameter - span as f64)
    }

    /// The place at `parameter`, from 0 to [`end`](Self::end).
    pub(crate) fn at(&self, parameter: f64) -> Place {
        if let Some(entry) = self.entry.as_ref().filter(|entry| parameter < entry.length()) {
            return entry.at(parameter.max(0.0));
        }
        let (span, t) = self.span(parameter - self.entry_length());
        let u = 1.0 - t;
        let value = [
            u * u * u / 6.0,
            (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
            (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
            t * t * t / 6.0,
        ];
        let first = [
            -0.5 * u * u,
            0.5 * (3.0 * t * t - 4.0 * t),
            0.5 * (4.0 * u - 3.0 * u * u),
            0.5 * t * t,
        ];
        let second = [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t];
        let sum = |weights: [f64; 4]| {
            let control = self.control.iter().skip(span);
            control.zip(weights).fold([0.0; AXES], |sum, (point, weight)| {
                std::array::from_fn(|axis| sum[axis] + weight * point[axis])
            })
        };
        Place { pose: sum(value), first: sum(first), second: sum(second) }
    }
}

/// The control points of the spline through the first and the last of these samples.
fn with_ends(mut control: Vec<[f64; AXES]>) -> Vec<[f64; AXES]> {
    let beyond = |end: [f64; AXES], inner: [f64; AXES]| {
        std::array::from_fn(|axis| 2.0 * end[axis] - inner[axis])
    };
    if let (Some(&[first, second]), Some(&[before, last])) =
        (control.first_chunk::<2>(), control.last_chunk::<2>())
    {
        control.insert(0, beyond(first, second));
        control.push(beyond(last, before));
    }
    control
}

/// The line from `from` through `points`, without points that are where the last one is.
fn line(from: [f64; AXES], points: &[Waypoint]) -> Vec<Waypoint> {
    let mut line = vec![Waypoint { yaw: Some(from[2]), ..Waypoint::at([from[0], from[1]]) }];
    for point in points {
        // The robot begins with its own heading.
        let is_first = line.len() == 1;
        match line.last_mut() {
            Some(last) if distance(last.position, point.position) < SAME_M => {
                last.yaw = if is_first { last.yaw } else { point.yaw.or(last.yaw) };
            }
            _ => line.push(*point),
        }
    }
    line
}

/// The heading from `begin` to `end` by the shorter turn.
fn blend(begin: f64, end: f64, share: f64) -> f64 {
    begin + share * nearest_turn(end - begin)
}

/// The equal turn from −π to π.
fn nearest_turn(turn: f64) -> f64 {
    (turn + PI).rem_euclid(TAU) - PI
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Length of the line until each point \[m\].
fn lengths(line: &[Waypoint]) -> Vec<f64> {
    let mut length = 0.0;
    let steps = line.windows(2).map(|pair| distance(pair[0].position, pair[1].position));
    std::iter::once(0.0)
        .chain(steps.map(|step| {
            length += step;
            length
        }))
        .collect()
}

fn check(points: &[Waypoint], heading: Heading) -> Result<(), MotionError> {
    if points.is_empty() || points.len() > POINTS_MAX {
        return Err(MotionError::Points { points: points.len() });
    }
    for (number, point) in points.iter().enumerate() {
        let values = point.position.iter().chain(&point.yaw);
        if !values.into_iter().all(|value| value.abs() <= PLACE_MAX) {
            return Err(MotionError::NotFinite { what: format!("point {}", number + 1) });
        }
        if let Some(speed_mps) = point.speed_mps.filter(|speed| speed.is_nan() || *speed <= 0.0) {
            return Err(MotionError::Speed { point: number + 1, speed_mps });
        }
    }
    match heading {
        Heading::FixedRad(yaw) if yaw.is_nan() || yaw.abs() > PLACE_MAX => {
            Err(MotionError::NotFinite { what: "the heading".into() })
        }
        _ => Ok(()),
    }
}
