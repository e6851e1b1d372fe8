//! The error of the model over one period, before and after learning.

use super::curves::{Curve, SHOWN_S, draw as draw_chart};
use super::{Scene, block};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;

/// Height of the figures.
pub(super) const SMALL_ROWS: u16 = 5;
/// An axis of the velocity, and its unit.
const AXES: [(&str, &str); 3] = [("forward", "m/s"), ("left", "m/s"), ("yaw", "rad/s")];

/// Recent averages, per axis.
pub(super) fn draw_figures(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let look = scene.look;
    let title = block(" One-step error: main → learned ", look);
    let mut lines = Vec::new();
    if let Some(errors) = scene.picture.recent_one_step() {
        for ((axis, unit), (main, whole)) in
            AXES.into_iter().zip(errors.main.into_iter().zip(errors.whole))
        {
            let (better, color) = if whole <= main {
                (ratio(main, whole), look.good())
            } else {
                ("MORE".to_owned(), look.bad())
            };
            lines.push(Line::from(vec![
                Span::raw(format!("{axis:<7} {main:.4} → ")),
                Span::styled(format!("{whole:.4}"), Style::new().fg(color)),
                Span::raw(format!(" {unit:<5} {better}")),
            ]));
        }
    }
    frame.render_widget(Paragraph::new(lines).block(title), area);
}

/// The factor of the reduction, in four characters.
fn ratio(main: f64, whole: f64) -> String {
    match main / whole {
        ratio if ratio < 10.0 => format!("÷{ratio:.1}"),
        ratio if ratio < 1000.0 => format!("÷{ratio:.0}"),
        _ => String::new(),
    }
}

/// Error of the velocity along the floor over time.
pub(super) fn draw_curves(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let look = scene.look;
    let of = |error: [f64; 3]| error[0].hypot(error[1]);
    let errors = || scene.picture.one_step.newest(SHOWN_S);
    let title = Line::from(vec![
        Span::raw(" One-step error [m/s]: "),
        Span::styled("• main model ", look.strong().fg(look.bad())),
        Span::styled("⠤ with what is learned ", look.strong()),
    ]);
    let curves = vec![
        Curve {
            color: look.bad(),
            marker: Marker::Dot,
            points: errors().map(|(at, error)| (at, of(error.main))).collect(),
        },
        Curve {
            color: Color::Reset,
            marker: Marker::Braille,
            points: errors().map(|(at, error)| (at, of(error.whole))).collect(),
        },
    ];
    draw_chart(frame, area, scene, title, curves);
}
