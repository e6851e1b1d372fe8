//! The picture → cells. One module per panel; the panels have no state.
//!
//! | terminal    | what is shown                                                             |
//! |-------------|---------------------------------------------------------------------------|
//! | from 120×48 | everything, with the curves of errors and ticks and the events            |
//! | from 80×24  | map and tracking error; controller, one-step errors, processes and losses |
//! | smaller     | the figures, as many as there is room for                                 |

mod controller;
mod curves;
mod events;
mod figures;
mod footer;
mod header;
mod help;
mod losses;
mod map;
mod one_step;
mod processes;
mod ticks;
mod tracking;

use super::look::Look;
use super::picture::{Contact, Picture};
use super::view::View;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::Line;
use ratatui::widgets::Block;
use std::time::Instant;

/// The input of every panel.
#[derive(Debug, Clone, Copy)]
struct Scene<'a> {
    picture: &'a Picture,
    look: Look,
    /// The time that is shown.
    now: Instant,
}

/// Draws what is to be shown at `now`.
pub fn draw(frame: &mut Frame<'_>, view: &View, look: Look, now: Instant) {
    let [top, body, bottom] =
        Layout::vertical([Constraint::Length(1), Constraint::Fill(1), Constraint::Length(1)])
            .areas(frame.area());
    let (picture, shown_at) = view.shown(now);
    let scene = Scene { picture, look, now: shown_at };
    match (frame.area().width, frame.area().height) {
        (120.., 48..) => draw_large(frame, body, scene, view),
        (80.., 24..) => draw_small(frame, body, scene, view),
        _ => figures::draw(frame, body, scene),
    }
    let contact = view.contact(now);
    if matches!(contact, Contact::Lost(_)) {
        look.grey_out(body, frame.buffer_mut());
    }
    header::draw(frame, top, scene, contact, view.is_held());
    footer::draw(frame, bottom, scene, view.driving());
    if view.shows_help() {
        help::draw(frame, body, look, view.keys());
    }
}

fn draw_small(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>, view: &View) {
    let [left, right] =
        Layout::horizontal([Constraint::Fill(1), Constraint::Length(36)]).areas(area);
    let [map, tracking] = Layout::vertical([Constraint::Fill(3), Constraint::Fill(2)]).areas(left);
    map::draw(frame, map, scene, view.map());
    tracking::draw(frame, tracking, scene);
    let heights = [controller::SMALL_ROWS, one_step::SMALL_ROWS, processes::SMALL_ROWS]
        .map(Constraint::Length);
    let [controller, one_step, processes, losses] =
        Layout::vertical([heights[0], heights[1], heights[2], Constraint::Fill(1)]).areas(right);
    controller::draw(frame, controller, scene);
    one_step::draw_figures(frame, one_step, scene);
    processes::draw_small(frame, processes, scene);
    losses::draw(frame, losses, scene);
}

fn draw_large(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>, view: &View) {
    let [left, right] = Layout::horizontal([Constraint::Fill(3), Constraint::Fill(2)]).areas(area);
    let [map, tracking, one_step] =
        Layout::vertical([Constraint::Fill(3), Constraint::Fill(1), Constraint::Fill(1)])
            .areas(left);
    map::draw(frame, map, scene, view.map());
    tracking::draw(frame, tracking, scene);
    one_step::draw_curves(frame, one_step, scene);
    let [controller, ticks, figures, processes, losses, events] = Layout::vertical([
        Constraint::Length(controller::SMALL_ROWS),
        Constraint::Fill(1),
        Constraint::Length(one_step::SMALL_ROWS),
        Constraint::Length(processes::LARGE_ROWS),
        Constraint::Length(losses::LARGE_ROWS),
        Constraint::Fill(1),
    ])
    .areas(right);
    controller::draw(frame, controller, scene);
    ticks::draw(frame, ticks, scene);
    one_step::draw_figures(frame, figures, scene);
    processes::draw_large(frame, processes, scene);
    losses::draw(frame, losses, scene);
    events::draw(frame, events, scene);
}

/// The frame of a panel.
fn block<'a>(title: impl Into<Line<'a>>, look: Look) -> Block<'a> {
    Block::bordered().title(title).title_style(look.strong())
}

/// A short time, in a suitable unit.
fn duration_text(nanos: u64) -> String {
    match nanos as f64 * 1e-9 {
        seconds if seconds < 1e-3 => format!("{:.0} µs", seconds * 1e6),
        seconds if seconds < 1.0 => format!("{:.1} ms", seconds * 1e3),
        seconds => format!("{seconds:.1} s"),
    }
}

/// The control period, without unnecessary decimals.
fn period_text(nanos: u64) -> String {
    format!("{} ms", nanos as f64 * 1e-6)
}

#[cfg(test)]
mod tests;
