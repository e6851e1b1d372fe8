//! Q R of a matrix that gains and loses columns, and sometimes gains a row: the active bounds'
//! normals.
//!
//! Columns are added by Gram and Schmidt, twice where once is not enough (Daniel, Gragg, Kaufman &
//! Stewart, Mathematics of Computation 30, 1976). They are removed by Givens rotations.

use nalgebra::{DMatrix, DVector};

/// Share of a vector's square below which its part orthogonal to the columns is rounding.
pub(super) const DEPENDENT: f64 = 1e-16;
/// Share of a vector's square below which its part orthogonal to the columns is orthogonalised a
/// second time.
const CANCELLED: f64 = 0.25;

/// Q and R with their memory: set up once, then in place.
pub(super) struct Orthogonal {
    basis: DMatrix<f64>,
    triangle: DMatrix<f64>,
    /// Number of columns.
    columns: usize,
    /// Number of leading entries of a column that may be nonzero.
    reach: usize,
    /// Of the vector that was decomposed last: Qᵀd, and w = d − Q Qᵀd with its square.
    shares: DVector<f64>,
    rest: DVector<f64>,
    square: f64,
    /// Scratch of one pass.
    passed: DVector<f64>,
}

impl Orthogonal {
    /// Allocates for vectors of this many entries.
    pub(super) fn new(entries: usize) -> Self {
        Self {
            basis: DMatrix::zeros(entries, entries),
            triangle: DMatrix::zeros(entries, entries),
            columns: 0,
            reach: 0,
            shares: DVector::zeros(entries),
            rest: DVector::zeros(entries),
            square: 0.0,
            passed: DVector::zeros(entries),
        }
    }

    /// Removes all columns.
    pub(super) fn clear(&mut self) {
        (self.columns, self.reach) = (0, 0);
    }

    /// Whether another column fits.
    pub(super) fn has_room(&self) -> bool {
        self.columns < self.basis.ncols()
    }

    /// w.
    pub(super) fn rest(&self) -> &DVector<f64> {
        &self.rest
    }

    /// Decomposes d, of which at most the first `reach` entries are nonzero. Returns |d|² and |w|².
    pub(super) fn take_apart(&mut self, d: &DVector<f64>, reach: usize) -> (f64, f64) {
        self.reach = self.reach.max(reach);
        self.rest.copy_from(d);
        let (columns, reach, stride) = (self.columns, self.reach, self.basis.nrows());
        let (rest, shares) =
            (&mut self.rest.as_mut_slice()[..reach], &mut self.shares.as_mut_slice()[..columns]);
        let passed = &mut self.passed.as_mut_slice()[..columns];
        let basis = || self.basis.as_slice().chunks_exact(stride).map(|column| &column[..reach]);
        shares.fill(0.0);
        let whole = dot(rest, rest);
        self.square = whole;
        loop {
            for ((passed, share), column) in passed.iter_mut().zip(&mut *shares).zip(basis()) {
                *passed = dot(column, rest);
                *share += *passed;
            }
            for (passed, column) in passed.iter().zip(basis()) {
                rest.iter_mut().zip(column).for_each(|(rest, entry)| *rest -= passed * entry);
            }
            let before = std::mem::replace(&mut self.square, dot(rest, rest));
            // A much smaller remainder may be rounding too. A NaN ends the loop at once.
            let again = self.square < CANCELLED * before && self.square > DEPENDENT * whole;
            if !again {
                return (whole, self.square);
            }
        }
    }

    /// R⁻¹ Qᵀd.
    pub(super) fn solve(&self, into: &mut DVector<f64>) {
        into.copy_from(&self.shares);
        self.solve_triangle(into);
    }

    /// R⁻¹ z, in place of z.
    pub(super) fn solve_triangle(&self, into: &mut DVector<f64>) {
        for column in (0..self.columns).rev() {
            into[column] /= self.triangle[(column, column)];
            let value = into[column];
            into.rows_mut(0, column).axpy(
                -value,
                &self.triangle.column(column).rows(0, column),
                1.0,
            );
        }
    }

    /// z of Rᵀ z = −ρ.
    pub(super) fn solve_transposed(&self, distances: &[f64], into: &mut DVector<f64>) {
        into.fill(0.0);
        for (column, distance) in distances.iter().enumerate().take(self.columns) {
            let above = self.triangle.column(column).rows(0, column).dot(&into.rows(0, column));
            into[column] = -(distance + above) / self.triangle[(column, column)];
        }
    }

    /// Adds Q z to `to`.
    pub(super) fn combine(&self, shares: &DVector<f64>, to: &mut DVector<f64>) {
        for (column, share) in shares.iter().enumerate().take(self.columns) {
            let column = self.basis.column(column);
            to.rows_mut(0, self.reach).axpy(*share, &column.rows(0, self.reach), 1.0);
        }
    }

    /// Adds d as the last column.
    pub(super) fn add_column(&mut self) {
        let (last, end) = (self.columns, self.square.sqrt());
        let mut column = self.triangle.column_mut(last);
        column.fill(0.0);
        column.rows_mut(0, last).copy_from(&self.shares.rows(0, last));
        column[last] = end;
        self.basis.set_column(last, &self.rest);
        self.basis.column_mut(last).unscale_mut(end);
        self.columns += 1;
    }

    /// Drops the column at `place`. Rotations make R triangular again.
    pub(super) fn drop_column(&mut self, place: usize) {
        self.columns -= 1;
        for column in place..self.columns {
            self.triangle.swap_columns(column, column + 1);
        }
        for column in place..self.columns {
            let rotation = Rotation::between(
                self.triangle[(column, column)],
                self.triangle[(column + 1, column)],
            );
            for other in column..self.columns {
                let (above, below) = rotation
                    .turn(self.triangle[(column, other)], self.triangle[(column + 1, other)]);
                (self.triangle[(column, other)], self.triangle[(column + 1, other)]) =
                    (above, below);
            }
            for row in 0..self.reach {
                let (left, right) =
                    rotation.turn(self.basis[(row, column)], self.basis[(row, column + 1)]);
                (self.basis[(row, column)], self.basis[(row, column + 1)]) = (left, right);
            }
        }
    }

    /// Appends a row: every column gains the entry at `place`, which was zero, from `entries`.
    /// `entries` is overwritten. The new entry's unit vector is appended to Q, and `entries` to R;
    /// rotations eliminate it.
    pub(super) fn add_row(&mut self, place: usize, entries: &mut DVector<f64>) {
        self.reach = self.reach.max(place + 1);
        self.rest.fill(0.0);
        self.rest[place] = 1.0;
        let first = entries
            .iter()
            .take(self.columns)
            .position(|entry| *entry != 0.0)
            .unwrap_or(self.columns);
        for column in first..self.columns {
            let rotation = Rotation::between(self.triangle[(column, column)], entries[column]);
            for other in column..self.columns {
                (self.triangle[(column, other)], entries[other]) =
                    rotation.turn(self.triangle[(column, other)], entries[other]);
            }
            for (left, right) in
                self.basis.column_mut(column).iter_mut().zip(self.rest.iter_mut()).take(self.reach)
            {
                (*left, *right) = rotation.turn(*left, *right);
            }
        }
    }
}

/// A Givens rotation.
#[derive(Clone, Copy)]
struct Rotation {
    cos: f64,
    sin: f64,
}

impl Rotation {
    /// The rotation that turns (above, below) to (length, 0).
    fn between(above: f64, below: f64) -> Self {
        let length = (above * above + below * below).sqrt();
        Self { cos: above / length, sin: below / length }
    }

    fn turn(self, above: f64, below: f64) -> (f64, f64) {
        (self.cos * above + self.sin * below, self.cos * below - self.sin * above)
    }
}

/// aᵀb, in four independent sums.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (a, b) in a.iter().zip(b) {
        (0..4).for_each(|lane| sums[lane] += a[lane] * b[lane]);
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vector_that_is_not_finite_terminates_and_is_not_independent() {
        let mut normals = Orthogonal::new(3);
        let (_, square) = normals.take_apart(&DVector::from_vec(vec![1.0, 2.0, 2.0]), 3);
        assert_eq!(square, 9.0);
        normals.add_column();
        for d in [
            [f64::NAN, 0.0, 0.0],
            [0.0, f64::INFINITY, 1.0],
            [f64::INFINITY, f64::NEG_INFINITY, 0.0],
            [f64::MAX; 3],
        ] {
            let (whole, square) = normals.take_apart(&DVector::from_row_slice(&d), 3);
            let beside = square > DEPENDENT * whole;
            assert!(!beside, "{d:?}: {square} of {whole}");
        }
    }
}
