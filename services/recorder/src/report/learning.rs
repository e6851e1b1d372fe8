//! Figures of learning: the residual before and after, the models over time, and the coverage of
//! their intervals.

use super::axis::{Axis, Extent};
use super::coverage::{Check, SPREAD, checks};
use super::figure::{Figure, Key, Look, Records, gap};
use super::panel::Panel;
use super::record::Record;
use protocol::topic::Topic;

/// Axes of the body.
const AXES: [&str; 3] = ["forward [m/s]", "left [m/s]", "yaw rate [rad/s]"];

/// One-step errors of the main model alone, and of the whole model.
pub(super) fn residual(records: &Records<'_>) -> Figure {
    let about = "Velocity at the end of each period minus the prediction at its start: \
                 by the main model alone (the residual, faint), and by the whole model in use, \
                 with learning and observer.";
    let mut figure = Figure::new("residual", "Residual before and after learning", about);
    figure.missing = records.without(Topic::Plan);
    for (axis, title) in AXES.into_iter().enumerate() {
        let all = records.all().iter().flat_map(|record| {
            record.plans.iter().flat_map(|plan| [plan.residual[axis], plan.innovation[axis]])
        });
        let mut panel =
            Panel::new(title, records.time, Axis::linear(Extent::of(all).padded()), records.detail);
        panel.level(0.0, "");
        for (colour, record) in records.coloured() {
            let before =
                record.plans.iter().map(|plan| (record.time(plan.tick), plan.residual[axis]));
            panel.line(&format!("faint {colour}"), gap(record), before);
        }
        for (colour, record) in records.coloured() {
            let after =
                record.plans.iter().map(|plan| (record.time(plan.tick), plan.innovation[axis]));
            panel.line(&colour, gap(record), after);
        }
        figure.panels.push(panel.finish(&format!("One-step error, {title}: {}", records.names())));
    }
    let drawn = |record: &Record| !record.plans.is_empty();
    figure.legend = records.legend(Look::Faint, ": main model alone", drawn);
    figure.legend.extend(records.legend(Look::Line, ": whole model", drawn));
    figure
}

/// The model in use, and the last published one.
pub(super) fn versions(records: &Records<'_>) -> Figure {
    let about = "Version of the learned model in the controller (0: the main model alone), \
                 and of the last one published by the learner (dashed).";
    let mut figure = Figure::new("versions", "Models over time", about);
    figure.missing = records.without(Topic::Plan);
    let (mut used, mut published) = (Vec::new(), Vec::new());
    for record in records.all() {
        used.push(stairs(record, record.plans.iter().map(|plan| (plan.tick, plan.version))));
        published.push(stairs(
            record,
            record.published.iter().map(|published| (published.tick, published.version)),
        ));
    }
    let mut extent =
        Extent::of(used.iter().chain(&published).flatten().map(|&(_, version)| version));
    extent.include([0.0, 1.0]);
    let mut panel =
        Panel::new("version", records.time, Axis::linear(extent.padded()), records.detail);
    for ((colour, _), line) in records.coloured().zip(&published) {
        panel.line(&format!("dashed {colour}"), f64::INFINITY, line.iter().copied());
    }
    for ((colour, _), line) in records.coloured().zip(&used) {
        panel.line(&colour, f64::INFINITY, line.iter().copied());
    }
    figure.panels.push(panel.finish(&format!("Version of the model in use: {}", records.names())));
    figure.legend = records.legend(Look::Line, ": in use", |record| !record.plans.is_empty());
    figure
        .legend
        .extend(records.legend(Look::Dashed, ": published", |record| !record.published.is_empty()));
    figure
}

/// Errors of the learned models against the spread that they gave for them.
pub(super) fn band(records: &Records<'_>) -> Figure {
    let about = format!(
        "Residual minus the mean of the learned model, and the model's ±{SPREAD} σ from before the \
         period; dots where the residual lay outside. Periods are left out if the learned model \
         was not in use on an axis, or was replaced. The table has the share inside."
    );
    let mut figure = Figure::new("band", "Variance band and its coverage", about);
    figure.missing = records.without(Topic::Plan);
    for record in records.all().iter().filter(|record| !record.plans.is_empty()) {
        if !record.learned() {
            figure.missing.push(format!("{}: no learned model was in use", record.name));
        } else if record.usable.is_empty() {
            figure.missing.push(format!(
                "{}: topic \"residual\" is not in this record, or no period of it is usable",
                record.name
            ));
        } else if record.sample_variance.is_empty() {
            figure.missing.push(format!(
                "{}: this record has no noise of samples: σ is that of the function alone",
                record.name
            ));
        }
    }
    let by_axis: [Vec<Vec<Check>>; 3] =
        [0, 1, 2].map(|axis| records.all().iter().map(|record| checks(record, axis)).collect());
    if by_axis.iter().flatten().all(Vec::is_empty) {
        return figure;
    }
    for (title, by_record) in AXES.into_iter().zip(&by_axis) {
        // The first models may know almost nothing; their intervals are cut off.
        let largest = by_record.iter().flatten().map(|check| check.error.abs()).fold(0.0, f64::max);
        let usual = by_record
            .iter()
            .filter_map(|checks| median(checks))
            .map(|deviation| 2.0 * SPREAD * deviation)
            .fold(0.0, f64::max);
        let reach = Extent::of([0.0, 1.1 * largest.max(usual)]).padded().high;
        let mut panel = Panel::new(
            title,
            records.time,
            Axis::linear(Extent { low: -reach, high: reach }),
            records.detail,
        );
        panel.level(0.0, "");
        for ((colour, record), checks) in records.coloured().zip(by_record) {
            // Where one model replaces another, one period is left out: the band continues.
            let gap = 2.0 * gap(record);
            panel.band(
                &colour,
                gap,
                checks.iter().map(|check| (record.time(check.tick), SPREAD * check.deviation)),
            );
            panel.line(
                &format!("thin {colour}"),
                gap,
                checks.iter().map(|check| (record.time(check.tick), check.error)),
            );
        }
        for ((_, record), checks) in records.coloured().zip(by_record) {
            let outside = checks.iter().filter(|check| !check.is_within());
            panel.dots("outside", outside.map(|check| (record.time(check.tick), check.error)));
        }
        figure.panels.push(panel.finish(&format!(
            "Error of the learned model and its band, {title}: {}",
            records.names()
        )));
    }
    let drawn = |record: &Record| record.learned() && !record.usable.is_empty();
    figure.legend = records.legend(Look::Band, &format!(": ±{SPREAD} σ"), drawn);
    figure.legend.extend(records.legend(Look::Line, ": error", drawn));
    figure.legend.push(Key {
        colour: "outside".to_owned(),
        look: Look::Dot,
        label: "outside".to_owned(),
    });
    figure
}

/// A staircase line: each number holds until the next one, and the last one to the end of the
/// record.
fn stairs(record: &Record, numbers: impl Iterator<Item = (u64, u64)>) -> Vec<(f64, f64)> {
    let mut line: Vec<(f64, f64)> = Vec::new();
    for (tick, number) in numbers {
        let (time, number) = (record.time(tick), number as f64);
        match line.last() {
            Some(&(_, before)) if before == number => {}
            Some(&(_, before)) => line.extend([(time, before), (time, number)]),
            None => line.push((time, number)),
        }
    }
    let last = line.last().map(|&(_, number)| (record.end(), number));
    line.extend(last);
    line
}

fn median(checks: &[Check]) -> Option<f64> {
    let mut deviations: Vec<f64> = checks.iter().map(|check| check.deviation).collect();
    deviations.sort_by(f64::total_cmp);
    deviations.get(deviations.len() / 2).copied()
}
