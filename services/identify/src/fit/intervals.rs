//! How far the parameters of a fit may be off.

use super::Fit;
use super::problem::Problem;
use crate::parameter::Parameter;
use crate::response::Response;
use nalgebra::{DMatrix, DVector};
use robot::AXES;

/// Half width of a 95 % interval of independent errors, in standard deviations.
const WIDTH_95: f64 = 1.96;

impl Fit<'_> {
    /// Covariance of `parameters`, so scaled that its diagonal has the squares of half of their
    /// 95 % intervals. What the data do not tell is infinite there.
    pub(super) fn covariance(
        &self,
        response: &Response,
        parameters: &[Parameter],
        lags: usize,
    ) -> DMatrix<f64> {
        let jacobian = Problem::new(self, response, parameters).derivatives();
        // A parameter without any effect has no interval, and must not spoil the others'.
        let live: Vec<usize> =
            (0..parameters.len()).filter(|&index| jacobian.column(index).norm() > 0.0).collect();
        let residuals = self.residuals(response);
        let free = self.free_covariance(&jacobian.select_columns(&live), &residuals, lags);
        let mut covariance = DMatrix::zeros(parameters.len(), parameters.len());
        covariance.fill_diagonal(f64::INFINITY);
        let Some(free) = free else { return covariance };
        let slope = |index: usize| parameters[index].slope(response);
        for (row, &to) in live.iter().enumerate() {
            // A variance that is none is one that the data do not tell.
            if free[(row, row)] > 0.0 {
                for (column, &other) in live.iter().enumerate() {
                    covariance[(to, other)] = free[(row, column)] * slope(to) * slope(other);
                }
            }
        }
        covariance
    }

    /// The same of the free numbers. None if their effects cannot be told apart.
    fn free_covariance(
        &self,
        jacobian: &DMatrix<f64>,
        residuals: &DVector<f64>,
        lags: usize,
    ) -> Option<DMatrix<f64>> {
        let count = jacobian.ncols();
        // The last row is that of the prior.
        let last = residuals.len() - 1;
        let periods = last / AXES;
        // g_k, one row per period.
        let mut gradients = DMatrix::zeros(periods, count);
        for period in 0..periods {
            for axis in 0..AXES {
                let row = period * AXES + axis;
                for column in 0..count {
                    gradients[(period, column)] += jacobian[(row, column)] * residuals[row];
                }
            }
        }
        let mut middle = gradients.tr_mul(&gradients);
        for lag in 1..=lags.min(periods.saturating_sub(1)) {
            let weight = 1.0 - lag as f64 / (lags + 1) as f64;
            let early = gradients.rows(0, periods - lag);
            let late = gradients.rows(lag, periods - lag);
            let product = early.tr_mul(&late);
            middle += weight * (&product + product.transpose());
        }
        let prior = jacobian.row(last);
        middle += self.correlated * prior.tr_mul(&prior);
        // In units of each column, so that the inverse is well conditioned.
        let norms: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let mut scaled = jacobian.clone();
        for (mut column, norm) in scaled.column_iter_mut().zip(&norms) {
            column /= *norm;
        }
        let inverse = scaled.tr_mul(&scaled).try_inverse()?;
        for row in 0..count {
            for column in 0..count {
                middle[(row, column)] /= norms[row] * norms[column];
            }
        }
        let mut covariance = &inverse * middle * &inverse;
        let independent = last as f64 / self.correlated;
        let enlarged = independent / (independent - count as f64).max(1.0);
        let bandwidth = lags as f64 / periods.max(1) as f64;
        let quantile = WIDTH_95 + 2.97 * bandwidth;
        for row in 0..count {
            for column in 0..count {
                covariance[(row, column)] *=
                    enlarged * quantile * quantile / (norms[row] * norms[column]);
            }
        }
        Some(covariance)
    }
}
