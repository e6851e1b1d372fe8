//! J of H⁻¹ = J Jᵀ, for the H of a program in stages in its free inputs: a Riccati recursion, and
//! two sweeps over the horizon.
//!
//! ```text
//! P_N = Q_N      M = R + GᵀPG = ΛΛᵀ      L = S̃ + GᵀPF      K = M⁻¹L      P ← Q + FᵀPF − LᵀK
//! u = Λ⁻ᵀ v − K ξ      ξ⁺ = Φ ξ + Γ v      Φ = F − G K      Γ = G Λ⁻ᵀ
//! ```
//! where R, S̃ and Q are the second-order stage costs of u, of u with ξ, and of ξ. J is the map
//! from v to the inputs: it turns the cost into ½|v|². A linear function of states and inputs has
//! coefficients g of states and h of inputs. Jᵀ turns them into the coefficients of the same
//! function of v, from the end of the horizon on:
//!
//! ```text
//! v = Γᵀ π⁺ + Λ⁻¹ h      π = g + Φᵀ π⁺ − Kᵀ h
//! ```
//! All is O(N).
//!
//! Reference: Frison, *Algorithms and Methods for High-Performance Model Predictive Control*, 2015,
//! ch. 3.

use super::qp::{BEFORE, INPUT, QuadraticProgram, Row, STATE, Stage, Vector, WIDTH};

/// Factors of one period.
#[derive(Debug, Clone, Copy)]
struct Factor {
    /// Φ, row by row and column by column.
    rows: [Vector; WIDTH],
    columns: [Vector; WIDTH],
    /// Γ, column by column.
    drive: [Vector; INPUT],
    /// K, row by row.
    gain: [Vector; INPUT],
    /// Λ⁻¹, row by row.
    inverse: [[f64; INPUT]; INPUT],
}

impl Factor {
    const ZERO: Self = Self {
        rows: [[0.0; WIDTH]; WIDTH],
        columns: [[0.0; WIDTH]; WIDTH],
        drive: [[0.0; WIDTH]; INPUT],
        gain: [[0.0; WIDTH]; INPUT],
        inverse: [[0.0; INPUT]; INPUT],
    };
}

/// Inputs of the free periods, and the states of all N + 1 stages.
#[derive(Debug, Clone)]
pub struct Trajectory {
    /// u.
    pub inputs: Vec<[f64; INPUT]>,
    /// ξ.
    pub states: Vec<Vector>,
}

impl Trajectory {
    /// Allocates for the size of `program`.
    pub fn of(program: &QuadraticProgram) -> Self {
        Self {
            inputs: vec![[0.0; INPUT]; program.blocks()],
            states: vec![[0.0; WIDTH]; program.stages.len()],
        }
    }
}

/// J: set up once, then in place.
#[derive(Debug, Clone)]
pub struct Riccati {
    /// One per period.
    factors: Vec<Factor>,
    blocks: usize,
    /// Number of entries of ξ in use.
    entries: usize,
}

impl Riccati {
    /// Allocates for programs of the shape of `program`.
    pub fn new(program: &QuadraticProgram) -> Self {
        Self {
            factors: vec![Factor::ZERO; program.horizon()],
            blocks: program.blocks(),
            entries: program.entries(),
        }
    }

    /// Computes J. Returns `false` if H is not positive definite. Does not allocate.
    pub fn factorise(&mut self, program: &QuadraticProgram) -> bool {
        self.entries = program.entries();
        match self.entries {
            STATE => self.factorise_entries::<STATE>(program),
            9 => self.factorise_entries::<9>(program),
            _ => self.factorise_entries::<WIDTH>(program),
        }
    }

    fn factorise_entries<const D: usize>(&mut self, program: &QuadraticProgram) -> bool {
        let Some((last, stages)) = program.stages.split_last() else { return false };
        // P, symmetric.
        let mut value = [[0.0; WIDTH]; WIDTH];
        add_curvature(&mut value, last);
        for (k, (factor, stage)) in self.factors.iter_mut().zip(stages).enumerate().rev() {
            let free = k < self.blocks;
            let weighted: [Vector; WIDTH] = std::array::from_fn(|c| {
                if c < D { times::<D>(&value, &stage.transition[c]) } else { [0.0; WIDTH] }
            });
            factor.columns = stage.transition;
            let mut whitened = [[0.0; WIDTH]; INPUT];
            if free {
                let driven = stage.drive.map(|column| times::<D>(&value, &column));
                let mut curvature = [[0.0; INPUT]; INPUT];
                for i in 0..INPUT {
                    for j in 0..=i {
                        curvature[i][j] = dot::<D>(&stage.drive[i], &driven[j]);
                    }
                    curvature[i][i] += program.penalties.input + program.penalties.change;
                    for c in 0..D {
                        whitened[i][c] = dot::<D>(&stage.drive[i], &weighted[c]);
                    }
                    whitened[i][BEFORE + i] -= program.penalties.change;
                }
                let Some(inverse) = inverse_factor(&curvature) else { return false };
                factor.inverse = inverse;
                // From the last row on, since each row needs the earlier ones.
                for i in (0..INPUT).rev() {
                    let mut row = [0.0; WIDTH];
                    (0..=i).for_each(|j| add::<D>(&mut row, inverse[i][j], &whitened[j]));
                    whitened[i] = row;
                }
                for i in 0..INPUT {
                    (factor.gain[i], factor.drive[i]) = ([0.0; WIDTH], [0.0; WIDTH]);
                    (i..INPUT)
                        .for_each(|j| add::<D>(&mut factor.gain[i], inverse[j][i], &whitened[j]));
                    (0..=i).for_each(|j| {
                        add::<D>(&mut factor.drive[i], inverse[i][j], &stage.drive[j]);
                    });
                }
                for (c, column) in factor.columns.iter_mut().enumerate().take(D) {
                    (0..INPUT).for_each(|i| add::<D>(column, -factor.gain[i][c], &stage.drive[i]));
                }
            }
            for row in 0..D {
                for c in 0..D {
                    factor.rows[row][c] = factor.columns[c][row];
                }
                for c in 0..=row {
                    let mut entry = dot::<D>(&stage.transition[row], &weighted[c]);
                    for of_input in &whitened {
                        entry -= of_input[row] * of_input[c];
                    }
                    (value[row][c], value[c][row]) = (entry, entry);
                }
            }
            add_curvature(&mut value, stage);
            for axis in BEFORE..BEFORE + INPUT {
                value[axis][axis] +=
                    if free { program.penalties.change } else { program.penalties.input };
            }
        }
        true
    }

    /// J v: inputs and states. Entries after those of the inputs are ignored.
    pub fn apply(&self, v: &[f64], to: &mut Trajectory) {
        match self.entries {
            STATE => self.apply_entries::<STATE>(v, to),
            9 => self.apply_entries::<9>(v, to),
            _ => self.apply_entries::<WIDTH>(v, to),
        }
    }

    fn apply_entries<const D: usize>(&self, v: &[f64], to: &mut Trajectory) {
        let mut now = [0.0; WIDTH];
        let (v, _) = v.as_chunks::<INPUT>();
        let mut free = to.inputs.iter_mut().zip(v);
        let mut states = to.states.iter_mut();
        for (factor, slot) in self.factors.iter().zip(&mut states) {
            *slot = now;
            let mut next = times::<D>(&factor.columns, &now);
            if let Some((input, v)) = free.next() {
                for i in 0..INPUT {
                    add::<D>(&mut next, v[i], &factor.drive[i]);
                    input[i] = (i..INPUT).map(|j| factor.inverse[j][i] * v[j]).sum::<f64>()
                        - dot::<D>(&factor.gain[i], &now);
                }
            }
            now = next;
        }
        if let Some(slot) = states.next() {
            *slot = now;
        }
    }

    /// Jᵀ of the coefficients of `row`. `to` holds an entry per input, and possibly others, which
    /// become zero.
    pub fn transposed_row(&self, row: &Row, to: &mut [f64]) {
        match self.entries {
            STATE => self.transposed_row_entries::<STATE>(row, to),
            9 => self.transposed_row_entries::<9>(row, to),
            _ => self.transposed_row_entries::<WIDTH>(row, to),
        }
    }

    fn transposed_row_entries<const D: usize>(&self, row: &Row, to: &mut [f64]) {
        to.fill(0.0);
        let (v, _) = to.as_chunks_mut::<INPUT>();
        let mut costate = [0.0; WIDTH];
        if let Some(entries) = costate.get_mut(row.first..row.first + 3) {
            entries.copy_from_slice(&row.by_state);
        }
        if row.stage < self.blocks
            && let (Some(factor), Some(v)) = (self.factors.get(row.stage), v.get_mut(row.stage))
        {
            factor.take_input::<D>(&row.by_input, &mut costate, v);
        }
        for (k, factor) in self.factors.iter().enumerate().take(row.stage).rev() {
            factor.go_back::<D>(&mut costate, v.get_mut(k).filter(|_| k < self.blocks));
        }
    }

    /// Jᵀ of the cost's gradient. `to` is as in [`transposed_row`](Self::transposed_row).
    pub fn transposed_gradient(&self, program: &QuadraticProgram, to: &mut [f64]) {
        match self.entries {
            STATE => self.transposed_gradient_entries::<STATE>(program, to),
            9 => self.transposed_gradient_entries::<9>(program, to),
            _ => self.transposed_gradient_entries::<WIDTH>(program, to),
        }
    }

    fn transposed_gradient_entries<const D: usize>(
        &self,
        program: &QuadraticProgram,
        to: &mut [f64],
    ) {
        to.fill(0.0);
        let (v, _) = to.as_chunks_mut::<INPUT>();
        let Some((last, stages)) = program.stages.split_last() else { return };
        let mut costate = last.gradient;
        for (k, (factor, stage)) in self.factors.iter().zip(stages).enumerate().rev() {
            match v.get_mut(k).filter(|_| k < self.blocks) {
                Some(v) => {
                    factor.go_back::<D>(&mut costate, Some(v));
                    factor.take_input::<D>(&stage.input_gradient, &mut costate, v);
                }
                None => factor.go_back::<D>(&mut costate, None),
            }
            add::<D>(&mut costate, 1.0, &stage.gradient);
        }
    }
}

impl Factor {
    /// From π⁺ to π, without g and h.
    fn go_back<const D: usize>(&self, costate: &mut Vector, v: Option<&mut [f64; INPUT]>) {
        if let Some(v) = v {
            *v = std::array::from_fn(|i| dot::<D>(&self.drive[i], costate));
        }
        *costate = times::<D>(&self.rows, costate);
    }

    /// Adds the contribution of h to v and π.
    fn take_input<const D: usize>(
        &self,
        by_input: &[f64; INPUT],
        costate: &mut Vector,
        v: &mut [f64; INPUT],
    ) {
        for i in 0..INPUT {
            v[i] += (0..=i).map(|j| self.inverse[i][j] * by_input[j]).sum::<f64>();
            add::<D>(costate, -by_input[i], &self.gain[i]);
        }
    }
}

fn add_curvature(to: &mut [Vector; WIDTH], stage: &Stage) {
    for (column, curvature) in to.iter_mut().zip(stage.curvature.column_iter()) {
        for (entry, by) in column.iter_mut().zip(curvature.iter()) {
            *entry += by;
        }
    }
}

/// Λ⁻¹ of a 3 × 3 matrix ΛΛᵀ, whose lower triangle is read. `None` if it is not positive definite.
fn inverse_factor(matrix: &[[f64; INPUT]; INPUT]) -> Option<[[f64; INPUT]; INPUT]> {
    let mut factor = [[0.0; INPUT]; INPUT];
    let mut inverse = [[0.0; INPUT]; INPUT];
    for i in 0..INPUT {
        for j in 0..i {
            let known: f64 = (0..j).map(|l| factor[i][l] * factor[j][l]).sum();
            factor[i][j] = (matrix[i][j] - known) * inverse[j][j];
        }
        let rest = matrix[i][i] - factor[i].iter().take(i).map(|entry| entry * entry).sum::<f64>();
        inverse[i][i] = 1.0 / rest.sqrt();
        // Zero and negative numbers have no inverse root.
        if !(inverse[i][i].is_normal()) {
            return None;
        }
        for j in 0..i {
            inverse[i][j] =
                -inverse[i][i] * (j..i).map(|l| factor[i][l] * inverse[l][j]).sum::<f64>();
        }
    }
    Some(inverse)
}

/// A matrix, column by column, times a vector.
#[inline]
fn times<const D: usize>(columns: &[Vector; WIDTH], by: &Vector) -> Vector {
    let mut product = [0.0; WIDTH];
    for (column, by) in columns.iter().zip(by).take(D) {
        add::<D>(&mut product, *by, column);
    }
    product
}

#[inline]
fn add<const D: usize>(to: &mut Vector, by: f64, vector: &Vector) {
    for i in 0..D {
        to[i] += by * vector[i];
    }
}

#[inline]
fn dot<const D: usize>(a: &Vector, b: &Vector) -> f64 {
    (0..D).map(|i| a[i] * b[i]).sum()
}
