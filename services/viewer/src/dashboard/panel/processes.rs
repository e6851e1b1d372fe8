//! The status of each process: its phase, the time since its last message, and its last fault.

use super::{Scene, block};
use protocol::message::{Participant, Phase};
use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Row, Table};
use run_view::Process;

/// Height with one row per process.
pub(super) const SMALL_ROWS: u16 = 7;
/// Height with a heading as well.
pub(super) const LARGE_ROWS: u16 = 8;
/// A greater epoch is no count of starts.
const STARTS_MOST: u64 = 99_999;

pub(super) fn draw_small(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let lines: Vec<Line<'_>> = Participant::ALL
        .iter()
        .map(|who| {
            let Some(process) = scene.picture.run.processes.get(who) else {
                return Line::from(format!("{who:<10} no message"));
            };
            let (silent, style) = silence(scene, process);
            Line::from(vec![
                Span::raw(format!("{who:<10} ")),
                phase(scene, process),
                Span::styled(format!(" {silent:>8}"), style),
                Span::raw(
                    starts(process)
                        .filter(|&starts| starts > 1)
                        .map_or_else(String::new, |starts| format!("  #{starts}")),
                ),
            ])
        })
        .collect();
    frame.render_widget(
        Paragraph::new(lines).block(block(" Processes: phase, silent since ", scene.look)),
        area,
    );
}

pub(super) fn draw_large(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let rows = Participant::ALL.iter().map(|who| {
        let Some(process) = scene.picture.run.processes.get(who) else {
            return Row::new([who.to_string(), "no message".to_owned()]);
        };
        let (silent, style) = silence(scene, process);
        let health = &process.health;
        Row::new([
            Line::from(who.text()),
            Line::from(phase(scene, process)),
            Line::styled(silent, style).right_aligned(),
            Line::from(starts(process).map_or_else(|| "–".to_owned(), |starts| starts.to_string()))
                .right_aligned(),
            Line::from(health.pid.to_string()).right_aligned(),
            Line::from(health.deadlines_missed.to_string()).right_aligned(),
            Line::styled(health.last_error().to_owned(), scene.look.alarm()),
        ])
    });
    let widths =
        [10, 8, 8, 5, 8, 6].map(Constraint::Length).into_iter().chain([Constraint::Fill(1)]);
    let heading =
        Row::new(["process", "phase", "  silent", "epoch", "     pid", "missed", "last error"]);
    let table = Table::new(rows, widths).header(heading).block(block(" Processes ", scene.look));
    frame.render_widget(table, area);
}

/// The number of starts: the epoch, unless the first epoch came from the time of day.
fn starts(process: &Process) -> Option<u64> {
    Some(process.health.stamp.epoch).filter(|&epoch| epoch <= STARTS_MOST)
}

fn phase(scene: Scene<'_>, process: &Process) -> Span<'static> {
    let phase = process.health.phase();
    let style = if phase == Phase::Degraded {
        scene.look.alarm()
    } else {
        Style::new().fg(scene.look.good())
    };
    Span::styled(format!("{phase:<8}"), style)
}

/// The time since its last message, and its style.
fn silence(scene: Scene<'_>, process: &Process) -> (String, Style) {
    let silent = scene.now.saturating_duration_since(process.received);
    let style = if process.is_silent(scene.now) { scene.look.alarm() } else { Style::new() };
    (format!("{:.1} s", silent.as_secs_f64()), style)
}
