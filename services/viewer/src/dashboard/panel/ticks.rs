//! Tick time over time, against the deadline.

use super::curves::{Curve, SHOWN_S, draw as draw_curves};
use super::{Scene, duration_text, period_text};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let (picture, look) = (scene.picture, scene.look);
    let millis = |nanos: u64| nanos as f64 * 1e-6;
    let ticks: Vec<(f64, f64)> =
        picture.tick_nanos.newest(SHOWN_S).map(|(at, nanos)| (at, millis(nanos))).collect();
    let deadline = ticks.iter().map(|&(at, _)| (at, millis(picture.period_nanos))).collect();
    let title = format!(
        " Tick [ms]: longest {} of late, deadline • {} ",
        duration_text(picture.longest_tick_nanos()),
        period_text(picture.period_nanos)
    );
    let curves = vec![
        Curve { color: Color::Reset, marker: Marker::Braille, points: ticks },
        Curve { color: look.bad(), marker: Marker::Dot, points: deadline },
    ];
    draw_curves(frame, area, scene, title, curves);
}
