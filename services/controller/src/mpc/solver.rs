//! The solver of the quadratic program, its deadline, and its outcome.

use super::active_set::ActiveSet;
use super::interior_point::{Clarabel, SolverError};
use super::qp::QuadraticProgram;
#[cfg(feature = "faults")]
use crate::settings::SolverFaults;
use crate::settings::SolverSetting;
use protocol::clock::monotonic_nanos;
use protocol::message::SolverStatus as Code;

/// Tick and deadline of a requested answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Turn {
    /// The tick; `None` for a rehearsal, in which no fault happens.
    pub tick: Option<u64>,
    /// Deadline on the monotonic clock; `None` reads no clock \[ns\].
    pub until: Option<u64>,
}

impl Turn {
    /// Whether the deadline has passed.
    pub fn is_over(&self) -> bool {
        self.until.is_some_and(|until| monotonic_nanos() >= until)
    }
}

/// Result of one program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Optimal within tolerance.
    Solved,
    /// Optimal within a relaxed tolerance.
    AlmostSolved,
    /// Out of iterations.
    OutOfIterations,
    /// Out of time.
    OutOfTime,
    /// No input satisfies the limits.
    Infeasible,
    /// Numerical trouble.
    Failed,
    /// The plan behind the program is not finite: the model returns NaN or infinity.
    Unpredictable,
    /// Reported as solved, but not finite or outside the limits.
    Wrong,
}

/// Answer of the solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outcome {
    /// Status of the program.
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
            Status::OutOfIterations | Status::OutOfTime => Code::OutOfIterations,
            Status::Infeasible => Code::Infeasible,
            Status::Failed | Status::Wrong | Status::Unpredictable => Code::NumericalError,
        }
    }
}

/// The configured method. If the active-set method has no answer, Clarabel solves the program.
pub struct Solver {
    pub(super) active_set: Option<ActiveSet>,
    clarabel: Clarabel,
    #[cfg(feature = "faults")]
    faults: SolverFaults,
}

impl Solver {
    /// Sets up both methods for programs of the structure of `program`.
    ///
    /// # Errors
    /// [`SolverError`] if Clarabel refuses the structure.
    pub fn new(setting: SolverSetting, program: &QuadraticProgram) -> Result<Self, SolverError> {
        let active_set = (setting == SolverSetting::ActiveSet).then(|| ActiveSet::new(program));
        Ok(Self {
            active_set,
            clarabel: Clarabel::new(program)?,
            #[cfg(feature = "faults")]
            faults: SolverFaults::default(),
        })
    }

    /// Injects these faults from now on.
    #[cfg(feature = "faults")]
    pub fn inject(&mut self, faults: SolverFaults) {
        self.faults = faults;
    }

    /// Solves `program`, and writes the answer to `solution` if there is a usable one.
    pub fn solve(
        &mut self,
        program: &QuadraticProgram,
        solution: &mut [f64],
        turn: &Turn,
    ) -> Outcome {
        self.prepare(program);
        self.finish(program, solution, turn)
    }

    /// Does the work that needs no gradient or bounds of `program`.
    pub fn prepare(&mut self, program: &QuadraticProgram) {
        if let Some(method) = &mut self.active_set {
            method.prepare(program);
        }
    }

    /// Solves the [prepared](Self::prepare) program.
    pub fn finish(
        &mut self,
        program: &QuadraticProgram,
        solution: &mut [f64],
        turn: &Turn,
    ) -> Outcome {
        #[cfg(feature = "faults")]
        if let Some(outcome) = self.faults.in_place_of_answer(turn, solution) {
            return outcome;
        }
        let answer = self.active_set.as_mut().map(|method| method.finish(program, solution, turn));
        match answer {
            Some(outcome) if outcome.usable() || outcome.status == Status::OutOfTime => outcome,
            _ => self.clarabel.solve(program, solution, turn),
        }
    }
}
