//! Who solves the quadratic program, and what comes of it.

use super::active_set::ActiveSet;
use super::interior_point::{Clarabel, SolverError};
use super::qp::QuadraticProgram;
use crate::settings::SolverSetting;
use protocol::message::SolverStatus as Code;

/// What became of one program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Optimal within tolerance.
    Solved,
    /// Optimal within a relaxed tolerance.
    AlmostSolved,
    /// Out of iterations.
    OutOfIterations,
    /// No input satisfies the limits.
    Infeasible,
    /// Numerical trouble.
    Failed,
    /// The plan that the program is about is not finite: the model says nonsense.
    Unpredictable,
    /// Said to be solved, but not finite or outside the limits.
    Wrong,
}

/// What the solver said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outcome {
    /// What became of the program.
    pub status: Status,
    /// Iterations taken.
    pub iterations: u32,
}

impl Outcome {
    /// Whether the answer may be commanded.
    pub fn usable(&self) -> bool {
        matches!(self.status, Status::Solved | Status::AlmostSolved)
    }

    /// The code for a [`Plan`](protocol::message::Plan).
    pub fn code(&self) -> Code {
        match self.status {
            Status::Solved => Code::Solved,
            Status::AlmostSolved => Code::AlmostSolved,
            Status::OutOfIterations => Code::OutOfIterations,
            Status::Infeasible => Code::Infeasible,
            Status::Failed | Status::Wrong | Status::Unpredictable => Code::NumericalError,
        }
    }
}

/// The method that was asked for; behind the active-set method stands Clarabel, for whatever it cannot answer.
pub struct Solver {
    active_set: Option<ActiveSet>,
    clarabel: Clarabel,
}

impl Solver {
    /// Sets both up for programs of the structure of `program`.
    ///
    /// # Errors
    /// [`SolverError`] if Clarabel refuses it.
    pub fn new(setting: SolverSetting, program: &QuadraticProgram) -> Result<Self, SolverError> {
        let active_set = (setting == SolverSetting::ActiveSet).then(|| ActiveSet::new(program));
        Ok(Self { active_set, clarabel: Clarabel::new(program)? })
    }

    /// Solves `program`, and writes the answer to `solution` if there is a usable one.
    pub fn solve(&mut self, program: &QuadraticProgram, solution: &mut [f64]) -> Outcome {
        let answer = self.active_set.as_mut().map(|method| method.solve(program, solution));
        match answer {
            Some(outcome) if outcome.usable() => outcome,
            _ => self.clarabel.solve(program, solution),
        }
    }
}
