//! The paper's figures 3 and 4: the path of the robot, and its distance from the reference.

use super::axis::{Axis, Extent};
use super::figure::{Figure, Key, Look, Records, gap};
use super::panel::Panel;
use super::record::Record;
use crate::summary::{ARRIVAL_BAND_M, SPEED_BAND_MPS};
use protocol::topic::Topic;
use std::f64::consts::{PI, TAU};

/// Smallest and largest height of the plane \[units\].
const PLANE_HEIGHT: (f64, f64) = (90.0, 300.0);

/// The path in the plane, with the reference.
pub(super) fn path(records: &Records<'_>) -> Figure {
    let mut figure = Figure::new(
        "path",
        "Path in the plane",
        format!("Position of the robot{}.{}", measured(records), surroundings(records)),
    );
    (figure.paper, figure.wide) = (Some(3), true);
    let (mut x, mut y) = (Extent::NONE, Extent::NONE);
    for record in records.all() {
        x.include(
            record
                .motion()
                .map(|(_, pose, _)| pose[0])
                .chain(record.plans.iter().map(|plan| plan.reference[0]))
                .chain(record.goals.iter().map(|goal| goal[0])),
        );
        y.include(
            record
                .motion()
                .map(|(_, pose, _)| pose[1])
                .chain(record.plans.iter().map(|plan| plan.reference[1]))
                .chain(record.goals.iter().map(|goal| goal[1])),
        );
    }
    let (x, y, height) = same_scale(x.padded(), y.padded(), Panel::width_of_axes());
    let mut panel = Panel::new("y [m]", Axis::linear(x), Axis::linear(y), records.detail)
        .shaped("x [m]", height);
    for outline in records.all().iter().flat_map(|record| &record.obstacles) {
        let class = if outline.moves { "moves" } else { "stands" };
        panel.shape(class, &outline.corners, outline.radius);
    }
    // Equal references are drawn on top of each other.
    for record in records.all() {
        panel.track(
            "reference",
            record.plans.iter().map(|plan| (plan.reference[0], plan.reference[1])),
        );
    }
    let last = records.all().len().saturating_sub(1);
    for (index, (colour, record)) in records.coloured().enumerate() {
        // If paths are almost the same, both stay visible: the upper one is thinner.
        let class = if index < last { format!("{colour} under") } else { colour };
        panel.track(&class, record.motion().map(|(_, pose, _)| (pose[0], pose[1])));
    }
    for record in records.all() {
        panel.dots("goal", record.goals.iter().map(|goal| (goal[0], goal[1])));
    }
    figure.panels.push(panel.finish(&format!("Path in the plane: {}", records.names())));
    figure.legend = records.legend(Look::Line, "", |_| true);
    figure.legend.extend(reference_key(records));
    if records.all().iter().any(|record| !record.goals.is_empty()) {
        let (colour, label) = ("goal".to_owned(), "goal".to_owned());
        figure.legend.push(Key { colour, look: Look::Dot, label });
    }
    if records.all().iter().any(|record| !record.obstacles.is_empty()) {
        let (colour, label) = ("reference".to_owned(), "obstacle".to_owned());
        figure.legend.push(Key { colour, look: Look::Band, label });
    }
    figure.missing = records.without(Topic::Plan);
    figure
}

/// Note on the obstacles, if there are any.
fn surroundings(records: &Records<'_>) -> &'static str {
    let any = records.all().iter().any(|record| !record.obstacles.is_empty());
    if any {
        " Obstacles are as sensors and planners reported them; the map is not in the record. One \
         that moves is drawn every 0.25 m."
    } else {
        ""
    }
}

/// Position, heading and speed against the reference.
pub(super) fn errors(records: &Records<'_>) -> Figure {
    let about = format!(
        "Motion of the robot minus its reference{}. Thin lines: the robot has arrived within \
         {ARRIVAL_BAND_M:.2} m, its speed has settled within {SPEED_BAND_MPS} m/s.",
        measured(records)
    );
    let mut figure = Figure::new("errors", "Tracking errors", about);
    figure.paper = Some(4);
    figure.missing = records.without(Topic::Plan);
    let distance = errors_of(records, |error| error.distance);
    if distance.iter().all(Vec::is_empty) {
        return figure;
    }
    let extent =
        |all: &[Vec<(f64, f64)>]| Extent::of(all.iter().flatten().map(|&(_, value)| value));
    // The distance 0 of a record that begins on its reference would stretch the logarithmic axis.
    let shown = Extent { low: extent(&distance).low.max(1e-4), ..extent(&distance) };
    let panel = Panel::new(
        "distance [m], logarithmic",
        records.time,
        Axis::logarithmic(shown),
        records.detail,
    );
    figure.panels.push(drawn(
        panel,
        records,
        &distance,
        &[ARRIVAL_BAND_M],
        "Distance from the reference",
    ));
    let speed_band = [-SPEED_BAND_MPS, SPEED_BAND_MPS];
    let parts: [Part; 4] = [
        ("x [m]", "Error along x", |error| error.x),
        ("y [m]", "Error along y", |error| error.y),
        ("heading [rad]", "Heading error", |error| error.heading),
        ("speed [m/s]", "Speed error", |error| error.speed),
    ];
    for (title, label, part) in parts {
        let lines = errors_of(records, part);
        let panel =
            Panel::new(title, records.time, Axis::linear(extent(&lines).padded()), records.detail);
        let levels: &[f64] = if label == "Speed error" { &speed_band } else { &[0.0] };
        figure.panels.push(drawn(panel, records, &lines, levels, label));
    }
    figure.legend = records.legend(Look::Line, "", |record| !record.plans.is_empty());
    figure
}

/// Note for figures of records without truth.
pub(super) fn measured(records: &Records<'_>) -> String {
    let names: Vec<&str> = records
        .all()
        .iter()
        .filter(|record| record.truths.is_empty())
        .map(|record| record.name.as_str())
        .collect();
    if names.is_empty() {
        String::new()
    } else {
        format!(" (as measured, since the truth is not in the record: {})", names.join(", "))
    }
}

/// Legend entry of the dashed line, if there is one.
pub(super) fn reference_key(records: &Records<'_>) -> Option<Key> {
    let drawn = records.all().iter().any(|record| !record.plans.is_empty());
    drawn.then(|| Key {
        colour: "reference".to_owned(),
        look: Look::Dashed,
        label: "reference".to_owned(),
    })
}

fn drawn(
    mut panel: Panel,
    records: &Records<'_>,
    lines: &[Vec<(f64, f64)>],
    levels: &[f64],
    label: &str,
) -> String {
    for &level in levels {
        panel.level(level, "");
    }
    for ((colour, record), line) in records.coloured().zip(lines) {
        panel.line(&colour, gap(record), line.iter().copied());
    }
    panel.finish(&format!("{label}: {}", records.names()))
}

/// A part of the errors: its title, its label, and its value.
type Part = (&'static str, &'static str, fn(&Error) -> f64);

/// Error of the robot against its reference.
struct Error {
    distance: f64,
    x: f64,
    y: f64,
    heading: f64,
    speed: f64,
}

impl Error {
    fn of(pose: &[f64; 3], velocity: &[f64; 3], reference: &[f64; 6]) -> Self {
        let [x_ref, y_ref, yaw_ref, forward_ref, left_ref, _] = *reference;
        let (x, y) = (pose[0] - x_ref, pose[1] - y_ref);
        let speed = velocity[0].hypot(velocity[1]) - forward_ref.hypot(left_ref);
        Self {
            distance: x.hypot(y),
            x,
            y,
            heading: (pose[2] - yaw_ref + PI).rem_euclid(TAU) - PI,
            speed,
        }
    }
}

/// One number of the errors of each record, over time.
fn errors_of(records: &Records<'_>, part: impl Fn(&Error) -> f64) -> Vec<Vec<(f64, f64)>> {
    let of = |record: &Record| {
        let ticks = record.motion();
        let with_plan = ticks.filter_map(|(tick, pose, velocity)| {
            Some((tick, Error::of(&pose, &velocity, &record.plan_at(tick)?.reference)))
        });
        with_plan.map(|(tick, error)| (record.time(tick), part(&error))).collect()
    };
    records.all().iter().map(of).collect()
}

/// Extents around the given ones, with one scale for both, and the height for `width` \[units\].
fn same_scale(x: Extent, y: Extent, width: f64) -> (Extent, Extent, f64) {
    let (least, most) = PLANE_HEIGHT;
    let height = (width * y.length() / x.length()).clamp(least, most);
    let scale = (x.length() / width).max(y.length() / height);
    let around = |extent: Extent, length: f64| {
        let middle = extent.low + 0.5 * extent.length();
        Extent { low: middle - 0.5 * length, high: middle + 0.5 * length }
    };
    (around(x, scale * width), around(y, scale * height), height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metre_has_the_same_length_on_both_axes() {
        for (x, y) in [
            ((0.0, 66.0), (-20.0, 1.0)),
            ((-2.0, 2.0), (-1.0, 1.0)),
            ((0.0, 0.1), (-50.0, 50.0)),
            ((0.0, 500.0), (0.0, 1e-3)),
        ] {
            let (given_x, given_y) =
                (Extent { low: x.0, high: x.1 }, Extent { low: y.0, high: y.1 });
            let (x, y, height) = same_scale(given_x, given_y, 304.0);
            assert!((x.length() / 304.0 - y.length() / height).abs() < 1e-9 * x.length());
            assert!((PLANE_HEIGHT.0..=PLANE_HEIGHT.1).contains(&height));
            for (extent, given) in [(x, given_x), (y, given_y)] {
                assert!(
                    extent.low <= given.low + 1e-9 && extent.high >= given.high - 1e-9,
                    "{extent:?} does not hold {given:?}"
                );
            }
        }
    }

    #[test]
    fn a_heading_error_is_wrapped() {
        let error = Error::of(&[1.0, 2.0, 3.1], &[3.0, 4.0, 0.0], &[1.0, 0.0, -3.1, 2.0, 0.0, 0.0]);
        assert!((error.heading - (6.2 - TAU)).abs() < 1e-12);
        assert_eq!((error.x, error.y, error.distance, error.speed), (0.0, 2.0, 2.0, 3.0));
    }
}
