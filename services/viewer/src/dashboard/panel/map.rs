//! The present, past, reference and predicted positions of the robot, its goal, and obstacles.

use super::super::picture::Picture;
use super::super::view::MapWindow;
use super::{Scene, block};
use protocol::message::OBSTACLE_NUMBERS;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Context, Line as Stroke, Points};
use std::f64::consts::FRAC_PI_4;

/// Dots of a cell in braille.
const DOTS: [f64; 2] = [2.0, 4.0];
/// Length of the heading on the map \[dots\].
const HEADING_DOTS: f64 = 8.0;
/// Signs for the heading, from the x axis on, counter-clockwise.
const ARROWS: [&str; 8] = ["→", "↗", "↑", "↖", "←", "↙", "↓", "↘"];
/// Smallest width of the map of the whole path \[m\].
const ACROSS_MIN_M: f64 = 1.0;
/// Smallest width of a map that has room for the legend of obstacles \[cells\].
const OBSTACLE_LEGEND_WIDTH: u16 = 56;
/// Margin around the whole path, as a factor.
const MARGIN: f64 = 1.1;

/// A part of the world, in which a metre is as long in x as in y.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extent {
    centre: [f64; 2],
    across_m: f64,
    /// One dot \[m\].
    dot_m: f64,
    /// Half of the shown width and height \[m\].
    half: [f64; 2],
}

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>, window: MapWindow) {
    let inner = block("", scene.look).inner(area);
    let extent =
        Extent::of(scene.picture, window, [f64::from(inner.width), f64::from(inner.height)]);
    let across = if extent.across_m < 3.0 {
        format!("{:.1}", extent.across_m)
    } else {
        format!("{:.0}", extent.across_m)
    };
    let title = match window {
        MapWindow::Follow { .. } => format!(" Map: robot in the middle, {across} m across "),
        MapWindow::Whole => format!(" Map: whole path, {across} m across "),
    };
    let look = scene.look;
    let mut legend = vec![
        Span::raw(" ⠤ driven "),
        Span::styled("· reference ", look.reference()),
        Span::styled("o predicted ", look.good()),
    ];
    if scene.picture.run.target().is_some() {
        legend.push(Span::styled("x goal ", look.strong()));
    }
    if !scene.picture.run.obstacles.is_empty() && area.width >= OBSTACLE_LEGEND_WIDTH {
        legend.push(Span::styled("⠶ obstacle ", look.obstacle()));
    }
    let [x, y] = [0, 1].map(|axis| {
        [extent.centre[axis] - extent.half[axis], extent.centre[axis] + extent.half[axis]]
    });
    let canvas = Canvas::default()
        .block(block(title, look).title_bottom(Line::from(legend)))
        .marker(Marker::Braille)
        .x_bounds(x)
        .y_bounds(y)
        .paint(|context| paint(context, scene, extent));
    frame.render_widget(canvas, area);
}

fn paint(context: &mut Context<'_>, scene: Scene<'_>, extent: Extent) {
    let (picture, look) = (scene.picture, scene.look);
    for seen in picture.run.obstacles.values() {
        for numbers in seen.list.rows().iter().filter(|numbers| is_finite(numbers.as_slice())) {
            paint_obstacle(context, numbers, look.obstacle());
        }
    }
    let reference: Vec<(f64, f64)> = picture.reference.all().map(|(_, [x, y])| (x, y)).collect();
    context.draw(&Points { coords: &reference, color: look.reference() });
    context.layer();
    let driven: Vec<[f64; 2]> = picture.path.all().map(|(_, place)| place).collect();
    for pair in driven.windows(2) {
        if let [from, to] = pair {
            context.draw(&stroke(*from, *to, Color::Reset));
        }
    }
    context.layer();
    // A sign is drawn in the nearest cell; without this offset it would be in the one above or to
    // the left.
    let [right, down] = DOTS.map(|dots| dots * extent.dot_m / 2.0);
    if let Some(plan) = &picture.plan {
        let rows = plan.horizon as usize + 1;
        for row in plan.reference.iter().take(rows).filter(|row| is_finite(row.as_slice())) {
            context.print(
                row[0] + right,
                row[1] - down,
                Span::styled("·", look.strong().fg(look.reference())),
            );
        }
        for row in plan.predicted.iter().take(rows).skip(1).filter(|row| is_finite(row.as_slice()))
        {
            context.print(
                row[0] + right,
                row[1] - down,
                Span::styled("o", look.strong().fg(look.good())),
            );
        }
    }
    if let Some([x, y]) = picture.run.target() {
        context.print(x + right, y - down, Span::styled("x", look.strong()));
    }
    if let Some(state) = picture.run.state.as_ref().filter(|state| is_finite(&state.pose)) {
        let [x, y, yaw] = state.pose;
        let ahead = HEADING_DOTS * extent.dot_m;
        context.draw(&stroke([x, y], [x + ahead * yaw.cos(), y + ahead * yaw.sin()], Color::Reset));
        context.print(x + right, y - down, Span::styled(arrow(yaw), look.strong()));
    }
}

/// The outline of an obstacle: the circles around its corners, and the lines between these.
fn paint_obstacle(context: &mut Context<'_>, numbers: &[f64; OBSTACLE_NUMBERS], color: Color) {
    let [_, _, radius, ref corners @ ..] = *numbers;
    let mut corners: Vec<[f64; 2]> = corners.as_chunks().0.to_vec();
    // Unused corners repeat the last one.
    corners.dedup();
    for (index, &corner) in corners.iter().enumerate() {
        let [x, y] = corner;
        context.draw(&Circle { x, y, radius, color });
        context.draw(&stroke(corner, corners[(index + 1) % corners.len()], color));
    }
}

impl Extent {
    /// The extent for a map of this many cells.
    fn of(picture: &Picture, window: MapWindow, cells: [f64; 2]) -> Self {
        let dots = [cells[0].max(1.0) * DOTS[0], cells[1].max(1.0) * DOTS[1]];
        let robot = picture.path.last().map_or([0.0; 2], |(_, place)| place);
        let (centre, across_m) = match window {
            MapWindow::Follow { across_m } => (robot, across_m),
            MapWindow::Whole => {
                let places =
                    picture.path.all().chain(picture.reference.all()).map(|(_, place)| place);
                let places = places.chain(picture.run.target());
                let (low, high) = places.fold((robot, robot), |(low, high), place| {
                    (
                        [low[0].min(place[0]), low[1].min(place[1])],
                        [high[0].max(place[0]), high[1].max(place[1])],
                    )
                });
                let across = (high[0] - low[0]).max((high[1] - low[1]) * dots[0] / dots[1]);
                (
                    [f64::midpoint(low[0], high[0]), f64::midpoint(low[1], high[1])],
                    (across * MARGIN).max(ACROSS_MIN_M),
                )
            }
        };
        let dot_m = across_m / dots[0];
        Self { centre, across_m, dot_m, half: [across_m / 2.0, dot_m * dots[1] / 2.0] }
    }
}

fn is_finite(numbers: &[f64]) -> bool {
    numbers.iter().all(|number| number.is_finite())
}

fn stroke(from: [f64; 2], to: [f64; 2], color: Color) -> Stroke {
    Stroke { x1: from[0], y1: from[1], x2: to[0], y2: to[1], color }
}

/// The sign that is nearest to a heading \[rad\].
fn arrow(yaw: f64) -> &'static str {
    let eighth = (yaw / FRAC_PI_4).round().rem_euclid(8.0) as usize;
    ARROWS.get(eighth).copied().unwrap_or("→")
}

#[cfg(test)]
mod tests {
    use super::super::super::specimen;
    use super::*;
    use std::f64::consts::PI;
    use std::time::Instant;

    #[test]
    fn the_arrow_points_where_the_robot_does() {
        for (yaw, sign) in [
            (0.0, "→"),
            (0.3, "→"),
            (PI / 2.0, "↑"),
            (-PI / 2.0, "↓"),
            (PI, "←"),
            (-3.0 * PI, "←"),
            (20.0 * PI + 0.8, "↗"),
        ] {
            assert_eq!(arrow(yaw), sign, "{yaw}");
        }
    }

    #[test]
    fn the_whole_path_is_on_the_map_and_a_metre_is_a_metre_in_both_directions() {
        let picture = specimen::picture(Instant::now());
        for cells in [[42.0, 11.0], [118.0, 34.0], [10.0, 40.0]] {
            let extent = Extent::of(&picture, MapWindow::Whole, cells);
            for (_, place) in picture.path.all() {
                for axis in 0..2 {
                    assert!(
                        (place[axis] - extent.centre[axis]).abs() <= extent.half[axis],
                        "{place:?} {extent:?}"
                    );
                }
            }
            let [x, y] =
                [2.0 * extent.half[0] / (2.0 * cells[0]), 2.0 * extent.half[1] / (4.0 * cells[1])];
            assert!((x - y).abs() < 1e-12, "{extent:?}");
        }
    }
}
