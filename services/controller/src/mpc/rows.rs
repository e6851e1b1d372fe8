//! The matrix of the inequalities, row by row: each touches a run of neighbouring unknowns, and perhaps a slack far from them.
//!
//! Only these runs are ever read, cleared or multiplied: a seventh of the whole for twenty periods.

use std::ops::{Index, IndexMut, Range};

/// G. A place is a row and a column.
#[derive(Debug, Clone, PartialEq)]
pub struct Rows {
    columns: usize,
    /// Row by row.
    entries: Vec<f64>,
    /// Where each row may be other than zero: two runs of columns, of which the second may be empty.
    runs: Vec<[Range<usize>; 2]>,
}

impl Rows {
    /// All zero, and free to be anything everywhere.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { columns, entries: vec![0.0; rows * columns], runs: vec![[0..columns, columns..columns]; rows] }
    }

    /// Says once where there may be anything else than zero.
    pub fn set_structure(&mut self, places: &[(usize, usize)]) {
        for (row, runs) in self.runs.iter_mut().enumerate() {
            let mut columns: Vec<usize> = places.iter().filter(|(of, _)| *of == row).map(|&(_, column)| column).collect();
            columns.sort_unstable();
            let first = columns.first().copied().unwrap_or(self.columns);
            let together = columns.iter().zip(first..).take_while(|(column, expected)| *column == expected).count();
            let rest = columns.get(together..).unwrap_or_default();
            let second = rest.first().zip(rest.last()).map_or(self.columns..self.columns, |(&from, &to)| from..to + 1);
            *runs = [first..first + together, second];
        }
    }

    /// Sets every entry to zero.
    pub fn clear(&mut self) {
        for (row, runs) in self.entries.chunks_exact_mut(self.columns.max(1)).zip(&self.runs) {
            for run in runs {
                row[run.clone()].fill(0.0);
            }
        }
    }

    /// The entries of row `row` that may be other than zero, with their columns, in order.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, f64)> {
        let entries = &self.entries[row * self.columns..(row + 1) * self.columns];
        let [first, second] = self.runs[row].clone();
        first.chain(second).map(|column| (column, entries[column]))
    }

    /// Row `row` times x, taken off `from`.
    pub fn taken_off(&self, row: usize, x: &[f64], from: f64) -> f64 {
        let entries = &self.entries[row * self.columns..(row + 1) * self.columns];
        self.runs[row].iter().fold(from, |left, run| {
            entries[run.clone()].iter().zip(&x[run.clone()]).fold(left, |left, (entry, value)| left - entry * value)
        })
    }
}

impl Index<(usize, usize)> for Rows {
    type Output = f64;

    fn index(&self, (row, column): (usize, usize)) -> &f64 {
        &self.entries[row * self.columns + column]
    }
}

impl IndexMut<(usize, usize)> for Rows {
    fn index_mut(&mut self, (row, column): (usize, usize)) -> &mut f64 {
        &mut self.entries[row * self.columns + column]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_read_where_it_may_be_other_than_zero() {
        let mut rows = Rows::zeros(3, 7);
        rows.set_structure(&[(0, 1), (0, 2), (0, 5), (2, 6), (1, 0), (1, 3), (1, 5)]);
        let columns = |row: usize| rows.row(row).map(|(column, _)| column).collect::<Vec<_>>();
        assert_eq!((columns(0), columns(1), columns(2)), (vec![1, 2, 5], vec![0, 3, 4, 5], vec![6]));
        (rows[(0, 2)], rows[(0, 5)]) = (2.0, -1.0);
        let x: Vec<f64> = (1..8).map(f64::from).collect();
        assert_eq!((rows.taken_off(0, &x, 10.0), rows.taken_off(1, &x, 10.0)), (10.0, 10.0));
        rows.clear();
        assert_eq!(rows.taken_off(0, &[1.0; 7], 10.0), 10.0);
    }
}
