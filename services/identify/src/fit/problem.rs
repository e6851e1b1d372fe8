//! A fit as a problem of the crate `levenberg-marquardt`.

use super::Fit;
use crate::parameter::Parameter;
use crate::response::Response;
use levenberg_marquardt::LeastSquaresProblem;
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn};
use std::thread;

/// Change of a free number for a derivative: residuals have about twelve exact digits.
const STEP: f64 = 1e-6;

/// The free numbers of `parameters`, near the response `base`.
#[derive(Clone)]
pub(super) struct Problem<'a> {
    fit: &'a Fit<'a>,
    parameters: &'a [Parameter],
    base: Response,
    free: DVector<f64>,
}

impl<'a> Problem<'a> {
    pub(super) fn new(fit: &'a Fit<'a>, base: &Response, parameters: &'a [Parameter]) -> Self {
        let free = parameters.iter().map(|parameter| parameter.free(base));
        let free = DVector::from_iterator(parameters.len(), free);
        Self { fit, parameters, base: *base, free }
    }

    pub(super) fn response(&self) -> Response {
        self.response_at(&self.free)
    }

    fn response_at(&self, free: &DVector<f64>) -> Response {
        let mut response = self.base;
        for (parameter, &value) in self.parameters.iter().zip(free.iter()) {
            parameter.set(&mut response, value);
        }
        response
    }

    /// Derivatives of the residuals by the free numbers, by differences.
    pub(super) fn derivatives(&self) -> DMatrix<f64> {
        let here = self.fit.residuals(&self.response());
        let here = &here;
        let column = |index: usize| {
            let mut free = self.free.clone();
            free[index] += STEP;
            (self.fit.residuals(&self.response_at(&free)) - here) / STEP
        };
        let count = self.parameters.len();
        let threads = thread::available_parallelism().map_or(1, usize::from).min(count.max(1));
        let columns: Vec<Vec<DVector<f64>>> = thread::scope(|scope| {
            let parts: Vec<_> = (0..threads)
                .map(|part| {
                    scope.spawn(move || (part..count).step_by(threads).map(column).collect())
                })
                .collect();
            parts.into_iter().map(|part| part.join().unwrap_or_default()).collect()
        });
        let rows = columns.iter().flatten().map(DVector::len).max().unwrap_or(0);
        let mut matrix = DMatrix::zeros(rows, count);
        for (part, columns) in columns.iter().enumerate() {
            for (number, column) in columns.iter().enumerate() {
                matrix.set_column(part + number * threads, column);
            }
        }
        matrix
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, free: &DVector<f64>) {
        self.free.copy_from(free);
    }

    fn params(&self) -> DVector<f64> {
        self.free.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        Some(self.fit.residuals(&self.response()))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        Some(self.derivatives())
    }
}
