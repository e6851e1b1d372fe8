//! Condensing: the states as linear functions of the free inputs.
//!
//! ```text
//! Γ_0 = 0      Γ_{k+1} = A_k Γ_k + B_k ∂a_k + C_k ∂a_{k−1},   ∂a_k = (1 − w) S_k + w S_{k−1},   S_k picks the block that period k belongs to
//! ```
//! with a the input that acts and w the share of the command before in it. C is there where what is learnt looks back on a_{k−1}.
//!
//! Where the state that the plan begins with is still to come, so are the states as linear functions of what will surprise (s):
//!
//! ```text
//! Ψ_0 = (1, 0, 0)      Ψ_{k+1} = A_k Ψ_k + (0, C_0 if k = 0, G_k)      s = (x, a_{−1}, d) − expected,   G = ∂x⁺/∂g
//! ```

use model::linearise::{Linearised, by_residual};
use model::main_model::MainModel;
use model::{State, Velocity};
use nalgebra::SMatrix;

/// ∂(state)/∂(one block of free inputs).
pub(super) type Block = SMatrix<f64, 6, 3>;

/// Blocks of Ψ: by pose, by velocity, by what acted before, by disturbance.
const SURPRISES: usize = 4;

/// s: measured less expected.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Surprise(pub(super) [f64; 3 * SURPRISES]);

impl Surprise {
    /// The state and disturbance that are seen, against those that were expected.
    pub(super) fn new(seen: (&State, &Velocity), expected: (&State, &Velocity)) -> Self {
        let parts = |(state, disturbance): (&State, &Velocity)| [state.pose, state.velocity, state.acted, *disturbance];
        let (seen, expected) = (parts(seen), parts(expected));
        Self(std::array::from_fn(|i| seen[i / 3][i % 3] - expected[i / 3][i % 3]))
    }
}

/// Γ of every predicted state, and Ψ where it is asked for.
pub(super) struct Condensed {
    blocks: usize,
    /// Γ_0 to Γ_N, C blocks each.
    sensitivity: Vec<Block>,
    /// Ψ_0 to Ψ_N; nothing, where nothing is still to come.
    by_surprise: Vec<[Block; SURPRISES]>,
}

impl Condensed {
    pub(super) fn new(horizon: usize, blocks: usize) -> Self {
        Self { blocks, sensitivity: vec![Block::zeros(); (horizon + 1) * blocks], by_surprise: Vec::new() }
    }

    /// Makes room for Ψ, and says how many numbers s has.
    pub(super) fn expect_surprise(&mut self) -> usize {
        self.by_surprise = vec![[Block::zeros(); SURPRISES]; self.sensitivity.len() / self.blocks];
        3 * SURPRISES
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

    /// Works Ψ out for new Jacobians, of which the k-th is that of a step from `starts[k]`. O(N), does not allocate.
    pub(super) fn propagate_surprise(&mut self, steps: &[Linearised], starts: impl Iterator<Item = State>, main: &MainModel) {
        let mut now = [Block::zeros(); SURPRISES];
        now[0].fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        now[1].fixed_view_mut::<3, 3>(3, 0).fill_with_identity();
        let mut slots = self.by_surprise.iter_mut();
        if let Some(first) = slots.next() {
            *first = now;
        }
        for (k, ((slot, step), start)) in slots.zip(steps).zip(starts).enumerate() {
            now = now.map(|block| step.by_state * block);
            if k == 0 {
                now[2] += step.by_acted;
            }
            now[3] += by_residual(main, &start, &step.next);
            *slot = now;
        }
    }

    /// Ψ_k; nothing, where nothing is still to come.
    pub(super) fn by_surprise(&self, k: usize) -> &[Block] {
        self.by_surprise.get(k).map_or(&[], |blocks| blocks.as_slice())
    }

    /// State k after a surprise, to first order.
    pub(super) fn surprised(&self, k: usize, state: &State, surprise: &Surprise) -> State {
        let mut state = *state;
        for (block, by) in self.by_surprise(k).iter().zip(surprise.0.chunks_exact(3)) {
            shift(&mut state, block, by);
        }
        state
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
            shift(&mut state, &self.block(k, block), change);
        }
        state
    }
}

fn shift(state: &mut State, sensitivity: &Block, change: &[f64]) {
    for (column, by) in change.iter().enumerate() {
        for axis in 0..3 {
            state.pose[axis] += sensitivity[(axis, column)] * by;
            state.velocity[axis] += sensitivity[(axis + 3, column)] * by;
        }
    }
}
