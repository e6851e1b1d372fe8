//! Figures and table → one self-contained HTML file.

use super::figure::{Figure, Key, Records};
use super::panel::escape;
use super::record::Record;
use super::table::table;
use super::{learning, motion, running, tracking};
use protocol::message::Exposure;
use std::fmt::Write;
use std::path::PathBuf;

/// Style of the page.
const STYLE: &str = include_str!("page.css");

/// Largest number of listed events per record.
const EVENTS_LISTED: usize = 100;

/// The begin of a page, to within its header: the window's `title` and the `heading`, both escaped.
pub fn head(title: &str, heading: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta name=\"color-scheme\" content=\"light dark\">\
         <title>{title}</title><style>{STYLE}</style></head><body><main>\
         <header><h1>{heading}</h1>"
    )
}

/// The whole page.
pub(super) fn page(records: &[Record]) -> String {
    let shared = Records::new(records);
    let names = escape(&shared.names());
    let mut html = head(&format!("Coxswain: {names}"), &names);
    for record in records {
        write_facts(&mut html, record);
    }
    let _ = write!(
        html,
        "</header><section id=\"summary\"><h2>Summary</h2><div class=\"scroll\">{}</div></section>",
        table(records)
    );
    let figures = [
        tracking::path(&shared),
        tracking::errors(&shared),
        motion::velocities(&shared),
        motion::wheels(&shared),
        learning::residual(&shared),
        learning::versions(&shared),
        learning::band(&shared),
        running::ticks(&shared),
        running::fallback_levels(&shared),
    ];
    for figure in figures {
        write_figure(&mut html, &figure);
    }
    for record in records {
        write_events(&mut html, record);
    }
    let _ = write!(
        html,
        "<footer>coxswain {}. \
         Paper: Wu, Tang, Xu 2023, doi 10.3390/jmse11050893, section 6.</footer>",
        env!("CARGO_PKG_VERSION")
    );
    html.push_str("</main></body></html>\n");
    html
}

/// Description of the record, and its defects.
fn write_facts(html: &mut String, record: &Record) {
    let Record { head, summary, .. } = record;
    let mut facts =
        vec![format!("{:.1} s", record.end()), format!("period {} ms", record.period_millis())];
    facts.extend(
        ["graph ", ""]
            .into_iter()
            .zip([&head.graph, &head.pace])
            .filter(|(_, word)| !word.is_empty())
            .map(|(what, word)| format!("{what}{word}")),
    );
    facts.push(if record.learned() {
        "with a learned model".to_owned()
    } else {
        "without a learned model".to_owned()
    });
    let _ = write!(
        html,
        "<p class=\"facts\"><b>{}</b>: {}. {}</p>",
        escape(&record.name),
        escape(&facts.join(", ")),
        escape(&listed(&record.files))
    );
    let mut note = |code: &str, text: &str| {
        let (name, text) = (escape(&record.name), escape(text));
        let _ = write!(html, "<p class=\"note\" data-note=\"{code}\">{name}: {text}</p>");
    };
    let can = match summary.exposure {
        Exposure::Closed => "",
        Exposure::Watched => "watch",
        Exposure::Driven => "drive",
    };
    if !can.is_empty() {
        let text = format!("INSECURE: unauthenticated peers on the network could {can} this robot");
        note("exposure", &text);
    }
    if !record.ended_early.is_empty() {
        let text = "ends early, cut off or still being written; read as far as it goes";
        note("ends-early", &format!("{text}: {}", listed(&record.ended_early)));
    }
    if summary.plant_epochs > 1 {
        let epochs = summary.plant_epochs;
        let text =
            format!("the plant was started {epochs} times: all figures are about the last start");
        note("restarted", &text);
    }
    if record.passed_over > 0 {
        let text = format!("{} messages could not be read and were skipped", record.passed_over);
        note("skipped", &text);
    }
}

fn write_figure(html: &mut String, figure: &Figure) {
    let Figure { id, title, paper, about, legend, wide, panels, missing } = figure;
    let _ = write!(
        html,
        "<figure id=\"{id}\" data-figure=\"{id}\"><h2>{}</h2><figcaption>{}",
        escape(title),
        escape(about)
    );
    if let Some(number) = paper {
        let _ = write!(html, " <i>The paper's figure {number}.</i>");
    }
    html.push_str("</figcaption>");
    for missing in missing {
        let _ = write!(html, "<p class=\"note\">{}</p>", escape(missing));
    }
    if !panels.is_empty() {
        html.push_str("<ul class=\"legend\">");
        for Key { colour, look, label } in legend {
            let _ = write!(
                html,
                "<li><span class=\"key {} {colour}\"></span>{}</li>",
                look.class(),
                escape(label)
            );
        }
        let shape = match (wide, panels.len()) {
            (true, _) | (_, 1) => " wide",
            (_, 4) => " pairs",
            _ => "",
        };
        let _ = write!(html, "</ul><div class=\"panels{shape}\">");
        for panel in panels {
            html.push_str(panel);
        }
        html.push_str("</div>");
    }
    html.push_str("</figure>");
}

/// The list of events.
fn write_events(html: &mut String, record: &Record) {
    let Record { name, events, events_more, .. } = record;
    if events.is_empty() {
        return;
    }
    let _ = write!(
        html,
        "<section class=\"events\"><h2>Events: {}</h2><div class=\"scroll\"><table><tbody>",
        escape(name)
    );
    for event in events.iter().take(EVENTS_LISTED) {
        let (from, until) = (record.time(event.tick), record.time(event.until));
        let when = if event.until > event.tick {
            format!("{from:.2} – {until:.2} s")
        } else {
            format!("{from:.2} s")
        };
        let often =
            if event.count > 1 { format!(", {} times", event.count) } else { String::new() };
        let _ = write!(html, "<tr><td>{when}</td><td>{}{often}</td></tr>", escape(&event.what));
    }
    html.push_str("</tbody></table></div>");
    let more = (events.len().saturating_sub(EVENTS_LISTED) as u64).saturating_add(*events_more);
    if more > 0 {
        let _ = write!(html, "<p class=\"note\">and {more} more</p>");
    }
    html.push_str("</section>");
}

fn listed(files: &[PathBuf]) -> String {
    files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ")
}
