//! Condensing: the states as linear functions of the free inputs.
//!
//! ```text
//! Γ_0 = 0      Γ_{k+1} = A_k Γ_k + B_k ∂a_k + C_k ∂a_{k−1},   ∂a_k = (1 − w) S_k + w S_{k−1},   S_k picks the block that period k belongs to
//! ```
//! with a the input that acts and w the share of the command before in it. C is there where what is learnt looks back on a_{k−1}.

use model::State;
use model::linearise::Linearised;
use nalgebra::SMatrix;

/// ∂(state)/∂(one block of free inputs).
pub(super) type Block = SMatrix<f64, 6, 3>;

/// Γ of every predicted state.
pub(super) struct Condensed {
    blocks: usize,
    /// Γ_0 to Γ_N, C blocks each.
    sensitivity: Vec<Block>,
}

impl Condensed {
    pub(super) fn new(horizon: usize, blocks: usize) -> Self {
        Self { blocks, sensitivity: vec![Block::zeros(); (horizon + 1) * blocks] }
    }

    /// C.
    pub(super) fn blocks(&self) -> usize {
        self.blocks
    }

    /// Works Γ out for new Jacobians. O(N C), does not allocate.
    pub(super) fn propagate(&mut self, steps: &[Linearised], carry: f64) {
        for (k, step) in steps.iter().enumerate() {
            let (done, rest) = self.sensitivity.split_at_mut((k + 1) * self.blocks);
            let (Some(now), Some(next)) = (done.get(k * self.blocks..), rest.get_mut(..self.blocks)) else { return };
            // Only the first min(k, C) blocks of Γ_k are not zero.
            let reached = k.min(self.blocks);
            for (next, now) in next.iter_mut().zip(now).take(reached) {
                *next = step.by_state * now;
            }
            if let Some(driven) = next.get_mut(k.min(self.blocks - 1)) {
                let share = (1.0 - carry) * step.by_input;
                *driven = if k < self.blocks { share } else { *driven + share };
            }
            for (periods, by) in [(1, carry * step.by_input + (1.0 - carry) * step.by_acted), (2, carry * step.by_acted)] {
                if let Some(driven) = k.checked_sub(periods).and_then(|before| next.get_mut(before.min(self.blocks - 1))) {
                    *driven += by;
                }
            }
        }
    }

    /// Γ_k of one block.
    pub(super) fn block(&self, k: usize, block: usize) -> Block {
        self.sensitivity.get(k * self.blocks + block).copied().unwrap_or_else(Block::zeros)
    }

    /// How many blocks state k depends on.
    pub(super) fn reach(&self, k: usize) -> usize {
        k.min(self.blocks)
    }

    /// State k after the free inputs have changed by `change`, to first order.
    pub(super) fn moved(&self, k: usize, state: &State, change: &[f64]) -> State {
        let mut state = *state;
        for (block, change) in change.chunks_exact(3).enumerate().take(self.reach(k)) {
            let sensitivity = self.block(k, block);
            for (column, by) in change.iter().enumerate() {
                for axis in 0..3 {
                    state.pose[axis] += sensitivity[(axis, column)] * by;
                    state.velocity[axis] += sensitivity[(axis + 3, column)] * by;
                }
            }
        }
        state
    }
}
