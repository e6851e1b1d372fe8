//! A convex quadratic program of fixed shape.
//!
//! ```text
//! min ½ xᵀ H x + hᵀ x    subject to   G x ≤ b
//! ```
//! x holds the changes of the free inputs first, then one slack per period. H is kept as its upper triangle.
//!
//! A program may be written before all is known that it depends on. h and b are then linear in what is still to come, the surprise s:
//!
//! ```text
//! h = h₀ + P s      b = b₀ − Q s
//! ```

use super::rows::Rows;
use nalgebra::{DMatrix, SMatrix, SVector};

/// The program's numbers and the places that may be other than zero.
pub struct QuadraticProgram {
    /// Upper triangle of H.
    pub hessian: DMatrix<f64>,
    /// h.
    pub gradient: Vec<f64>,
    /// G.
    pub rows: Rows,
    /// b.
    pub bounds: Vec<f64>,
    /// Places of G that may be other than zero (row, column), column by column.
    structure: Vec<(usize, usize)>,
    /// Rows that are the lower bounds of the slacks, in the order of these.
    slack_rows: Vec<usize>,
    /// P.
    gradient_by_surprise: DMatrix<f64>,
    /// Q.
    rows_by_surprise: DMatrix<f64>,
}

impl QuadraticProgram {
    /// A program of `variables` unknowns and `rows` inequalities, all zero and without structure.
    pub fn new(variables: usize, rows: usize) -> Self {
        Self {
            hessian: DMatrix::zeros(variables, variables),
            gradient: vec![0.0; variables],
            rows: Rows::zeros(rows, variables),
            bounds: vec![0.0; rows],
            structure: Vec::new(),
            slack_rows: Vec::new(),
            gradient_by_surprise: DMatrix::zeros(variables, 0),
            rows_by_surprise: DMatrix::zeros(rows, 0),
        }
    }

    /// Makes room for a surprise of so many numbers.
    pub fn expect_surprise(&mut self, numbers: usize) {
        self.gradient_by_surprise = DMatrix::zeros(self.variables(), numbers);
        self.rows_by_surprise = DMatrix::zeros(self.bounds.len(), numbers);
    }

    /// Number of unknowns.
    pub fn variables(&self) -> usize {
        self.gradient.len()
    }

    /// Places of G that may be other than zero, column by column.
    pub fn structure(&self) -> &[(usize, usize)] {
        &self.structure
    }

    /// Says once which places of G may be other than zero.
    pub fn set_structure(&mut self, mut places: Vec<(usize, usize)>) {
        places.sort_unstable_by_key(|&(row, column)| (column, row));
        places.dedup();
        self.rows.set_structure(&places);
        self.structure = places;
    }

    /// Rows that are the lower bounds of the slacks, in the order of these.
    pub fn slack_rows(&self) -> &[usize] {
        &self.slack_rows
    }

    /// Says once that the last unknowns are slacks: in H each stands alone, and costs something from its lower bound, one of `rows`, on.
    pub fn set_slack_rows(&mut self, rows: Vec<usize>) {
        self.slack_rows = rows;
    }

    /// Sets all numbers to zero.
    pub fn clear(&mut self) {
        self.hessian.as_mut_slice().fill(0.0);
        self.gradient.fill(0.0);
        self.rows.clear();
        self.bounds.fill(0.0);
        self.gradient_by_surprise.as_mut_slice().fill(0.0);
        self.rows_by_surprise.as_mut_slice().fill(0.0);
    }

    /// What was still to come has come: h and b are now what they are for this surprise.
    pub fn take_in(&mut self, surprise: &[f64]) {
        for (at, &number) in surprise.iter().enumerate().filter(|(_, number)| **number != 0.0) {
            for (slope, by) in self.gradient.iter_mut().zip(self.gradient_by_surprise.column(at).iter()) {
                *slope += by * number;
            }
            for (bound, by) in self.bounds.iter_mut().zip(self.rows_by_surprise.column(at).iter()) {
                *bound -= by * number;
            }
        }
    }

    /// Adds a block to the upper triangle of H, `row` ≤ `column`.
    pub fn add_hessian(&mut self, row: usize, column: usize, block: &SMatrix<f64, 3, 3>) {
        let mut place = self.hessian.fixed_view_mut::<3, 3>(row, column);
        place += block;
    }

    /// Adds a block to P.
    pub fn add_gradient_by_surprise(&mut self, row: usize, number: usize, block: &SMatrix<f64, 3, 3>) {
        let mut place = self.gradient_by_surprise.fixed_view_mut::<3, 3>(row, number);
        place += block;
    }

    /// Adds three coefficients to a row of Q.
    pub fn put_row_by_surprise(&mut self, row: usize, number: usize, coefficients: &[f64; 3]) {
        for (offset, value) in coefficients.iter().enumerate() {
            self.rows_by_surprise[(row, number + offset)] += value;
        }
    }

    /// Adds three entries to h.
    pub fn add_gradient(&mut self, at: usize, entries: &SVector<f64, 3>) {
        for (slot, entry) in self.gradient.iter_mut().skip(at).zip(entries.iter()) {
            *slot += entry;
        }
    }

    /// Adds ½ weight (value + `x_at`)².
    pub fn add_square(&mut self, at: usize, weight: f64, value: f64) {
        self.hessian[(at, at)] += weight;
        self.add_linear(at, weight * value);
    }

    /// Turns ½ weight (value + `x_to`)² into ½ weight (value + `x_to` − `x_from`)², `from` < `to`.
    pub fn add_difference(&mut self, from: usize, to: usize, weight: f64, value: f64) {
        self.hessian[(from, from)] += weight;
        self.hessian[(from, to)] -= weight;
        self.add_linear(from, -weight * value);
    }

    /// Adds slope `x_at`.
    pub fn add_linear(&mut self, at: usize, slope: f64) {
        if let Some(entry) = self.gradient.get_mut(at) {
            *entry += slope;
        }
    }

    /// Whether `x` keeps every inequality to within `tolerance`, and is finite.
    pub fn satisfied_by(&self, x: &[f64], tolerance: f64) -> bool {
        if x.len() != self.variables() || x.iter().any(|value| !value.is_finite()) {
            return false;
        }
        self.bounds.iter().enumerate().all(|(row, &bound)| self.rows.taken_off(row, x, bound) >= -tolerance * (1.0 + bound.abs()))
    }
}
