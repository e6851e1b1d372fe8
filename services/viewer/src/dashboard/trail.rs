//! A bounded history: the newest points of a run of any length.

use std::collections::VecDeque;

/// Largest number of stored points.
pub const KEPT_MAX: usize = 6000;

/// Points with their times \[s\] of the run, oldest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Trail<T> {
    points: VecDeque<(f64, T)>,
}

impl<T> Default for Trail<T> {
    fn default() -> Self {
        Self { points: VecDeque::new() }
    }
}

impl<T: Copy> Trail<T> {
    /// Adds the newest point, and drops the oldest if there are too many.
    pub fn push(&mut self, seconds: f64, value: T) {
        if self.points.len() == KEPT_MAX {
            self.points.pop_front();
        }
        self.points.push_back((seconds, value));
    }

    /// Removes all points.
    pub fn clear(&mut self) {
        self.points.clear();
    }

    /// The newest point.
    pub fn last(&self) -> Option<(f64, T)> {
        self.points.back().copied()
    }

    /// All points, oldest first.
    pub fn all(&self) -> impl Iterator<Item = (f64, T)> + '_ {
        self.points.iter().copied()
    }

    /// The points of the last `seconds`, oldest first.
    pub fn newest(&self, seconds: f64) -> impl Iterator<Item = (f64, T)> + '_ {
        let since = self.last().map_or(0.0, |(last, _)| last - seconds);
        self.all().skip_while(move |&(at, _)| at < since)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_points_are_dropped() {
        let mut trail = Trail::default();
        for tick in 0..KEPT_MAX + 10 {
            trail.push(tick as f64, tick);
        }
        assert_eq!((trail.all().next(), trail.all().count()), (Some((10.0, 10)), KEPT_MAX));
        let newest: Vec<usize> = trail.newest(2.0).map(|(_, tick)| tick).collect();
        assert_eq!(newest, [KEPT_MAX + 7, KEPT_MAX + 8, KEPT_MAX + 9]);
    }
}
