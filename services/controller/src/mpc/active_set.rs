//! A dual active-set method for strictly convex programs (Goldfarb and Idnani, Mathematical Programming 27, 1983).
//!
//! It begins at the minimum without limits and takes in one violated row after the other, so that it costs next to nothing where few limits
//! bind. Slacks at zero are the one exception: they cost a price as long as nothing asks for them, so their bounds are active at the start.
//!
//! ```text
//! J Jᵀ = H⁻¹      Jᵀ N = (R, 0)ᵀ      N: the active rows' normals, which point inwards, column by column; R upper triangular
//! ```
//! A row p with the normal n is taken in along the step z of the unknowns, while the multipliers of the active rows change by −r:
//!
//! ```text
//! d = Jᵀ n = (d₁, d₂)      z = J₂ d₂      r = R⁻¹ d₁
//! ```
//! as far as the row asks for, or until a multiplier is zero: then that row is let go.

use super::qp::QuadraticProgram;
use super::solver::{Outcome, Status, Turn};
use nalgebra::{DMatrix, DVector};

/// By how much a row may be violated; rows are scaled to bounds of 1.
const VIOLATION: f64 = 1e-9;
/// Share of a normal's square below which what is left of it beside the active rows is rounding.
const DEPENDENT: f64 = 1e-16;
/// What counts as a multiplier that grows smaller, per unit of the new row's.
const RELEASE: f64 = 1e-12;
/// Most rows that are taken in or let go, in multiples of the number of unknowns and rows: a handful of steps is usual, and of 60 000 random programs
/// that were hard on it none took more than 0.81 times that number.
const STEPS_MOST: usize = 2;

/// The method with all its memory: set up once, then in place.
pub struct ActiveSet {
    /// U of H = UᵀU, of the part without slacks.
    factor: DMatrix<f64>,
    /// J, the active rows' part first.
    basis: DMatrix<f64>,
    /// Whether U and J are those of a program that has not been solved yet.
    prepared: bool,
    /// R.
    triangle: DMatrix<f64>,
    /// Active rows, in the order of R's columns, and their multipliers.
    active: Vec<usize>,
    multipliers: Vec<f64>,
    is_active: Vec<bool>,
    x: DVector<f64>,
    /// b − G x.
    distance: DVector<f64>,
    /// n, d, z and r of the row that is taken in.
    normal: DVector<f64>,
    image: DVector<f64>,
    step: DVector<f64>,
    release: DVector<f64>,
}

/// What a step towards a row came to.
enum Step {
    /// The row is active.
    TakenIn,
    /// An active row was let go on the way.
    LetGo,
    /// No step leads there.
    Impossible,
}

impl ActiveSet {
    /// Makes room for programs of the shape of `program`.
    pub fn new(program: &QuadraticProgram) -> Self {
        let (unknowns, rows) = (program.variables(), program.bounds.len());
        let dense = unknowns - program.slack_rows().len();
        Self {
            factor: DMatrix::zeros(dense, dense),
            basis: DMatrix::zeros(unknowns, unknowns),
            prepared: false,
            triangle: DMatrix::zeros(unknowns, unknowns),
            active: Vec::with_capacity(unknowns),
            multipliers: Vec::with_capacity(unknowns),
            is_active: vec![false; rows],
            x: DVector::zeros(unknowns),
            distance: DVector::zeros(rows),
            normal: DVector::zeros(unknowns),
            image: DVector::zeros(unknowns),
            step: DVector::zeros(unknowns),
            release: DVector::zeros(unknowns),
        }
    }

    /// Solves `program`, and writes the answer to `solution` if there is one. Does not allocate.
    pub fn solve(&mut self, program: &QuadraticProgram, solution: &mut [f64], turn: &Turn) -> Outcome {
        self.prepare(program);
        self.finish(program, solution, turn)
    }

    /// What there is to do before gradient and bounds are known. Does not allocate.
    pub fn prepare(&mut self, program: &QuadraticProgram) {
        self.prepared = self.factorise(program);
        if self.prepared {
            self.invert(program);
        }
    }

    /// Solves the program that was [prepared](Self::prepare), as often as that. Does not allocate.
    pub fn finish(&mut self, program: &QuadraticProgram, solution: &mut [f64], turn: &Turn) -> Outcome {
        let mut iterations = 0;
        let status = if turn.is_over() { Status::OutOfTime } else { self.climb(program, turn, &mut iterations) };
        if status == Status::Solved {
            solution.copy_from_slice(self.x.as_slice());
        }
        Outcome { status, iterations }
    }

    /// Takes in what is violated, row by row, until nothing is.
    fn climb(&mut self, program: &QuadraticProgram, turn: &Turn, iterations: &mut u32) -> Status {
        if !(std::mem::take(&mut self.prepared) && self.begin(program)) {
            return Status::Failed;
        }
        while let Some(row) = self.most_violated(program) {
            let mut multiplier = 0.0;
            loop {
                *iterations += 1;
                if *iterations as usize > STEPS_MOST * (self.x.len() + self.is_active.len()) {
                    return Status::OutOfIterations;
                }
                if turn.is_over() {
                    return Status::OutOfTime;
                }
                match self.approach(program, row, &mut multiplier) {
                    Step::TakenIn => break,
                    Step::LetGo => {}
                    Step::Impossible => return Status::Infeasible,
                }
            }
        }
        if self.x.iter().all(|value| value.is_finite()) { Status::Solved } else { Status::Failed }
    }

    /// H = UᵀU of the part without slacks. `false` if H is not positive definite.
    fn factorise(&mut self, program: &QuadraticProgram) -> bool {
        for column in 0..self.factor.ncols() {
            for row in 0..=column {
                let known = self.factor.column(row).rows(0, row).dot(&self.factor.column(column).rows(0, row));
                let rest = program.hessian[(row, column)] - known;
                self.factor[(row, column)] = if row < column { rest / self.factor[(row, row)] } else { rest.sqrt() };
            }
            // Neither zero nor the root of a negative number.
            if !self.factor[(column, column)].is_normal() {
                return false;
            }
        }
        true
    }

    /// J for the slacks' rows alone.
    fn invert(&mut self, program: &QuadraticProgram) {
        let (dense, slacks) = (self.factor.ncols(), program.slack_rows().len());
        self.basis.as_mut_slice().fill(0.0);
        for slack in 0..slacks {
            let unknown = dense + slack;
            self.basis[(unknown, slack)] = 1.0 / program.hessian[(unknown, unknown)].sqrt();
        }
        for column in 0..dense {
            let mut inverse = self.basis.column_mut(slacks + column);
            inverse[column] = 1.0;
            for row in (0..=column).rev() {
                inverse[row] /= self.factor[(row, row)];
                let value = inverse[row];
                inverse.rows_mut(0, row).axpy(-value, &self.factor.column(row).rows(0, row), 1.0);
            }
        }
    }

    /// The minimum without rows, but with every slack at its bound. `false` if a slack costs nothing.
    fn begin(&mut self, program: &QuadraticProgram) -> bool {
        let (dense, slacks) = (self.factor.ncols(), program.slack_rows().len());
        self.active.clear();
        self.multipliers.clear();
        self.is_active.fill(false);
        for (slack, &row) in program.slack_rows().iter().enumerate() {
            let unknown = dense + slack;
            let (inwards, curvature) = (-program.rows[(row, unknown)], program.hessian[(unknown, unknown)]);
            self.x[unknown] = -program.bounds[row] / inwards;
            let multiplier = (program.gradient[unknown] + curvature * self.x[unknown]) / inwards;
            if !(curvature > 0.0 && multiplier >= 0.0) {
                return false;
            }
            self.triangle.column_mut(slack).fill(0.0);
            self.triangle[(slack, slack)] = inwards / curvature.sqrt();
            self.active.push(row);
            self.multipliers.push(multiplier);
            self.is_active[row] = true;
        }
        let inverse = self.basis.view((0, slacks), (dense, dense));
        let mut image = self.image.rows_mut(0, dense);
        for (image, column) in image.iter_mut().zip(inverse.column_iter()) {
            *image = column.iter().zip(&program.gradient).map(|(entry, slope)| entry * slope).sum();
        }
        self.x.rows_mut(0, dense).gemv(-1.0, &inverse, &image, 0.0);
        true
    }

    /// The row that is violated most, if one is.
    fn most_violated(&mut self, program: &QuadraticProgram) -> Option<usize> {
        let (mut worst, mut least) = (None, -VIOLATION);
        for (row, (distance, active)) in self.distance.iter_mut().zip(&self.is_active).enumerate() {
            *distance = program.rows.taken_off(row, self.x.as_slice(), program.bounds[row]);
            if *distance < least && !active {
                (worst, least) = (Some(row), *distance);
            }
        }
        worst
    }

    /// Goes towards the bound of `row`, whose multiplier so far is `multiplier`.
    fn approach(&mut self, program: &QuadraticProgram, row: usize, multiplier: &mut f64) -> Step {
        let (unknowns, held) = (self.x.len(), self.active.len());
        self.normal.fill(0.0);
        for (column, coefficient) in program.rows.row(row) {
            self.normal[column] = -coefficient;
        }
        self.image.gemv_tr(1.0, &self.basis, &self.normal, 0.0);
        let free = self.image.rows(held, unknowns - held);
        let square = free.norm_squared();
        self.step.gemv(1.0, &self.basis.columns(held, unknowns - held), &free, 0.0);
        self.release.copy_from(&self.image);
        for column in (0..held).rev() {
            self.release[column] /= self.triangle[(column, column)];
            let value = self.release[column];
            self.release.rows_mut(0, column).axpy(-value, &self.triangle.column(column).rows(0, column), 1.0);
        }
        let (mut first, mut until_released) = (None, f64::INFINITY);
        for (place, (held, release)) in self.multipliers.iter().zip(self.release.iter()).enumerate() {
            if *release > RELEASE && held / release < until_released {
                (first, until_released) = (Some(place), held / release);
            }
        }
        let independent = square > DEPENDENT * self.image.norm_squared();
        let until_reached = if independent { -self.distance[row] / square } else { f64::INFINITY };
        let length = until_reached.min(until_released);
        if !length.is_finite() {
            return Step::Impossible;
        }
        for (held, release) in self.multipliers.iter_mut().zip(self.release.iter()) {
            *held -= length * release;
        }
        *multiplier += length;
        if independent {
            self.x.axpy(length, &self.step, 1.0);
            self.distance[row] += length * square;
        }
        match first {
            Some(place) if until_released < until_reached => {
                self.let_go(place);
                Step::LetGo
            }
            _ => {
                self.take_in(row, *multiplier, square);
                Step::TakenIn
            }
        }
    }

    /// Makes `row` active. A Householder reflection H₂ of J₂ turns d₂ into δ e₁, the end of R's new column.
    ///
    /// ```text
    /// v = d₂ − δ e₁,  δ = ∓|d₂|      J₂ H₂ = J₂ − 2/(vᵀv) J₂v vᵀ,  J₂ v = z − δ J₂ e₁
    /// ```
    fn take_in(&mut self, row: usize, multiplier: f64, square: f64) {
        let held = self.active.len();
        let free = self.x.len() - held;
        let end = -square.sqrt().copysign(self.image[held]);
        let mut column = self.triangle.column_mut(held);
        column.fill(0.0);
        column.rows_mut(0, held).copy_from(&self.image.rows(0, held));
        column[held] = end;
        let length = square - end * self.image[held];
        self.image[held] -= end;
        self.step.axpy(-end, &self.basis.column(held), 1.0);
        self.basis.columns_mut(held, free).ger(-1.0 / length, &self.step, &self.image.rows(held, free), 1.0);
        self.active.push(row);
        self.multipliers.push(multiplier);
        self.is_active[row] = true;
    }

    /// Lets the active row at `place` go. Givens rotations make R triangular again.
    fn let_go(&mut self, place: usize) {
        let kept = self.active.len() - 1;
        let row = self.active.remove(place);
        self.multipliers.remove(place);
        self.is_active[row] = false;
        for column in place..kept {
            self.triangle.swap_columns(column, column + 1);
        }
        for column in place..kept {
            let (above, below) = (self.triangle[(column, column)], self.triangle[(column + 1, column)]);
            let length = above.hypot(below);
            let (cos, sin) = (above / length, below / length);
            for other in column..kept {
                let (above, below) = (self.triangle[(column, other)], self.triangle[(column + 1, other)]);
                self.triangle[(column, other)] = cos * above + sin * below;
                self.triangle[(column + 1, other)] = cos * below - sin * above;
            }
            for row in 0..self.x.len() {
                let (left, right) = (self.basis[(row, column)], self.basis[(row, column + 1)]);
                self.basis[(row, column)] = cos * left + sin * right;
                self.basis[(row, column + 1)] = cos * right - sin * left;
            }
        }
    }
}

#[cfg(test)]
mod tests;
