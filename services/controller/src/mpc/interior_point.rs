//! Clarabel, an interior-point method, on a program of fixed sparsity: set up once, then only values change.
//!
//! The rows are scaled to bounds of 1, so the solver's own equilibration is off. The budget is iterations, and in real time a deadline.

use super::qp::QuadraticProgram;
use super::solver::{Outcome, Status, Turn};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Most iterations of the interior-point method: 8 to 15 are usual.
const ITERATIONS_MAX: u32 = 50;
/// Gap at which an answer counts as solved. The cost is flat: a gap of ε leaves at most √(2ε/0.25) of doubt in an input whose
/// curvature is the usual 0.25, here 3e-5 m/s.
const GAP: f64 = 1e-10;
/// Residual at which the limits count as kept.
const RESIDUAL: f64 = 1e-9;

/// Clarabel refused the problem's structure.
#[derive(Debug, thiserror::Error)]
#[error("the quadratic program of {variables} unknowns and {rows} rows was refused by the solver: {reason}")]
pub struct SolverError {
    variables: usize,
    rows: usize,
    reason: String,
}

/// No deadline.
const NEVER: u64 = u64::MAX;

/// The solver and the values that it is given.
pub struct Clarabel {
    solver: DefaultSolver<f64>,
    /// Upper triangle of H, column by column.
    hessian: Vec<f64>,
    /// G at its structure, column by column.
    rows: Vec<f64>,
    /// When the solver is to stop, which it looks at in every iteration, on the monotonic clock \[ns\].
    until: Arc<AtomicU64>,
}

impl Clarabel {
    /// Sets the solver up for programs of the structure of `program`.
    ///
    /// # Errors
    /// [`SolverError`] if the solver refuses it.
    pub fn new(program: &QuadraticProgram) -> Result<Self, SolverError> {
        let (variables, row_count) = (program.variables(), program.bounds.len());
        let refused = |reason: String| SolverError { variables, rows: row_count, reason };
        let upper: Vec<(usize, usize)> = (0..variables).flat_map(|column| (0..=column).map(move |row| (row, column))).collect();
        let hessian: Vec<f64> = upper.iter().map(|(row, column)| if row == column { 1.0 } else { 0.0 }).collect();
        let rows = vec![1.0; program.structure().len()];
        let settings = DefaultSettingsBuilder::default()
            .verbose(false)
            .max_iter(ITERATIONS_MAX)
            .max_threads(1)
            .tol_gap_abs(GAP)
            .tol_gap_rel(GAP)
            .tol_feas(RESIDUAL)
            .equilibrate_enable(false)
            .presolve_enable(false)
            .input_sparse_dropzeros(false)
            .direct_solve_method("qdldl".to_owned())
            .build()
            .map_err(|e| refused(e.to_string()))?;
        let mut solver = DefaultSolver::new(
            &csc(variables, variables, &upper, &hessian),
            &program.gradient,
            &csc(row_count, variables, program.structure(), &rows),
            &vec![1.0; row_count],
            &[NonnegativeConeT(row_count)],
            settings,
        )
        .map_err(|e| refused(e.to_string()))?;
        let until = Arc::new(AtomicU64::new(NEVER));
        let deadline = Arc::clone(&until);
        solver.set_termination_callback(move |_| {
            let until = deadline.load(Ordering::Relaxed);
            Turn { tick: None, until: (until != NEVER).then_some(until) }.is_over()
        });
        Ok(Self { solver, hessian, rows, until })
    }

    /// Solves `program`, and writes the answer to `solution` if there is a usable one.
    pub fn solve(&mut self, program: &QuadraticProgram, solution: &mut [f64], turn: &Turn) -> Outcome {
        self.until.store(turn.until.unwrap_or(NEVER), Ordering::Relaxed);
        let columns = program.variables();
        let upper = (0..columns).flat_map(|column| (0..=column).map(move |row| (row, column)));
        for (value, (row, column)) in self.hessian.iter_mut().zip(upper) {
            *value = program.hessian[(row, column)];
        }
        for (value, &place) in self.rows.iter_mut().zip(program.structure()) {
            *value = program.rows[place];
        }
        let updated = self
            .solver
            .update_P(&self.hessian)
            .and_then(|()| self.solver.update_q(&program.gradient))
            .and_then(|()| self.solver.update_A(&self.rows))
            .and_then(|()| self.solver.update_b(&program.bounds));
        if updated.is_err() {
            return Outcome { status: Status::Failed, iterations: 0 };
        }
        self.solver.solve();
        let answer = &self.solver.solution;
        let status = match answer.status {
            SolverStatus::Solved => Status::Solved,
            SolverStatus::AlmostSolved => Status::AlmostSolved,
            SolverStatus::MaxIterations => Status::OutOfIterations,
            SolverStatus::MaxTime | SolverStatus::CallbackTerminated => Status::OutOfTime,
            SolverStatus::PrimalInfeasible
            | SolverStatus::DualInfeasible
            | SolverStatus::AlmostPrimalInfeasible
            | SolverStatus::AlmostDualInfeasible => Status::Infeasible,
            _ => Status::Failed,
        };
        let outcome = Outcome { status, iterations: answer.iterations };
        if outcome.usable() {
            solution.copy_from_slice(&answer.x);
        }
        outcome
    }
}

/// A matrix with the given places, which are sorted column by column.
fn csc(rows: usize, columns: usize, places: &[(usize, usize)], values: &[f64]) -> CscMatrix<f64> {
    let mut starts = vec![0; columns + 1];
    for &(_, column) in places {
        for start in starts.iter_mut().skip(column + 1) {
            *start += 1;
        }
    }
    CscMatrix::new(rows, columns, starts, places.iter().map(|&(row, _)| row).collect(), values.to_vec())
}
