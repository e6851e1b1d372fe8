//! A robot that moves → a path, without a stop.
//!
//! An entry ([`Entry`]) leads from the present motion to a place on the curve of the path, and
//! takes the place of what is before it. Of several entries, which end earlier or later and are more or
//! less stretched, the robot drives the earliest one that is hardly slower than the fastest one.

use crate::curve::{Curve, Path};
use crate::entry::{Begin, Entry};
use crate::timing::{GRID, SHARE, START_MAX_M, TimedCurve};
use crate::{Limits, Moment, Motion, along, to_standstill};
use robot::AXES;

/// Places on a path at which an entry can end.
const PLACES: u32 = 12;
/// Samples of an entry per sample of the path, by its length.
const STRETCHES: [f64; 3] = [1.0, 1.4, 2.0];
/// Grid points per sample while entries are compared.
const COARSE: usize = 3;
/// An entry that takes this much longer than the fastest one is as good \[s\].
const AS_GOOD_S: f64 = 0.2;
/// Way beside those to the first point and to stop \[m\].
const MARGIN_M: f64 = 0.3;
/// Part of the limit of acceleration that a motion may use: between the places of the grid it can
/// be some percent higher. A motion with more is refused.
const ACCELERATION_USE_MAX: f64 = 1.2;
/// Time between two moments at which this is checked \[s\].
const CHECK_S: f64 = 0.01;
/// Most samples of an entry.
const SAMPLES_MAX: f64 = 500.0;

/// The motion from `begin` onto `path` without a stop, then along it to a standstill at its last
/// point. It leaves out the begin of the path, as far as the robot needs to change its motion.
/// `speed_at` is the largest speed at a pose \[m/s\]. `is_clear` tells whether the robot may leave
/// the path at a pose.
///
/// None if the robot stands, if no such motion is within the limits, if it is faster to stop first,
/// or if the path is none: then the robot stops first ([`to_standstill`], [`along`]).
pub fn along_in_motion(
    begin: &Moment,
    path: Path<'_>,
    limits: &Limits,
    speed_at: impl Fn(&[f64; AXES]) -> f64,
    is_clear: impl Fn(&[f64; AXES]) -> bool,
) -> Option<Motion> {
    // A heading that is kept is that of the robot if it stopped.
    let stop = to_standstill(begin, limits).ok()?;
    let [x, y, _] = begin.pose;
    let from = [x, y, stop.at(stop.duration_s()).pose[2]];
    let curve = Curve::through(from, path).ok()?;
    let [first_x, first_y] = path.points.first()?.position;
    let first_m = (first_x - x).hypot(first_y - y);
    if first_m > START_MAX_M {
        return None;
    }
    let sample_m = curve.sample_m();
    let start = Begin::of(begin, sample_m)?;
    // Some of the path is left out: to its first point and back, and twice the way to stop.
    let [vx, vy, _] = begin.velocity;
    let stop_m = 0.5 * vx.hypot(vy).powi(2) / (SHARE * limits.acceleration_mps2);
    let farthest = ((2.0 * (first_m + stop_m) + MARGIN_M) / sample_m).min(curve.end());
    let stands = farthest + (2.0 * stop_m + MARGIN_M) / sample_m;
    let part = curve.until(stands.min(curve.end()) as usize);

    let mut ends: Vec<usize> = (1..=PLACES)
        .map(|place| (farthest * f64::from(place) / f64::from(PLACES)).round() as usize)
        .filter(|&sample| sample > 0)
        .collect();
    ends.dedup();
    let entries = ends.iter().flat_map(|&end| STRETCHES.map(|stretch| (end, stretch)));
    let mut fastest_s = f64::INFINITY;
    let compared: Vec<(usize, Entry, f64)> = entries
        .filter_map(|(end, stretch)| {
            let entry = Entry::between(&start, &curve.at(end as f64), sample_m, stretch);
            if entry.length() > SAMPLES_MAX || !entry.samples().all(|pose| is_clear(&pose)) {
                return None;
            }
            let joined = part.joined(end, entry.clone());
            let timed = TimedCurve::new(joined, Some(&start), limits, &speed_at, COARSE)?;
            fastest_s = fastest_s.min(timed.duration_s());
            Some((end, entry, timed.duration_s()))
        })
        .collect();
    let motion = compared
        .into_iter()
        .filter(|(.., duration_s)| *duration_s <= fastest_s + AS_GOOD_S)
        .find_map(|(end, entry, _)| {
            let joined = curve.joined(end, entry);
            let timed = TimedCurve::new(joined, Some(&start), limits, &speed_at, GRID)?;
            let motion = timed.motion();
            keeps_to(&motion, limits).then_some(motion)
        })?;
    let from_stop = along(stop.at(stop.duration_s()).pose, path, limits, speed_at);
    let is_faster =
        from_stop.is_ok_and(|path| motion.duration_s() > stop.duration_s() + path.duration_s());
    (!is_faster).then_some(motion)
}

/// Whether the accelerations of `motion` are within the limits.
fn keeps_to(motion: &Motion, limits: &Limits) -> bool {
    let moments = (motion.duration_s() / CHECK_S) as u32;
    (0..=moments).all(|moment| {
        let moment = motion.at(f64::from(moment) * CHECK_S);
        limits.acceleration_use(&moment) < ACCELERATION_USE_MAX
    })
}

#[cfg(test)]
mod tests;
