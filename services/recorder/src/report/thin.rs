//! Many points → as many as are visible. No peak disappears.

use std::collections::HashSet;

/// A position in a panel, in tenths of its units, right and down.
pub(super) type Place = (i32, i32);

/// Farthest position that is drawn; anything beyond is outside of every panel.
const FARTHEST: f64 = 1e6;

/// The nearest position, if there is one.
pub(super) fn place(right: f64, down: f64) -> Option<Place> {
    let near = |value: f64| value.clamp(-FARTHEST, FARTHEST).round() as i32;
    (right.is_finite() && !down.is_nan()).then(|| (near(right), near(down)))
}

/// The points of one column that are kept: the first, the highest, the lowest and the last, in
/// order.
#[derive(Debug, Default)]
struct Column {
    number: i32,
    points: Vec<Place>,
}

impl Column {
    fn take(&mut self, point: Place) {
        self.points.push(point);
        if let [first, .., last] = *self.points.as_slice()
            && self.points.len() > 4
        {
            let highest =
                self.points.iter().copied().min_by_key(|&(_, down)| down).unwrap_or(first);
            let lowest = self.points.iter().copied().max_by_key(|&(_, down)| down).unwrap_or(first);
            let mut kept = [false; 2];
            let mut left: Vec<Place> = vec![first];
            for &point in &self.points {
                for (kept, extreme) in kept.iter_mut().zip([highest, lowest]) {
                    if !*kept && point == extreme {
                        *kept = true;
                        left.push(point);
                    }
                }
            }
            left.push(last);
            left.dedup();
            self.points = left;
        }
    }
}

/// A line, column by column. Each column of `width` tenths keeps at most its first, highest, lowest
/// and last point.
#[derive(Debug)]
pub(super) struct Columns {
    width: i32,
    column: Column,
    line: Vec<Place>,
}

impl Columns {
    pub(super) fn new(width: i32) -> Self {
        Self { width: width.max(1), column: Column::default(), line: Vec::new() }
    }

    pub(super) fn take(&mut self, point: Place) {
        let number = point.0.div_euclid(self.width);
        if number != self.column.number {
            self.line.append(&mut self.column.points);
            self.column.number = number;
        }
        self.column.take(point);
    }

    /// The line so far; the next one starts empty.
    pub(super) fn finish(&mut self) -> Vec<Place> {
        self.line.append(&mut self.column.points);
        let mut line = std::mem::take(&mut self.line);
        line.dedup();
        line
    }
}

/// A path in the plane as lines of at most `most` points together. Parts that repeat earlier
/// positions are not drawn. If that is not enough, positions at larger and larger distances count
/// as the same.
pub(super) fn path(points: &[Place], most: usize) -> Vec<Vec<Place>> {
    if points.len() <= most {
        return vec![points.to_vec()];
    }
    let mut cell = 5;
    loop {
        let lines = unvisited(points, cell);
        if lines.iter().map(Vec::len).sum::<usize>() <= most || cell > 1 << 20 {
            return lines;
        }
        cell *= 2;
    }
}

fn unvisited(points: &[Place], cell: i32) -> Vec<Vec<Place>> {
    let mut visited = HashSet::new();
    let (mut lines, mut line, mut before) = (Vec::new(), Vec::new(), None);
    for &point in points {
        if visited.insert((point.0.div_euclid(cell), point.1.div_euclid(cell))) {
            if line.is_empty() {
                line.extend(before);
            }
            line.push(point);
        } else if !line.is_empty() {
            line.push(point);
            lines.push(std::mem::take(&mut line));
        }
        before = Some(point);
    }
    lines.push(line);
    lines.retain(|line| !line.is_empty());
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thinned(points: impl IntoIterator<Item = Place>, width: i32) -> Vec<Place> {
        let mut columns = Columns::new(width);
        points.into_iter().for_each(|point| columns.take(point));
        columns.finish()
    }

    #[test]
    fn no_peak_disappears_however_many_points_there_are() {
        // An hour at 50 Hz in 300 columns of ten tenths, with one peak up and one down.
        let height = |index: i32| match index {
            77_777 => -900,
            123_456 => 800,
            _ => (index * 7919) % 11,
        };
        let line = thinned((0..180_000).map(|index| (index / 60, height(index))), 10);
        assert!(line.contains(&(77_777 / 60, -900)) && line.contains(&(123_456 / 60, 800)));
        assert!(line.len() <= 4 * 301, "{}", line.len());
        assert!(line.is_sorted_by_key(|&(right, _)| right));
        assert_eq!(
            (line.first(), line.last()),
            (Some(&(0, height(0))), Some(&(179_999 / 60, height(179_999))))
        );
    }

    #[test]
    fn few_points_stay_as_they_are() {
        let points = [(0, 5), (10, -3), (20, 8), (21, 9)];
        assert_eq!(thinned(points, 10), points);
        assert_eq!(path(&points, 10), [points.to_vec()]);
    }

    #[test]
    fn laps_are_drawn_once_and_a_different_lap_is_visible() {
        let lap = |radius: f64| {
            (0..600).map(move |step| (0.01 * f64::from(step), radius)).map(|(angle, radius)| {
                place(radius * angle.cos(), radius * angle.sin()).unwrap_or_default()
            })
        };
        let mut points: Vec<Place> = (0..300).flat_map(|_| lap(500.0)).collect();
        drop(points.splice(60_000..60_000, lap(700.0)));
        let lines = path(&points, 5000);
        assert!(lines.iter().map(Vec::len).sum::<usize>() <= 5000);
        assert!(lines.iter().flatten().any(|&(right, _)| right == 700), "the different lap");
    }

    #[test]
    fn a_point_that_is_not_finite_has_no_position() {
        assert_eq!(place(f64::NAN, 1.0), None);
        assert_eq!(place(1.0, f64::NAN), None);
        assert_eq!(place(3.4, f64::INFINITY), Some((3, 1_000_000)));
    }
}
