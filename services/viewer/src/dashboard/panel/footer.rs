//! The most important keys, and the last event.

use super::Scene;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

const KEYS: &str = "? help  space hold  + - f map  q quit";

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let mut line = Line::from(Span::styled(KEYS, scene.look.strong()));
    if let Some((seconds, what)) = scene.picture.events.last() {
        line.push_span(format!("   {seconds:.1} s: {what}"));
    }
    frame.render_widget(line, area);
}
