//! The events, the newest at the bottom.

use super::{Scene, block};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::Paragraph;

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let block = block(" Events ", scene.look);
    let newest = scene.picture.events().rev().take(usize::from(block.inner(area).height));
    let lines = newest.map(|(seconds, what)| Line::from(format!("{seconds:7.1} s  {what}")));
    let mut lines: Vec<Line<'_>> = lines.collect();
    lines.reverse();
    frame.render_widget(Paragraph::new(lines).block(block), area);
}
