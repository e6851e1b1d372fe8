//! Curves over the time of the run, on a logarithmic scale.

use super::{Scene, block};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::text::Line;
use ratatui::widgets::{Axis, Chart, Dataset, GraphType};

/// Longest part of the run that is shown \[s\].
pub(super) const SHOWN_S: f64 = 60.0;
/// Smaller values are drawn as this value.
const SMALLEST: f64 = 1e-6;

/// One curve.
pub(super) struct Curve {
    /// Its colour.
    pub(super) color: Color,
    /// The marker of its points. It distinguishes the curves without colours.
    pub(super) marker: Marker,
    /// Time \[s\] and value, above 0.
    pub(super) points: Vec<(f64, f64)>,
}

/// Draws `curves` in a frame with this title. Without points only the frame is drawn.
pub(super) fn draw<'a>(
    frame: &mut Frame<'_>,
    area: Rect,
    scene: Scene<'_>,
    title: impl Into<Line<'a>>,
    mut curves: Vec<Curve>,
) {
    let block = block(title, scene.look);
    for point in curves.iter_mut().flat_map(|curve| &mut curve.points) {
        point.1 = point.1.max(SMALLEST).log10();
    }
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let Some(first) = points().next() else {
        frame.render_widget(block, area);
        return;
    };
    let (begin, end) = points()
        .fold((first.0, first.0), |(begin, end), point| (begin.min(point.0), end.max(point.0)));
    let (low, high) = points()
        .fold((first.1, first.1), |(low, high), point| (low.min(point.1), high.max(point.1)));
    let (low, high) = (low.floor(), high.ceil().max(low.floor() + 1.0));
    let rows = usize::from(block.inner(area).height).saturating_sub(2);
    let labels = decades(low, high, rows);
    let datasets = curves.iter().map(|curve| {
        let graph_type =
            if curve.marker == Marker::Braille { GraphType::Line } else { GraphType::Scatter };
        Dataset::default()
            .data(&curve.points)
            .marker(curve.marker)
            .graph_type(graph_type)
            .style(curve.color)
    });
    let chart = Chart::new(datasets.collect())
        .block(block)
        .legend_position(None)
        .x_axis(
            Axis::default()
                .bounds([begin, end.max(begin + 1.0)])
                .labels([format!("{begin:.0} s"), format!("{end:.0} s")]),
        )
        .y_axis(Axis::default().bounds([low, high]).labels(labels));
    frame.render_widget(chart, area);
}

/// Labels at every power of ten from `low` to `high`. If there are too few rows for all, only the
/// two ends have labels.
fn decades(low: f64, high: f64, rows: usize) -> Vec<String> {
    let text = |power: f64| format!("{}", 10_f64.powf(power));
    let count = (high - low) as usize;
    if rows > 2 * count {
        (0..=count).map(|step| text(low + step as f64)).collect()
    } else {
        vec![text(low), text(high)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_has_a_label_at_every_power_of_ten_where_there_is_room() {
        assert_eq!(decades(-3.0, 0.0, 7), ["0.001", "0.01", "0.1", "1"]);
        assert_eq!(decades(-3.0, 0.0, 6), ["0.001", "1"]);
        assert_eq!(decades(0.0, 2.0, 9), ["1", "10", "100"]);
    }
}
