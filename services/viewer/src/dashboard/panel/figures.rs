//! The figures alone, for a terminal that has no room for panels.

use super::super::picture::fallback_level_and_reason;
use super::{Scene, duration_text, period_text};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::Paragraph;

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let mut lines = Vec::new();
    let picture = scene.picture;
    if let Some((_, error)) = picture.error.last() {
        lines.push(Line::from(format!("error {error:.3} m")));
    }
    if let Some(state) = &picture.run.state {
        let [x, y, yaw] = state.pose;
        lines.push(Line::from(fallback_level_and_reason(state.fallback_level(), state.cause())));
        lines.push(Line::from(format!("x {x:.2}  y {y:.2}  yaw {yaw:.2}")));
    }
    if let Some(plan) = &picture.plan {
        lines.push(Line::from(format!("model {}", plan.model_version)));
        lines.push(Line::from(format!(
            "tick {} of {}",
            duration_text(plan.tick_nanos),
            period_text(picture.period_nanos)
        )));
    }
    lines.push(Line::from("80×24 shows the rest"));
    frame.render_widget(Paragraph::new(lines), area);
}
