//! The solver's decorator in drills: a fault in place of its answer.

use super::solver::{Outcome, Status, Turn};
use crate::settings::{SolverFaultKind, SolverFaults};

/// Distance of an injected wrong answer from the limits; rows are scaled to bounds of 1.
const FAR_OUTSIDE: f64 = 1e3;

impl SolverFaults {
    /// The outcome and the `solution` of the fault that happens in this turn, if one does.
    pub(crate) fn in_place_of_answer(&self, turn: &Turn, solution: &mut [f64]) -> Option<Outcome> {
        let (kind, mut random) = self.strike(turn.tick?)?;
        let status = match kind {
            SolverFaultKind::Infeasible => Status::Infeasible,
            SolverFaultKind::OutOfIterations => Status::OutOfIterations,
            SolverFaultKind::Nan => {
                solution.fill(f64::NAN);
                Status::Solved
            }
            SolverFaultKind::Wrong => {
                // The first unknown is an input, whose limit no slack relaxes.
                for value in &mut *solution {
                    *value = random.normal();
                }
                if let Some(first) = solution.first_mut() {
                    *first = FAR_OUTSIDE.copysign(*first);
                }
                Status::Solved
            }
        };
        Some(Outcome { status, iterations: 0 })
    }
}
