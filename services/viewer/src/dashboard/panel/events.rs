//! The events, the newest at the bottom.

use super::{Scene, block};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::Paragraph;

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let block = block(" Events ", scene.look);
    let events = &scene.picture.events;
    let first = events.len().saturating_sub(usize::from(block.inner(area).height));
    let lines = events
        .iter()
        .skip(first)
        .map(|(seconds, what)| Line::from(format!("{seconds:7.1} s  {what}")));
    frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()).block(block), area);
}
