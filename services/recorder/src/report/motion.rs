//! The paper's figures 5 and 6: velocities of the robot and its wheels.

use super::axis::{Axis, Extent};
use super::figure::{Figure, Look, Records, gap};
use super::panel::Panel;
use super::tracking::{measured, reference_key};
use protocol::message::WHEELS_MAX;
use protocol::topic::Topic;

/// Velocities along the axes of the body.
pub(super) fn velocities(records: &Records<'_>) -> Figure {
    let about =
        format!("Along the axes of the robot{}; the reference along its own.", measured(records));
    let mut figure = Figure::new("velocities", "Velocities", about);
    figure.paper = Some(5);
    for (axis, title) in ["forward [m/s]", "left [m/s]", "yaw rate [rad/s]"].into_iter().enumerate()
    {
        let mut extent = Extent::NONE;
        for record in records.all() {
            extent.include(record.motion().map(|(_, _, velocity)| velocity[axis]));
            extent.include(record.plans.iter().map(|plan| plan.reference[axis + 3]));
        }
        let mut panel =
            Panel::new(title, records.time, Axis::linear(extent.padded()), records.detail);
        for record in records.all() {
            let reference =
                record.plans.iter().map(|plan| (record.time(plan.tick), plan.reference[axis + 3]));
            panel.line("reference", gap(record), reference);
        }
        for (colour, record) in records.coloured() {
            panel.line(
                &colour,
                gap(record),
                record.motion().map(|(tick, _, velocity)| (record.time(tick), velocity[axis])),
            );
        }
        figure.panels.push(panel.finish(&format!("Velocity, {title}: {}", records.names())));
    }
    figure.legend = records.legend(Look::Line, "", |_| true);
    figure.legend.extend(reference_key(records));
    figure.missing = records.without(Topic::Plan);
    figure
}

/// Measured speeds of the wheels.
pub(super) fn wheels(records: &Records<'_>) -> Figure {
    let mut figure =
        Figure::new("wheels", "Wheel speeds", "As measured, in the order of the robot file.");
    figure.paper = Some(6);
    let all = records
        .all()
        .iter()
        .flat_map(|record| record.states.iter().flat_map(|state| state.wheel_speed));
    let extent = Extent::of(all).padded();
    let has = |wheel: usize| {
        let mut states = records.all().iter().flat_map(|record| &record.states);
        states.any(|state| state.wheel_speed[wheel].is_finite())
    };
    for wheel in (0..WHEELS_MAX).filter(|wheel| has(*wheel)) {
        let title = format!("wheel {} [rad/s]", wheel + 1);
        let mut panel = Panel::new(&title, records.time, Axis::linear(extent), records.detail);
        for (colour, record) in records.coloured() {
            panel.line(
                &colour,
                gap(record),
                record
                    .states
                    .iter()
                    .map(|state| (record.time(state.tick), state.wheel_speed[wheel])),
            );
        }
        figure.panels.push(panel.finish(&format!("Speed of {title}: {}", records.names())));
    }
    figure.legend = records.legend(Look::Line, "", |_| true);
    figure
}
