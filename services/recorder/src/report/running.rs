//! How the run went: tick times against the deadline, fallback levels and faults.

use super::axis::{Axis, Extent};
use super::figure::{Figure, Key, Look, Records, gap};
use super::panel::Panel;
use super::record::Record;
use protocol::message::FallbackLevel;
use protocol::topic::Topic;

/// Height of one record's bars in a lane, and of an empty lane \[units\].
const BAR: f64 = 7.0;
const LANE: f64 = 10.0;

/// Duration of each tick.
pub(super) fn ticks(records: &Records<'_>) -> Figure {
    let about = "From the receipt of the state to the finished command. \
                 The deadline is the period in which the command acts.";
    let mut figure = Figure::new("ticks", "Tick times against the deadline", about);
    figure.missing = records.without(Topic::Plan);
    let millis = |record: &Record| {
        record.plans.iter().map(|plan| plan.tick_nanos as f64 * 1e-6).collect::<Vec<_>>()
    };
    let lines: Vec<Vec<f64>> = records.all().iter().map(millis).collect();
    let mut extent = Extent::of(lines.iter().flatten().copied().filter(|&millis| millis > 0.0));
    if extent.low > extent.high {
        return figure;
    }
    let mut deadlines: Vec<f64> = records.all().iter().map(Record::period_millis).collect();
    deadlines.sort_by(f64::total_cmp);
    deadlines.dedup();
    extent.include(deadlines.iter().map(|deadline| 1.5 * deadline));
    let mut panel = Panel::new(
        "tick [ms], logarithmic",
        records.time,
        Axis::logarithmic(extent),
        records.detail,
    );
    for deadline in deadlines {
        panel.level(deadline, &format!("deadline {deadline} ms"));
    }
    for ((colour, record), line) in records.coloured().zip(&lines) {
        panel.line(
            &colour,
            gap(record),
            record.plans.iter().map(|plan| record.time(plan.tick)).zip(line.iter().copied()),
        );
    }
    figure.panels.push(panel.finish(&format!("Tick times: {}", records.names())));
    figure.legend = records.legend(Look::Line, "", |record| !record.plans.is_empty());
    figure
}

/// What acted on the wheels, and when something happened.
pub(super) fn fallback_levels(records: &Records<'_>) -> Figure {
    let about = "Source of the input of each period, the best first. \
                 Other events are marked, and listed below.";
    let mut figure = Figure::new("fallback_levels", "Fallback levels and faults", about);
    let seen = |fallback_level: FallbackLevel| {
        records
            .all()
            .iter()
            .any(|record| record.states.iter().any(|state| state.fallback_level == fallback_level))
    };
    let lanes: Vec<FallbackLevel> = FallbackLevel::ALL
        .iter()
        .copied()
        .filter(|&fallback_level| {
            fallback_level == FallbackLevel::FreshPlan || seen(fallback_level)
        })
        .collect();
    let mut names: Vec<String> =
        lanes.iter().map(|fallback_level| fallback_level.text().to_owned()).collect();
    let eventful = records.all().iter().any(|record| !record.events.is_empty());
    if eventful {
        names.push("events".to_owned());
    }
    let count = records.all().len();
    let height = names.len() as f64 * (LANE + BAR * count as f64);
    let whole = Axis::linear(Extent { low: 0.0, high: 1.0 });
    let mut panel =
        Panel::new("fallback_level", records.time, whole, records.detail).laned(names, height);
    for (index, (colour, record)) in records.coloured().enumerate() {
        // A state tells of the period that is over.
        let stretch = |tick: u64| (record.time(tick.saturating_sub(1)), record.time(tick));
        for (lane, &fallback_level) in lanes.iter().enumerate() {
            let stretches = record
                .states
                .iter()
                .filter(|state| state.fallback_level == fallback_level)
                .map(|state| stretch(state.tick));
            panel.bars(&colour, lane, (index, count), stretches);
        }
        let happened =
            record.events.iter().map(|event| (record.time(event.tick), record.time(event.until)));
        panel.bars(&format!("event {colour}"), lanes.len(), (index, count), happened);
    }
    figure.panels.push(panel.finish(&format!("Fallback levels and events: {}", records.names())));
    figure.legend = records.legend(Look::Band, "", |_| true);
    figure.legend.iter_mut().for_each(|Key { colour, .. }| colour.push_str(" full"));
    figure
}
