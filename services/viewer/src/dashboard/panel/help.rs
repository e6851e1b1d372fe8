//! The keys, and the meaning of the panels, drawn over everything else.

use super::super::look::Look;
use super::block;
use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Clear, Paragraph};

/// Explanations that the panels themselves do not show.
const MEANING: [&str; 7] = [
    "Map: world frame, x to the right, y up.",
    "Tracking error: position against reference, scale by tens.",
    "One-step error: velocity after one period, measured minus",
    "predicted, by the main model alone and with what is learned;",
    "the figures are root mean squares of the last 5 s.",
    "Tick: from a state to its command; must be within the period.",
    "Watching only reads. Only driving (k) affects the robot.",
];

pub(super) fn draw(
    frame: &mut Frame<'_>,
    area: Rect,
    look: Look,
    keys: &[(&'static str, &'static str)],
) {
    let keys = keys.iter().map(|&(keys, what)| {
        Line::from(vec![Span::styled(format!(" {keys:<16}"), look.strong()), Span::raw(what)])
    });
    let lines: Vec<Line<'_>> = keys
        .chain([Line::default()])
        .chain(MEANING.map(|line| Line::from(format!(" {line}"))))
        .collect();
    let place = area.centered(Constraint::Max(66), Constraint::Max(lines.len() as u16 + 2));
    frame.render_widget(Clear, place);
    frame.render_widget(Paragraph::new(lines).block(block(" Help ", look)), place);
}
