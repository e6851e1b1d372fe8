//! The start from the active bounds of the last program.

use super::orthogonal::DEPENDENT;
use super::{ActiveSet, Bound, Slack, entry_of_slack};
use crate::mpc::qp::QuadraticProgram;

impl ActiveSet {
    /// Remembers the active bounds and the free slacks for the next program.
    pub(super) fn remember(&mut self, program: &QuadraticProgram) {
        let recurs =
            |bound: &Bound| matches!(bound, Bound::Row(row, _) if program.rows[*row].recurs);
        if self.active.iter().any(recurs) {
            self.recurring.extend_from_slice(&self.active);
            let free =
                self.slack_states.iter().enumerate().filter(|(_, state)| **state != Slack::Held);
            self.recurring_slacks.extend(free.map(|(slack, _)| slack));
        }
    }

    /// Activates what is remembered of the last program, as far as it is dual feasible.
    pub(super) fn resume(&mut self, program: &QuadraticProgram, iterations: &mut u32) {
        self.distances.clear();
        for place in 0..self.recurring_slacks.len() {
            self.free_slack_from_start(program, self.recurring_slacks[place]);
        }
        for place in 0..self.recurring.len() {
            let bound = self.recurring[place];
            self.look_at(program, bound);
            let (whole, square) = self.normals.take_apart(&self.image, self.reach);
            if square > DEPENDENT * whole && self.normals.has_room() {
                *iterations += 1;
                let there = self.image.rows(0, self.reach).dot(&self.whitened.rows(0, self.reach));
                self.add_constraint(bound, 0.0);
                self.distances.push(bound.room(program) + there);
            }
        }
        self.recurring_slacks.clear();
        self.recurring.clear();
        loop {
            self.normals.solve_transposed(&self.distances, &mut self.release);
            self.image.copy_from(&self.release);
            self.normals.solve_triangle(&mut self.release);
            self.multipliers.iter_mut().zip(self.release.iter()).for_each(|(to, of)| *to = *of);
            let least = self.multipliers.iter().enumerate().min_by(|(_, a), (_, b)| a.total_cmp(b));
            if let Some((place, multiplier)) = least
                && *multiplier < 0.0
            {
                *iterations += 1;
                self.drop_constraint(place);
                self.distances.remove(place);
            } else if let Some(slack) = self.exceeded_slack(program) {
                *iterations += 1;
                self.free_slack_from_start(program, slack);
            } else {
                break;
            }
        }
        self.normals.combine(&self.image, &mut self.whitened);
    }

    /// Frees a slack where no step has been made: its entry of v is at the minimum.
    fn free_slack_from_start(&mut self, program: &QuadraticProgram, slack: usize) {
        let entry = self.entries;
        self.free_slack(program, slack);
        self.whitened[entry] = -program.penalties.slack * entry_of_slack(program);
        for (distance, bound) in self.distances.iter_mut().zip(&self.active) {
            if bound.slack(program) == Some(slack) {
                *distance += self.whitened[entry] * entry_of_slack(program);
            }
        }
    }

    /// Computes the multipliers of held slacks from those of the active rows, and returns a slack
    /// whose multiplier is negative, if there is one.
    fn exceeded_slack(&mut self, program: &QuadraticProgram) -> Option<usize> {
        for (multiplier, state) in self.slack_multipliers.iter_mut().zip(&self.slack_states) {
            *multiplier = if *state == Slack::Held { program.penalties.slack } else { 0.0 };
        }
        for (bound, multiplier) in self.active.iter().zip(&self.multipliers) {
            if let Some(slack) =
                bound.slack(program).filter(|slack| self.slack_states[*slack] == Slack::Held)
            {
                self.slack_multipliers[slack] -= multiplier;
            }
        }
        self.slack_multipliers.iter().position(|multiplier| *multiplier < 0.0)
    }
}
