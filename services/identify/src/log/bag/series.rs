//! Values of one topic over time → values at other times. Times are nanoseconds.

use robot::{AXES, Velocity};

/// Time for which a command other than zero holds \[ns\]. Then a base may have stopped by itself.
const HELD_MAX_NANOS: i64 = 500_000_000;

/// Longest step that is no gap, in median steps: one message may be missing.
const GAP_STEPS: f64 = 2.5;

/// Values in the order of their times.
#[derive(Debug, Clone, Default)]
pub(super) struct Series<const N: usize> {
    points: Vec<Point<N>>,
    /// Longest step that is no gap.
    gap_nanos: i64,
}

/// A value, and the number of its message within the topic, from 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point<const N: usize> {
    pub(super) nanos: i64,
    pub(super) number: u64,
    pub(super) value: [f64; N],
}

/// Why there is no mean command of a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoCommand {
    /// It begins before the first command.
    Before,
    /// The last command is too old.
    Old,
}

impl<const N: usize> Series<N> {
    /// `points` must be in the order of their times.
    pub(super) fn new(points: Vec<Point<N>>) -> Self {
        debug_assert!(points.is_sorted_by_key(|point| point.nanos));
        let mut steps: Vec<i64> =
            points.windows(2).map(|pair| pair[1].nanos - pair[0].nanos).collect();
        steps.sort_unstable();
        let median = steps.get(steps.len() / 2).copied().unwrap_or(0);
        Self { points, gap_nanos: (GAP_STEPS * median as f64) as i64 }
    }

    pub(super) fn points(&self) -> &[Point<N>] {
        &self.points
    }

    /// Parts without a gap.
    pub(super) fn parts(&self) -> impl Iterator<Item = &[Point<N>]> {
        self.points.chunk_by(|before, after| after.nanos - before.nanos <= self.gap_nanos)
    }

    /// The value at `nanos`, on the line between its neighbours, and the earlier of these. None
    /// outside the series, and within a gap.
    pub(super) fn at(&self, nanos: i64) -> Option<Point<N>> {
        let next = self.points.partition_point(|point| point.nanos <= nanos);
        let before = self.points.get(next.checked_sub(1)?)?;
        if before.nanos == nanos {
            return Some(*before);
        }
        let after = self.points.get(next)?;
        let step = after.nanos - before.nanos;
        if step > self.gap_nanos {
            return None;
        }
        let share = (nanos - before.nanos) as f64 / step as f64;
        let value = std::array::from_fn(|place| {
            before.value[place] + share * (after.value[place] - before.value[place])
        });
        Some(Point { nanos, number: before.number, value })
    }
}

impl Series<AXES> {
    /// Mean from `from` to `to` of commands that hold until the next one.
    pub(super) fn mean(&self, from: i64, to: i64) -> Result<Velocity, NoCommand> {
        let next = self.points.partition_point(|point| point.nanos <= from);
        let first = next.checked_sub(1).ok_or(NoCommand::Before)?;
        let mut sum = [0.0; AXES];
        for (place, command) in self.points.iter().enumerate().skip(first) {
            let begin = command.nanos.max(from);
            if begin >= to && begin > from {
                break;
            }
            let end = self.points.get(place + 1).map_or(to, |point| point.nanos.min(to));
            let is_old = end - command.nanos > HELD_MAX_NANOS;
            if is_old && command.value != [0.0; AXES] {
                return Err(NoCommand::Old);
            }
            let share = (end - begin) as f64 / (to - from) as f64;
            (0..AXES).for_each(|axis| sum[axis] += share * command.value[axis]);
        }
        Ok(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series<const N: usize>(points: &[(i64, [f64; N])]) -> Series<N> {
        let point = |(number, &(nanos, value))| Point { nanos, number: number as u64 + 1, value };
        Series::new(points.iter().enumerate().map(point).collect())
    }

    #[test]
    fn a_command_counts_by_the_time_for_which_it_holds() {
        let ms = 1_000_000;
        let commands = series(&[
            (0, [1.0, 0.0, 0.0]),
            (15 * ms, [3.0, 0.0, 1.0]),
            (18 * ms, [0.0; 3]),
            (600 * ms, [1.0; 3]),
        ]);
        let mean = |from, to| commands.mean(from * ms, to * ms);
        assert_eq!(mean(0, 10), Ok([1.0, 0.0, 0.0]));
        let [forward, left, yaw] = mean(10, 20).unwrap_or_default();
        assert!((forward - 1.4).abs() < 1e-12 && left == 0.0 && (yaw - 0.3).abs() < 1e-12);
        assert_eq!(mean(-5, 5), Err(NoCommand::Before));
        assert_eq!(mean(580, 600), Ok([0.0; 3]), "zero holds");
        assert_eq!(mean(1090, 1100), Ok([1.0; 3]));
        assert_eq!(mean(1100, 1110), Err(NoCommand::Old));
    }

    #[test]
    fn a_measurement_that_was_made_at_that_time_is_not_changed() {
        let values = [0.1 + 0.2, -1e-17];
        let measured = series(&[(0, [1.0, 2.0]), (10, values), (20, [3.0, 4.0]), (90, [0.0; 2])]);
        assert_eq!(measured.at(10).map(|point| point.value), Some(values));
        assert_eq!(measured.at(15).map(|point| point.number), Some(2));
        assert!(measured.at(50).is_none(), "a gap");
        assert!(measured.at(-1).is_none() && measured.at(91).is_none());
        assert_eq!(measured.parts().count(), 2);
    }
}
