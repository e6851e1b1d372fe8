//! Axes, lines, bands and marks → one SVG.
//!
//! Text has the units of the panel, lines have tenths of them. Lines are in an inner SVG that clips
//! them at the axes. Colours and widths come from the page's style sheet.

use super::axis::Axis;
use super::thin::{self, Columns, Place};
use std::fmt::Write;

/// Width of every panel \[units\]: that of a mobile phone.
pub const WIDTH: f64 = 360.0;

/// Margins around the axes \[units\].
const LEFT: f64 = 48.0;
const RIGHT: f64 = 8.0;
const TOP: f64 = 20.0;
const BOTTOM: f64 = 30.0;

/// Margin for the names of lanes \[units\].
const LEFT_OF_LANES: f64 = 78.0;

/// Largest width of a digit \[units\].
const DIGIT: f64 = 6.6;

/// Default height of the axes \[units\].
pub const HEIGHT: f64 = 130.0;

/// Largest number of points of a path in the plane.
const PATH_POINTS_MAX: usize = 12_000;

/// Escapes all characters with a meaning in HTML.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            '\t' | '\n' => escaped.push(' '),
            control if control.is_control() => escaped.push('\u{fffd}'),
            other => escaped.push(other),
        }
    }
    escaped
}

/// Resolution of lines.
#[derive(Debug, Clone, Copy)]
pub struct Detail {
    /// Width of a column, which keeps its first, last, highest and lowest point \[tenths\].
    pub column: i32,
    /// Largest number of points of one path in the plane.
    pub path_points: usize,
}

impl Detail {
    /// Resolution for `count` records together, so that the size of the page stays the same.
    pub fn for_records(count: usize) -> Self {
        let share = count.div_ceil(4).max(1);
        Self {
            column: 10 * i32::try_from(share).unwrap_or(i32::MAX / 10),
            path_points: (PATH_POINTS_MAX / share).max(2),
        }
    }
}

/// One pair of axes with its drawing.
#[derive(Debug)]
pub struct Panel {
    title: String,
    x: Axis,
    y: Axis,
    x_label: &'static str,
    left: f64,
    height: f64,
    detail: Detail,
    /// Names of lanes in place of ticks, from the top.
    lanes: Vec<String>,
    inner: String,
    outer: String,
}

impl Panel {
    /// Empty axes. The title names the quantity with its unit.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis, detail: Detail) -> Self {
        let (title, inner, outer) = (title.into(), String::new(), String::new());
        Self {
            title,
            x,
            y,
            x_label: "time [s]",
            left: LEFT,
            height: HEIGHT,
            detail,
            lanes: Vec::new(),
            inner,
            outer,
        }
    }

    /// The same with another label of the horizontal axis and another height of the axes.
    #[must_use]
    pub fn shaped(self, x_label: &'static str, height: f64) -> Self {
        Self { x_label, height, ..self }
    }

    /// The same with lanes, named from the top, in place of a vertical axis.
    #[must_use]
    pub fn laned(self, lanes: Vec<String>, height: f64) -> Self {
        Self { lanes, height, left: LEFT_OF_LANES, ..self }
    }

    /// Width of the axes of a panel without lanes \[units\].
    pub fn width_of_axes() -> f64 {
        WIDTH - LEFT - RIGHT
    }

    fn width(&self) -> f64 {
        WIDTH - self.left - RIGHT
    }

    fn place(&self, x: f64, y: f64) -> Option<Place> {
        thin::place(
            10.0 * self.width() * self.x.share(x),
            10.0 * self.height * (1.0 - self.y.share(y)),
        )
    }

    /// A line through `points` in the order of x. It breaks where a point is not finite, or farther
    /// than `gap` from the one before.
    pub fn line(&mut self, class: &str, gap: f64, points: impl IntoIterator<Item = (f64, f64)>) {
        let mut data = String::new();
        let mut columns = Columns::new(self.detail.column);
        let mut before = f64::NEG_INFINITY;
        for (x, y) in points {
            let place = self.place(x, y);
            if place.is_none() || x - before > gap {
                subpath(&mut data, &columns.finish());
            }
            if let Some(place) = place {
                columns.take(place);
                before = x;
            }
        }
        subpath(&mut data, &columns.finish());
        self.path(&format!("line {class}"), &data);
    }

    /// A line through `points` in the plane, in their order.
    pub fn track(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let places: Vec<Place> = points.into_iter().filter_map(|(x, y)| self.place(x, y)).collect();
        let mut data = String::new();
        for line in thin::path(&places, self.detail.path_points) {
            subpath(&mut data, &line);
        }
        self.path(&format!("line {class}"), &data);
    }

    /// The hull of `corners`, grown by `radius` in the unit of x. Both axes must have one scale.
    pub fn shape(&mut self, class: &str, corners: &[(f64, f64)], radius: f64) {
        let places: Vec<Place> = corners.iter().filter_map(|&(x, y)| self.place(x, y)).collect();
        let mut data = String::new();
        subpath(&mut data, &places);
        let unit = 10.0 * self.width() * (self.x.share(1.0) - self.x.share(0.0));
        let around = short(2.0 * radius * unit);
        if !data.is_empty() {
            let _ = write!(
                self.inner,
                "<path class=\"shape {class}\" stroke-width=\"{around}\" d=\"{data}Z\"/>"
            );
        }
    }

    /// The area between −y and +y of `points`, broken like a line.
    pub fn band(&mut self, class: &str, gap: f64, points: impl IntoIterator<Item = (f64, f64)>) {
        let mut data = String::new();
        let mut columns = Columns::new(self.detail.column);
        let mut before = f64::NEG_INFINITY;
        let middle = self.place(0.0, 0.0).map_or(0, |(_, down)| down);
        let mut close = |columns: &mut Columns| {
            let above = columns.finish();
            let below = above.iter().rev().map(|&(right, down)| (right, 2 * middle - down));
            let around: Vec<Place> = above.iter().copied().chain(below).collect();
            subpath(&mut data, &around);
        };
        for (x, y) in points {
            let place = self.place(x, y.abs());
            if place.is_none() || x - before > gap {
                close(&mut columns);
            }
            if let Some(place) = place {
                columns.take(place);
                before = x;
            }
        }
        close(&mut columns);
        self.path(&format!("band {class}"), &data);
    }

    /// The area between two curves: `points` are (x, lower, upper), in the order of x.
    pub fn area(&mut self, class: &str, points: &[(f64, f64, f64)]) {
        let upper = points.iter().filter_map(|&(x, _, upper)| self.place(x, upper));
        let lower = points.iter().rev().filter_map(|&(x, lower, _)| self.place(x, lower));
        let mut data = String::new();
        subpath(&mut data, &upper.chain(lower).collect::<Vec<_>>());
        self.path(&format!("band {class}"), &data);
    }

    /// A dot at each of `points`; only one for points at the same place.
    pub fn dots(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let mut data = String::new();
        let mut columns = Columns::new(self.detail.column);
        points
            .into_iter()
            .filter_map(|(x, y)| self.place(x, y))
            .for_each(|place| columns.take(place));
        for place in columns.finish() {
            subpath(&mut data, &[place]);
        }
        self.path(&format!("dots {class}"), &data);
    }

    /// A horizontal line at `y`, with a label at its end if it lies within the axes.
    pub fn level(&mut self, y: f64, label: &str) {
        let share = self.y.share(y);
        if !(0.0..=1.0).contains(&share) {
            return;
        }
        let down = TOP + self.height * (1.0 - share);
        let (from, to) = (self.left, WIDTH - RIGHT);
        let _ = write!(
            self.outer,
            "<path class=\"level\" d=\"M{} {}H{}\"/>",
            short(from),
            short(down),
            short(to)
        );
        if !label.is_empty() {
            let text_down = if down < TOP + 12.0 { down + 10.0 } else { down - 3.0 };
            let (right, down) = (short(to - 2.0), short(text_down));
            let _ = write!(
                self.outer,
                "<text class=\"level\" x=\"{right}\" y=\"{down}\" text-anchor=\"end\">{}</text>",
                escape(label)
            );
        }
    }

    /// A bar for each stretch of x in `stretches`, `part` of `parts` of a lane's height. The
    /// narrowest bar stays visible.
    pub fn bars(
        &mut self,
        class: &str,
        lane: usize,
        part: (usize, usize),
        stretches: impl IntoIterator<Item = (f64, f64)>,
    ) {
        let height = 10.0 * self.height / self.lanes.len().max(1) as f64;
        let (part, parts) = (part.0 as f64, part.1.max(1) as f64);
        let top = height * (lane as f64 + 0.1 + 0.8 * part / parts);
        let tall = (height * 0.8 / parts).max(1.0);
        let across = 10.0 * self.width();
        let mut data = String::new();
        let mut draw = |(from, to): (f64, f64)| {
            let _ = write!(
                data,
                "M{from} {}h{}v{}h-{}z",
                top.round(),
                to - from,
                tall.round(),
                to - from
            );
        };
        let mut open: Option<(f64, f64)> = None;
        for (from, to) in stretches {
            let (from, to) =
                ((across * self.x.share(from)).round(), (across * self.x.share(to)).round());
            if !(from.is_finite() && to.is_finite()) {
                continue;
            }
            let to = to.max(from + f64::from(self.detail.column));
            open = Some(match open {
                Some((begun, until)) if from <= until => (begun, until.max(to)),
                other => {
                    other.into_iter().for_each(&mut draw);
                    (from, to)
                }
            });
        }
        open.into_iter().for_each(draw);
        self.path(&format!("bar {class}"), &data);
    }

    fn path(&mut self, class: &str, data: &str) {
        if !data.is_empty() {
            let _ = write!(self.inner, "<path class=\"{class}\" d=\"{data}\"/>");
        }
    }

    /// The SVG. `title` is the text for screen readers.
    pub fn finish(self, title: &str) -> String {
        let (width, bottom) = (self.width(), TOP + self.height);
        let mut svg = format!(
            "<svg role=\"img\" viewBox=\"0 0 {} {}\" xmlns=\"http://www.w3.org/2000/svg\">\
             <title>{}</title>",
            short(WIDTH),
            short(bottom + BOTTOM),
            escape(title)
        );
        let _ =
            write!(svg, "<text class=\"title\" x=\"2\" y=\"11\">{}</text>", escape(&self.title));
        self.write_grid(&mut svg);
        let _ = write!(
            svg,
            "{}<svg x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" viewBox=\"0 0 {} {}\" \
             preserveAspectRatio=\"none\">{}</svg>",
            self.outer,
            short(self.left),
            short(TOP),
            short(width),
            short(self.height),
            short(10.0 * width),
            short(10.0 * self.height),
            self.inner
        );
        let right = short(self.left + width / 2.0);
        let _ = write!(
            svg,
            "<text x=\"{right}\" y=\"{}\" text-anchor=\"middle\">{}</text></svg>",
            short(bottom + 26.0),
            self.x_label
        );
        svg
    }

    fn write_grid(&self, svg: &mut String) {
        let (width, bottom) = (self.width(), TOP + self.height);
        let (mut grid, mut words) = (String::new(), String::new());
        for tick in self.x.ticks(5) {
            let right = self.left + width * self.x.share(tick.value);
            let _ = write!(grid, "M{} {}V{}", short(right), short(TOP), short(bottom));
            // The last label would be cut off at the edge.
            let middle = short(right.min(WIDTH - 0.5 * DIGIT * tick.label.len() as f64));
            let _ = write!(
                words,
                "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                short(bottom + 13.0),
                tick.label
            );
        }
        let edge = short(self.left - 4.0);
        let lane = self.height / self.lanes.len().max(1) as f64;
        for (index, name) in self.lanes.iter().enumerate() {
            let down = TOP + lane * index as f64;
            let _ =
                write!(grid, "M{} {}H{}", short(self.left), short(down), short(self.left + width));
            let middle = short(down + lane / 2.0 + 3.5);
            let _ = write!(
                words,
                "<text x=\"{edge}\" y=\"{middle}\" text-anchor=\"end\">{}</text>",
                escape(name)
            );
        }
        let ticks = if self.lanes.is_empty() {
            self.y.ticks((self.height / 28.0) as usize)
        } else {
            Vec::new()
        };
        for tick in ticks {
            let down = TOP + self.height * (1.0 - self.y.share(tick.value));
            let _ =
                write!(grid, "M{} {}H{}", short(self.left), short(down), short(self.left + width));
            let _ = write!(
                words,
                "<text x=\"{edge}\" y=\"{}\" text-anchor=\"end\">{}</text>",
                short(down + 3.5),
                tick.label
            );
        }
        let _ = write!(svg, "<path class=\"grid\" d=\"{grid}\"/>{words}");
    }
}

/// One line of a path: its first place, then the differences. A single place is a dot.
fn subpath(data: &mut String, places: &[Place]) {
    let [(right, down), rest @ ..] = places else { return };
    let _ = write!(data, "M{right} {down}");
    if rest.is_empty() {
        data.push_str("h0");
        return;
    }
    let mut before = (*right, *down);
    for (index, &(right, down)) in rest.iter().enumerate() {
        let (across, along) = (right - before.0, down - before.1);
        let (first, between) = (
            if index == 0 {
                "l"
            } else if across >= 0 {
                " "
            } else {
                ""
            },
            if along >= 0 { " " } else { "" },
        );
        let _ = write!(data, "{first}{across}{between}{along}");
        before = (right, down);
    }
}

/// A number of units, with one decimal where it needs one.
fn short(value: f64) -> String {
    let rounded = (10.0 * value).round() / 10.0;
    format!("{rounded}")
}

#[cfg(test)]
mod tests;
