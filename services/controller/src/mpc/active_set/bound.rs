//! Bounds that can be active, and slacks.

use super::super::qp::QuadraticProgram;

/// A bound that can be active.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Bound {
    /// A row, from above (0) or from below (1).
    Row(usize, usize),
    /// s ≥ 0 of a slack.
    Slack(usize),
}

/// A slack's state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slack {
    /// At zero from the start.
    Held,
    /// It has this entry of v.
    Free(usize),
}

impl Bound {
    /// Its distance where everything is zero.
    pub(super) fn room(self, program: &QuadraticProgram) -> f64 {
        match self {
            Self::Row(row, side) => program.rows[row].bounds[side],
            Self::Slack(_) => 0.0,
        }
    }

    /// The slack that it refers to, if there is one.
    pub(super) fn slack(self, program: &QuadraticProgram) -> Option<usize> {
        match self {
            Self::Row(row, _) => program.rows[row].slack,
            Self::Slack(slack) => Some(slack),
        }
    }
}

/// Entry of J for a slack: the factor from its entry of v to the slack.
pub(super) fn entry_of_slack(program: &QuadraticProgram) -> f64 {
    1.0 / program.penalties.slack_curvature.sqrt()
}
