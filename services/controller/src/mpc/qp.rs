//! A convex quadratic program in stages: inputs drive a state along the horizon, and slacks relax
//! rows.
//!
//! ```text
//! min  Σ_{k≤N} ½ xᵀ Q_k x + q_kᵀ ξ_k  +  Σ_{k<C} ½ R |u_k|² + ½ S |u_k − p_k|² + r_kᵀ u_k
//!      +  Σ_{C≤k<N} ½ R |p_k|²  +  Σ ½ σ s² + ρ s
//! s.t. ξ_0 = 0      ξ_{k+1} = F_k ξ_k + G_k u_k      ξ = (x, p, a)
//!      −b₋ − s ≤ gᵀ ξ_k + hᵀ u_k ≤ b₊ + s      s ≥ 0
//! ```
//! All are changes of the present plan: u of a free input, x of a state, p of the previous period's
//! input, a of the input that acted in the previous period. From period C on no input is free, and
//! p stays constant.

use model::delay::Split;
use model::linearise::Linearised;
use nalgebra::SMatrix;

/// Entries of x.
pub const STATE: usize = 6;
/// Entries of u.
pub const INPUT: usize = 3;
/// Index of p in ξ.
pub const BEFORE: usize = STATE;
/// Index of a in ξ.
pub const ACTED: usize = BEFORE + INPUT;
/// Entries of ξ.
pub const WIDTH: usize = ACTED + INPUT;

/// ξ, or one column of a matrix that is multiplied by it.
pub type Vector = [f64; WIDTH];

/// The numbers of one period. The last one only ends the period before; it has no F, G and r.
#[derive(Debug, Clone, Copy)]
pub struct Stage {
    /// F, column by column.
    pub transition: [Vector; WIDTH],
    /// G, column by column.
    pub drive: [Vector; INPUT],
    /// Q.
    pub curvature: SMatrix<f64, STATE, STATE>,
    /// q.
    pub gradient: Vector,
    /// r.
    pub input_gradient: [f64; INPUT],
}

impl Stage {
    const ZERO: Self = Self {
        transition: [[0.0; WIDTH]; WIDTH],
        drive: [[0.0; WIDTH]; INPUT],
        curvature: SMatrix::<f64, STATE, STATE>::from_array_storage(nalgebra::ArrayStorage(
            [[0.0; STATE]; STATE],
        )),
        gradient: [0.0; WIDTH],
        input_gradient: [0.0; INPUT],
    };
}

/// One row: a quantity bounded from above and below.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// k.
    pub stage: usize,
    /// Index of the first of three entries of ξ that g multiplies.
    pub first: usize,
    /// g.
    pub by_state: [f64; 3],
    /// h; zero if the stage has no free input.
    pub by_input: [f64; INPUT],
    /// The slack that relaxes it.
    pub slack: Option<usize>,
    /// b₊ and b₋; infinite from the start if there is no such bound.
    pub bounds: [f64; 2],
    /// Whether the solver begins with the last active bounds if this row was among them.
    pub recurs: bool,
}

impl Row {
    /// gᵀ ξ + hᵀ u. `inputs` holds the free periods.
    #[inline]
    pub fn value(&self, states: &[Vector], inputs: &[[f64; INPUT]]) -> f64 {
        let (g, h) = (&self.by_state, &self.by_input);
        let entries =
            states.get(self.stage).and_then(|state| state.get(self.first..)?.first_chunk());
        let of_state = entries.map_or(0.0, |[a, b, c]| g[0] * a + g[1] * b + g[2] * c);
        let of_input =
            inputs.get(self.stage).map_or(0.0, |[a, b, c]| h[0] * a + h[1] * b + h[2] * c);
        of_state + of_input
    }
}

/// Weights of inputs and of their changes, and penalties of slacks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Penalties {
    /// R.
    pub input: f64,
    /// S.
    pub change: f64,
    /// ρ.
    pub slack: f64,
    /// σ.
    pub slack_curvature: f64,
}

/// The program's numbers.
#[derive(Debug, Clone)]
pub struct QuadraticProgram {
    /// N + 1 of them.
    pub stages: Vec<Stage>,
    /// The bounded rows.
    pub rows: Vec<Row>,
    /// Weights and penalties.
    pub penalties: Penalties,
    blocks: usize,
    slacks: usize,
    /// Number of entries of ξ in use. The others are zero, or nothing depends on them.
    entries: usize,
}

impl QuadraticProgram {
    /// A program over `horizon` periods of which `blocks` have free inputs, without numbers.
    pub fn new(
        horizon: usize,
        blocks: usize,
        slacks: usize,
        rows: Vec<Row>,
        penalties: Penalties,
    ) -> Self {
        Self {
            stages: vec![Stage::ZERO; horizon + 1],
            rows,
            penalties,
            blocks,
            slacks,
            entries: WIDTH,
        }
    }

    /// N.
    pub fn horizon(&self) -> usize {
        self.stages.len() - 1
    }

    /// C.
    pub fn blocks(&self) -> usize {
        self.blocks
    }

    /// Number of slacks.
    pub fn slacks(&self) -> usize {
        self.slacks
    }

    /// Number of inputs and slacks.
    pub fn unknowns(&self) -> usize {
        INPUT * self.blocks + self.slacks
    }

    /// Number of entries of ξ in use.
    pub fn entries(&self) -> usize {
        self.entries
    }

    /// Writes F and G for new Jacobians:
    ///
    /// ```text
    /// x⁺ = A x + B α + C a + D (p − u)      p⁺ = u      a⁺ = α = (1 − β) u + β p
    /// ```
    /// with β and D of `split`, where u = p from period C on. O(N), does not allocate.
    pub fn set_dynamics(&mut self, steps: &[Linearised], split: &Split) {
        let is_split = *split != Split::default();
        let looks_back = steps.iter().any(|step| step.by_acted.iter().any(|value| *value != 0.0));
        let remembers =
            looks_back || is_split || self.penalties.change != 0.0 || self.blocks < self.horizon();
        self.entries = match (
            remembers || self.rows.iter().any(|row| row.first == BEFORE),
            looks_back && is_split,
        ) {
            (_, true) => WIDTH,
            (true, false) => ACTED,
            (false, false) => STATE,
        };
        for (k, (stage, step)) in self.stages.iter_mut().zip(steps).enumerate() {
            let is_free = k < self.blocks;
            for (column, by) in stage.transition.iter_mut().zip(step.by_state.column_iter()) {
                column[..STATE].copy_from_slice(by.as_slice());
            }
            for i in 0..INPUT {
                let (mut input, mut before, mut acted) = ([0.0; WIDTH], [0.0; WIDTH], [0.0; WIDTH]);
                let (free, delayed) =
                    if is_free { (1.0 - split.before[i], split.before[i]) } else { (0.0, 1.0) };
                for row in 0..STATE {
                    let difference = if is_free { step.by_difference[(row, i)] } else { 0.0 };
                    input[row] = free * step.by_input[(row, i)] - difference;
                    before[row] = delayed * step.by_input[(row, i)] + difference;
                    // Without a dead time within the period, a = p.
                    let remembered = if is_split { &mut acted } else { &mut before };
                    remembered[row] += step.by_acted[(row, i)];
                }
                (input[BEFORE + i], before[BEFORE + i]) =
                    if is_free { (1.0, 0.0) } else { (0.0, 1.0) };
                (input[ACTED + i], before[ACTED + i]) = (free, delayed);
                (stage.drive[i], stage.transition[BEFORE + i], stage.transition[ACTED + i]) =
                    (input, before, acted);
            }
        }
    }

    /// Sets the gradients to zero.
    pub fn clear_gradients(&mut self) {
        for stage in &mut self.stages {
            (stage.gradient, stage.input_gradient) = ([0.0; WIDTH], [0.0; INPUT]);
        }
    }

    /// Adds to the gradient of the input of period `k` on one axis.
    pub fn add_slope(&mut self, k: usize, axis: usize, slope: f64) {
        if let Some(stage) = self.stages.get_mut(k) {
            if k < self.blocks {
                stage.input_gradient[axis] += slope;
            } else {
                stage.gradient[BEFORE + axis] += slope;
            }
        }
    }

    /// Sets that the input of the free period `k` differs from the one before by `change` on one
    /// axis.
    pub fn add_change(&mut self, k: usize, axis: usize, change: f64) {
        let slope = self.penalties.change * change;
        if let Some(stage) = self.stages.get_mut(k) {
            stage.input_gradient[axis] += slope;
            stage.gradient[BEFORE + axis] -= slope;
        }
    }

    /// Completes gradients and bounds after the plan's states have moved by `moved`: N + 1 of them,
    /// with zero p and a. O(N), does not allocate.
    pub fn displace(&mut self, moved: &[Vector]) {
        for (stage, moved) in self.stages.iter_mut().zip(moved) {
            for (column, by) in stage.curvature.column_iter().zip(moved) {
                for (slope, curvature) in stage.gradient.iter_mut().zip(column.iter()) {
                    *slope += curvature * by;
                }
            }
        }
        for row in &mut self.rows {
            let used = row.value(moved, &[]);
            row.bounds = [row.bounds[0] - used, row.bounds[1] + used];
        }
    }

    /// States under `inputs`. O(N), does not allocate.
    pub fn follow(&self, inputs: &[f64], states: &mut [Vector]) {
        let mut now = [0.0; WIDTH];
        let mut inputs = inputs.chunks_exact(INPUT).take(self.blocks);
        for (slot, stage) in states.iter_mut().zip(&self.stages) {
            *slot = now;
            let input = inputs.next().unwrap_or_default();
            let mut next = [0.0; WIDTH];
            for (column, by) in
                stage.transition.iter().zip(&now).chain(stage.drive.iter().zip(input))
            {
                for (entry, value) in next.iter_mut().zip(column) {
                    *entry += value * by;
                }
            }
            now = next;
        }
    }

    /// Whether inputs and slacks satisfy every row to within `tolerance`, with the states that
    /// [follow](Self::follow), and are finite.
    pub fn satisfied_by(&self, unknowns: &[f64], states: &[Vector], tolerance: f64) -> bool {
        let Some((inputs, slacks)) = unknowns.split_at_checked(INPUT * self.blocks) else {
            return false;
        };
        let (inputs, _) = inputs.as_chunks::<INPUT>();
        unknowns.iter().all(|value| value.is_finite())
            && slacks.len() == self.slacks
            && slacks.iter().all(|slack| *slack >= -tolerance)
            && self.rows.iter().all(|row| {
                let (value, slack) =
                    (row.value(states, inputs), row.slack.map_or(0.0, |slack| slacks[slack]));
                let kept = |bound: f64, value: f64| {
                    bound + slack - value >= -tolerance * (1.0 + bound.abs())
                };
                (kept(row.bounds[0], value) || row.bounds[0] == f64::INFINITY)
                    && (kept(row.bounds[1], -value) || row.bounds[1] == f64::INFINITY)
            })
    }
}
