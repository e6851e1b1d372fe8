//! Distance from the reference over time.

use super::curves::{Curve, SHOWN_S, draw as draw_curves};
use super::{Scene, block};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let Some((_, now)) = scene.picture.error.last() else {
        frame.render_widget(block(" Tracking error ", scene.look), area);
        return;
    };
    let curve = Curve {
        color: Color::Reset,
        marker: Marker::Braille,
        points: scene.picture.error.newest(SHOWN_S).collect(),
    };
    draw_curves(frame, area, scene, format!(" Tracking error {now:.3} m "), vec![curve]);
}
