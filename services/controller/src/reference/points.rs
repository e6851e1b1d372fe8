//! A path through points of a CSV file.

use super::PLACE_MAX;
use super::path::Moment;
use model::wrap;
use std::path::{Path, PathBuf};

/// Least time between two points \[s\].
const STEP_MIN_S: f64 = 1e-6;

/// A file of points that cannot be followed.
#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    /// The file cannot be read, or a line does not have four numbers.
    #[error("{file}: {source}; expected the columns time_s,x_m,y_m,yaw_rad")]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The cause.
        source: csv::Error,
    },
    /// A number is infinite, or time does not increase.
    #[error("{file}:{line}: {what}")]
    Impossible {
        /// The file.
        file: PathBuf,
        /// Line of the point.
        line: u64,
        /// The expected value.
        what: &'static str,
    },
    /// Fewer than two points.
    #[error("{file}: {points} points are no path; expected at least 2")]
    TooFew {
        /// The file.
        file: PathBuf,
        /// Number of points.
        points: usize,
    },
}

#[derive(Debug, Clone, Copy, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Point {
    time_s: f64,
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
}

/// Points in the order of time, at least two.
#[derive(Debug)]
pub(super) struct Points {
    points: Vec<Point>,
}

impl Points {
    pub(super) fn read(file: &Path) -> Result<Self, PointsError> {
        let unreadable = |source| PointsError::Unreadable { file: file.to_owned(), source };
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(file).map_err(unreadable)?;
        let mut points: Vec<Point> = Vec::new();
        let columns = reader.headers().map_err(unreadable)?.clone();
        for row in reader.records() {
            let row = row.map_err(unreadable)?;
            let point: Point = row.deserialize(Some(&columns)).map_err(unreadable)?;
            // For a point directly after a blank line, this is the blank line.
            let line = row.position().map_or(0, csv::Position::line);
            let impossible = |what| PointsError::Impossible { file: file.to_owned(), line, what };
            if ![point.time_s, point.x_m, point.y_m, point.yaw_rad]
                .iter()
                .all(|value| value.abs() <= PLACE_MAX)
            {
                return Err(impossible("expected four numbers of at most 1000000, either way"));
            }
            if points.last().is_some_and(|before| point.time_s < before.time_s + STEP_MIN_S) {
                return Err(impossible(
                    "expected a time_s at least 0.000001 greater than in the line before",
                ));
            }
            points.push(point);
        }
        if points.len() < 2 {
            return Err(PointsError::TooFew { file: file.to_owned(), points: points.len() });
        }
        Ok(Self { points })
    }

    pub(super) fn at(&self, time: f64) -> Moment {
        let next = self.points.partition_point(|point| point.time_s <= time);
        let standing = |point: &Point| Moment {
            position: [point.x_m, point.y_m],
            yaw: point.yaw_rad,
            ..Moment::default()
        };
        let (Some(from), Some(to)) =
            (next.checked_sub(1).and_then(|i| self.points.get(i)), self.points.get(next))
        else {
            let end = if next == 0 { self.points.first() } else { self.points.last() };
            return end.map_or_else(Moment::default, standing);
        };
        let duration = to.time_s - from.time_s;
        let share = (time - from.time_s) / duration;
        let (dx, dy, turn) =
            (to.x_m - from.x_m, to.y_m - from.y_m, wrap(to.yaw_rad - from.yaw_rad));
        Moment {
            position: [from.x_m + share * dx, from.y_m + share * dy],
            velocity: [dx / duration, dy / duration],
            acceleration: [0.0; 2],
            yaw: from.yaw_rad + share * turn,
            yaw_rate: turn / duration,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn file(text: &str) -> Result<tempfile::NamedTempFile, std::io::Error> {
        let mut file = tempfile::NamedTempFile::new()?;
        file.write_all(text.as_bytes())?;
        Ok(file)
    }

    #[test]
    fn motion_between_two_points_is_straight() -> Result<(), Box<dyn std::error::Error>> {
        let points = Points::read(file("time_s,x_m,y_m,yaw_rad\n0,0,0,0\n2,4,2,1\n")?.path())?;
        let half = points.at(1.0);
        assert_eq!((half.position, half.velocity, half.yaw), ([2.0, 1.0], [2.0, 1.0], 0.5));
        assert_eq!(points.at(3.0).velocity, [0.0; 2]);
        Ok(())
    }

    #[test]
    fn time_that_does_not_increase_is_refused_with_its_line()
    -> Result<(), Box<dyn std::error::Error>> {
        let bad = file("time_s,x_m,y_m,yaw_rad\n0,0,0,0\n2,4,2,1\n2,5,2,1\n")?;
        let refused = Points::read(bad.path()).map(drop);
        assert!(matches!(refused, Err(PointsError::Impossible { line: 4, .. })), "{refused:?}");
        Ok(())
    }

    #[test]
    fn a_blank_line_counts_as_a_line() -> Result<(), Box<dyn std::error::Error>> {
        let bad = file("time_s,x_m,y_m,yaw_rad\n\n0,0,0,0\n1,inf,0,0\n")?;
        let refused = Points::read(bad.path()).map(drop);
        assert!(matches!(refused, Err(PointsError::Impossible { line: 4, .. })), "{refused:?}");
        Ok(())
    }

    #[test]
    fn points_with_an_infinite_speed_between_them_are_refused()
    -> Result<(), Box<dyn std::error::Error>> {
        for row in ["1e-300,1,0,0", "1,1e308,0,0"] {
            let bad = file(&format!("time_s,x_m,y_m,yaw_rad\n0,0,0,0\n{row}\n"))?;
            assert!(Points::read(bad.path()).is_err(), "{row}");
        }
        Ok(())
    }
}
