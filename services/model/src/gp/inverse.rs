//! The inverse of a covariance, updated at O(n²) when a sample is inserted or removed.
//!
//! | here     | in the equations                      | size      |
//! |----------|---------------------------------------|-----------|
//! | `values` | P = C⁻¹, C the covariance with noise  | `n` × `n` |
//! | `solved` | P c, c the covariances with a new one | `n`       |
//! | `left`   | s = c₀ − cᵀP c, c₀ its own variance   |           |
//!
//! ```text
//! in    P ← [P + P c cᵀP / s,  −P c / s;  −cᵀP / s,  1 / s]
//! out   P ← Q − q qᵀ / p        of P = [Q, q; qᵀ, p]
//! ```
//! Rounding errors accumulate over many updates. The owner of the samples recomputes the inverse
//! now and then.
//!
//! Reference: Golub & Van Loan, *Matrix Computations*, 4th ed., section 2.1.4; Csató & Opper,
//! *Sparse on-line Gaussian processes*, Neural Computation 14, 2002, appendix C.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::traits::pulp::Arch;
use faer::{Mat, Par};

use crate::gp::covariance::{NotPositiveDefinite, factor_scratch, factorise};
use crate::gp::vectorise::vectorise;

/// P, with memory for a fixed number of samples.
#[derive(Debug, Clone)]
pub(crate) struct Inverse {
    size: usize,
    stride: usize,
    /// Row by row.
    values: Vec<f64>,
    /// The row that is removed.
    leaving: Vec<f64>,
    machine: Arch,
}

impl Inverse {
    /// The inverse of no samples, with memory for `capacity`.
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            size: 0,
            stride: capacity,
            values: vec![0.0; capacity * capacity],
            leaving: vec![0.0; capacity],
            machine: Arch::new(),
        }
    }

    /// Pᵢᵢ of each sample.
    pub(crate) fn diagonal(&self) -> impl Iterator<Item = f64> + '_ {
        self.rows().enumerate().map(|(place, row)| row[place])
    }

    /// P c. O(n²); does not allocate.
    ///
    /// P is symmetric, so its rows are its columns. Their multiples are added up, and no addition
    /// waits for the one before.
    pub(crate) fn solve(&self, covariances: &[f64], solved: &mut [f64]) {
        solved.fill(0.0);
        vectorise(self.machine, || {
            for (row, covariance) in self.rows().zip(covariances) {
                add(solved, *covariance, row);
            }
        });
    }

    /// Appends a sample: `solved` is P c and `left` is s > 0. O(n²); does not allocate.
    pub(crate) fn insert(&mut self, solved: &[f64], left: f64) {
        let size = self.size;
        vectorise(self.machine, || {
            for (row, &first) in self.values.chunks_exact_mut(self.stride).zip(&solved[..size]) {
                let share = first / left;
                add(row, share, &solved[..size]);
                row[size] = -share;
            }
        });
        let last = &mut self.values[size * self.stride..];
        for (value, solved) in last.iter_mut().zip(&solved[..size]) {
            *value = -solved / left;
        }
        last[size] = 1.0 / left;
        self.size += 1;
    }

    /// Removes the sample at `place`; the later ones move up. O(n²); does not allocate.
    pub(crate) fn remove(&mut self, place: usize) {
        let (size, stride) = (self.size, self.stride);
        self.leaving[..size].copy_from_slice(&self.values[place * stride..place * stride + size]);
        let leaving = &self.leaving[..size];
        vectorise(self.machine, || {
            for (row, &first) in self.values.chunks_exact_mut(stride).zip(leaving) {
                add(row, -first / leaving[place], leaving);
                row.copy_within(place + 1..size, place);
            }
        });
        self.values.copy_within((place + 1) * stride..size * stride, place * stride);
        self.size -= 1;
    }

    /// Recomputes the inverse of `covariance`, noise included. O(n³).
    pub(crate) fn recompute(&mut self, covariance: &Mat<f64>) -> Result<(), NotPositiveDefinite> {
        let size = covariance.ncols();
        let mut factor = Mat::zeros(size, size);
        let mut memory = MemBuffer::new(
            factor_scratch(size).or(llt::inverse::inverse_scratch::<f64>(size, Par::Seq)),
        );
        factorise(covariance, 0.0, &vec![1.0; size], &mut factor, &mut memory)?;
        let mut inverse = Mat::<f64>::zeros(size, size);
        llt::inverse::inverse(
            inverse.as_mut(),
            factor.as_ref(),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        self.size = size;
        for row in 0..size {
            for column in 0..=row {
                // faer does not write the upper half.
                self.values[row * self.stride + column] = inverse[(row, column)];
                self.values[column * self.stride + row] = inverse[(row, column)];
            }
        }
        Ok(())
    }

    fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.stride.max(1)).take(self.size).map(|row| &row[..self.size])
    }
}

/// Adds `share` times `row`, up to the shorter length.
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
fn add(to: &mut [f64], share: f64, row: &[f64]) {
    for (to, value) in to.iter_mut().zip(row) {
        *to += share * value;
    }
}

#[cfg(test)]
mod tests {
    use super::Inverse;
    use faer::Mat;
    use proptest::prelude::*;

    /// Covariance of points on a line, with noise.
    fn covariance(places: &[f64]) -> Mat<f64> {
        Mat::from_fn(places.len(), places.len(), |i, j| {
            (-0.5 * (places[i] - places[j]).powi(2)).exp() + if i == j { 0.01 } else { 0.0 }
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn the_updated_inverse_equals_the_recomputed_one(
            steps in prop::collection::vec((-3.0..3.0_f64, 0.0..1.0_f64), 1..120)
        ) {
            let (mut maintained, mut anew) = (Inverse::new(12), Inverse::new(12));
            let mut places: Vec<f64> = Vec::new();
            for (place, choice) in steps {
                if places.len() == 12 {
                    let out = (choice * 11.9) as usize;
                    places.remove(out);
                    maintained.remove(out);
                }
                let covariance_with = |other: &f64| (-0.5 * (other - place).powi(2)).exp();
                let column: Vec<f64> = places.iter().map(covariance_with).collect();
                let mut solved = vec![0.0; places.len()];
                maintained.solve(&column, &mut solved);
                let left = 1.01 - column.iter().zip(&solved).map(|(a, b)| a * b).sum::<f64>();
                maintained.insert(&solved, left);
                places.push(place);
                prop_assert!(anew.recompute(&covariance(&places)).is_ok());
                for (kept, new) in maintained.rows().flatten().zip(anew.rows().flatten()) {
                    prop_assert!((kept - new).abs() < 1e-7, "{kept} is not {new}");
                }
            }
        }
    }
}
