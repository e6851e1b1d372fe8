//! Records → the summary table: one column per record, each cell with its exact number beside the
//! displayed one.

use super::coverage::{checks, coverage};
use super::panel::escape;
use super::record::Record;
use crate::summary::root_mean_square;
use protocol::message::FallbackLevel;
use serde_json::Value;
use std::fmt::Write;

/// Figures of `summary.json`: key, label, decimals, unit, and the text if there is none.
const FIGURES: [(&str, &str, usize, &str, &str); 20] = [
    ("arrival_s", "arrival: within 0.10 m for good", 1, "s", "never"),
    ("speed_settle_s", "speed settled: within 0.07 m/s for good", 1, "s", "never"),
    ("steady_speed_error_mps", "steady speed error, largest of the last 10 s", 3, "m/s", "–"),
    ("position_rmse_m", "position error from 3 s on, RMS", 4, "m", "–"),
    ("position_max_m", "position error from 3 s on, largest", 4, "m", "–"),
    ("heading_rmse_rad", "heading error from 3 s on, RMS", 4, "rad", "–"),
    ("tick_p50_us", "control tick, median", 0, "µs", "–"),
    ("tick_p99_us", "control tick, 99th percentile", 0, "µs", "–"),
    ("tick_max_us", "control tick, longest", 0, "µs", "–"),
    ("periods", "periods from the first command on", 0, "", "–"),
    ("periods_missed", "periods missed", 0, "", "–"),
    ("periods_slowed", "periods slowed by the gate", 0, "", "–"),
    ("fallback_levels", "periods by fallback level", 0, "", "–"),
    ("world_stalled_s", "world stood still", 3, "s", "–"),
    ("snapshots_published", "models published", 0, "", "–"),
    ("snapshots_adopted", "models adopted", 0, "", "–"),
    ("losses", "messages lost", 0, "", "–"),
    ("plant_epochs", "epochs of the plant", 0, "", "–"),
    ("controller_epochs", "epochs of the controller", 0, "", "–"),
    ("exposure", "access of unauthenticated peers on the network", 0, "", "–"),
];

/// Axes of the body.
const AXES: [&str; 3] = ["forward", "left", "yaw rate"];

/// A cell: its exact number or numbers, and the displayed text.
struct Cell {
    exact: String,
    written: String,
}

/// The table as HTML.
pub(super) fn table(records: &[Record]) -> String {
    let mut html = String::from("<table><thead><tr><th scope=\"col\"></th>");
    for record in records {
        let _ = write!(html, "<th scope=\"col\">{}</th>", escape(&record.name));
    }
    html.push_str("</tr></thead><tbody>");
    let summaries: Vec<Value> = records
        .iter()
        .map(|record| serde_json::to_value(&record.summary).unwrap_or_default())
        .collect();
    for (key, title, decimals, unit, none) in FIGURES {
        let truths = records.iter().map(|record| record.truths.is_empty());
        let cells = summaries.iter().zip(truths).map(|(summary, blind)| {
            // Without the truth it is unknown whether the robot has arrived.
            let none = if none == "never" && blind { "–" } else { none };
            figure(key, &summary[key], decimals, unit, none)
        });
        row(&mut html, key, title, cells);
    }
    let arrivals = summaries.iter().map(|summary| arrivals(&summary["arrival_by_band_s"]));
    row(&mut html, "arrival_by_band_s", "arrival by distance from the reference", arrivals);
    let motions = summaries.iter().map(|summary| {
        let of = summary["figures_of"].as_str().unwrap_or("–").to_owned();
        Cell { exact: of.clone(), written: of }
    });
    row(&mut html, "figures_of", "motion in these figures", motions);
    let stops = summaries.iter().map(|summary| stops(&summary["stops"]));
    row(&mut html, "stops", "stops of the gate", stops);
    learning_rows(&mut html, records);
    html.push_str("</tbody></table>");
    html
}

/// Time of arrival within each distance.
fn arrivals(value: &Value) -> Cell {
    let arrivals: Vec<String> = value
        .as_object()
        .into_iter()
        .flatten()
        .map(|(band, at)| match at.as_f64() {
            Some(at) => format!("{band} m: {at:.1} s"),
            None => format!("{band} m: –"),
        })
        .collect();
    Cell { exact: value.to_string(), written: arrivals.join(", ") }
}

/// Time and reason of each stop of the gate.
fn stops(value: &Value) -> Cell {
    let stops: Vec<String> = value
        .as_array()
        .into_iter()
        .flatten()
        .map(|stop| {
            let at = stop["at_s"].as_f64().unwrap_or(f64::NAN);
            format!("{} at {at:.1} s", stop["reason"].as_str().unwrap_or("?"))
        })
        .collect();
    let written = if stops.is_empty() { "none".to_owned() } else { stops.join(", ") };
    Cell { exact: value.to_string(), written }
}

/// Figures of learning, per axis.
fn learning_rows(html: &mut String, records: &[Record]) {
    let rows = [
        ("residual_rms", "one-step error of the main model, RMS"),
        ("innovation_rms", "one-step error of the whole model, RMS"),
    ];
    for (axis, name) in AXES.into_iter().enumerate() {
        let unit = if axis == 2 { "rad/s" } else { "m/s" };
        for (index, (key, title)) in rows.into_iter().enumerate() {
            let cells = records.iter().map(|record| {
                let errors = record.plans.iter().map(|plan| {
                    if index == 0 { plan.residual[axis] } else { plan.innovation[axis] }
                });
                number(root_mean_square(errors.filter(|error| error.is_finite())), 4, unit, "–")
            });
            row(html, &format!("{key}_{axis}"), &format!("{title}, {name}"), cells);
        }
    }
    for (axis, name) in AXES.into_iter().enumerate() {
        let cells = records.iter().map(|record| match coverage(&checks(record, axis)) {
            Some(found) => Cell {
                exact: found.share.to_string(),
                written: format!(
                    "{:.1} % of {}{}",
                    100.0 * found.share,
                    found.periods,
                    if record.sample_variance.is_empty() {
                        ", without the noise of samples"
                    } else {
                        ""
                    }
                ),
            },
            None => Cell { exact: String::new(), written: "–".to_owned() },
        });
        row(
            html,
            &format!("coverage_{axis}"),
            &format!("residual within the learned ±1.96 σ, {name}"),
            cells,
        );
    }
}

fn row(html: &mut String, key: &str, title: &str, cells: impl Iterator<Item = Cell>) {
    let _ = write!(html, "<tr data-key=\"{key}\"><th scope=\"row\">{}</th>", escape(title));
    for Cell { exact, written } in cells {
        let _ = write!(html, "<td data-value=\"{}\">{}</td>", escape(&exact), escape(&written));
    }
    html.push_str("</tr>");
}

/// One figure of a summary.
fn figure(key: &str, value: &Value, decimals: usize, unit: &str, none: &str) -> Cell {
    match key {
        "fallback_levels" => {
            let on = |fallback_level: &FallbackLevel| {
                (fallback_level.text(), value[fallback_level.text()].as_u64().unwrap_or(0))
            };
            let list = listed(FallbackLevel::ALL.iter().map(on));
            Cell { exact: value.to_string(), written: list }
        }
        "losses" => {
            let readers = |readers: &Value| {
                readers
                    .as_object()
                    .into_iter()
                    .flatten()
                    .filter_map(|(_, lost)| lost.as_u64())
                    .fold(0, u64::saturating_add)
            };
            let topics = value
                .as_object()
                .into_iter()
                .flatten()
                .map(|(topic, lost)| (topic.as_str(), readers(lost)));
            Cell { exact: value.to_string(), written: listed(topics) }
        }
        "exposure" => {
            let word = value.as_str().unwrap_or_default();
            Cell { exact: word.to_owned(), written: word.to_owned() }
        }
        _ if value.is_u64() => Cell { exact: value.to_string(), written: value.to_string() },
        _ => number(value.as_f64(), decimals, unit, none),
    }
}

fn number(value: Option<f64>, decimals: usize, unit: &str, none: &str) -> Cell {
    match value {
        Some(value) => Cell {
            exact: Value::from(value).to_string(),
            written: format!("{value:.decimals$} {unit}"),
        },
        None => Cell { exact: String::new(), written: none.to_owned() },
    }
}

/// The counts that are not 0, each with its name.
fn listed<'a>(counts: impl Iterator<Item = (&'a str, u64)>) -> String {
    let counted: Vec<String> = counts
        .filter(|(_, count)| *count > 0)
        .map(|(name, count)| format!("{name} {count}"))
        .collect();
    if counted.is_empty() { "none".to_owned() } else { counted.join(", ") }
}
