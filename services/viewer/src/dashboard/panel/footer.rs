//! The most important keys, and the last event; or the robot that is driven by keyboard.

use super::Scene;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

const KEYS: &str = "? help  space hold  + - f map  q quit";

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>, driving: Option<&str>) {
    if let Some(driving) = driving {
        frame.render_widget(Line::styled(driving, scene.look.alarm()), area);
        return;
    }
    let mut line = Line::from(Span::styled(KEYS, scene.look.strong()));
    if let Some((seconds, what)) = scene.picture.events().next_back() {
        line.push_span(format!("   {seconds:.1} s: {what}"));
    }
    frame.render_widget(line, area);
}
