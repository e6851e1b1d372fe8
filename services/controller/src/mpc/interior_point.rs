//! Clarabel, an interior-point method, on a program of fixed sparsity: set up once, then only
//! values change.
//!
//! It solves the program without elimination: the unknowns are u_0 to u_{C−1}, ξ_1 to ξ_N and the
//! slacks, and each state transition is a row.
//!
//! The rows are scaled to bounds of 1, so the solver's own equilibration is off. The budget is
//! iterations, and in real time a deadline.

use super::qp::{BEFORE, INPUT, QuadraticProgram, STATE, WIDTH};
use super::solver::{Outcome, Status, Turn};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Largest number of iterations of the interior-point method: 8 to 15 are usual.
const ITERATIONS_MAX: u32 = 50;
/// Gap at which an answer counts as solved. The cost is flat: a gap of ε leaves an uncertainty of
/// at most √(2ε/0.25) in an input whose curvature is the usual 0.25, here 3e-5 m/s.
const GAP: f64 = 1e-10;
/// Residual at which the limits count as satisfied.
const RESIDUAL: f64 = 1e-9;

/// Clarabel refused the problem's structure.
#[derive(Debug, thiserror::Error)]
#[error(
    "the quadratic program of {variables} unknowns and {rows} rows was refused by the solver: \
     {reason}"
)]
pub struct SolverError {
    variables: usize,
    rows: usize,
    reason: String,
}

/// No deadline.
const NEVER: u64 = u64::MAX;

/// The solver and its input values.
pub struct Clarabel {
    solver: DefaultSolver<f64>,
    layout: Layout,
    /// Upper triangle of the curvatures, and the rows.
    hessian: Entries,
    rows: Entries,
    gradient: Vec<f64>,
    bounds: Vec<f64>,
    /// Deadline of the solver on the monotonic clock, checked in every iteration \[ns\].
    until: Arc<AtomicU64>,
}

/// Positions of the unknowns.
#[derive(Debug, Clone, Copy)]
struct Layout {
    horizon: usize,
    blocks: usize,
    slacks: usize,
}

impl Layout {
    /// ξ_k, k > 0.
    fn state(self, k: usize) -> usize {
        INPUT * self.blocks + WIDTH * (k - 1)
    }

    fn slack(self, slack: usize) -> usize {
        INPUT * self.blocks + WIDTH * self.horizon + slack
    }

    fn unknowns(self) -> usize {
        self.slack(self.slacks)
    }
}

/// A sparse matrix whose entries are visited in the same order every time.
struct Entries {
    /// Row and column of each entry, in the order of the visit.
    places: Vec<(usize, usize)>,
    /// Index of each entry among the values, which are column by column.
    slots: Vec<usize>,
    values: Vec<f64>,
}

impl Entries {
    /// Takes the places from one visit.
    fn visited_by(visit: impl FnOnce(&mut dyn FnMut(usize, usize, f64))) -> Self {
        let (mut places, mut drawn) = (Vec::new(), Vec::new());
        visit(&mut |row, column, value| {
            places.push((row, column));
            drawn.push(value);
        });
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_unstable_by_key(|&at| (places[at].1, places[at].0));
        let mut slots = vec![0; places.len()];
        for (slot, &at) in order.iter().enumerate() {
            slots[at] = slot;
        }
        let mut this = Self { values: vec![0.0; places.len()], places, slots };
        for (slot, value) in this.slots.iter().zip(drawn) {
            this.values[*slot] = value;
        }
        this
    }

    /// Takes the values from another visit. Does not allocate.
    fn update(&mut self, visit: impl FnOnce(&mut dyn FnMut(usize, usize, f64))) {
        let mut slots = self.slots.iter();
        visit(&mut |_, _, value| {
            if let Some(place) = slots.next().and_then(|&slot| self.values.get_mut(slot)) {
                *place = value;
            }
        });
    }

    fn csc(&self, rows: usize, columns: usize) -> CscMatrix<f64> {
        let mut places = self.places.clone();
        places.sort_unstable_by_key(|&(row, column)| (column, row));
        let mut starts = vec![0; columns + 1];
        for &(_, column) in &places {
            starts.iter_mut().skip(column + 1).for_each(|start| *start += 1);
        }
        CscMatrix::new(
            rows,
            columns,
            starts,
            places.iter().map(|&(row, _)| row).collect(),
            self.values.clone(),
        )
    }
}

/// The upper triangle of the curvatures.
fn visit_hessian(
    program: &QuadraticProgram,
    layout: Layout,
    entry: &mut dyn FnMut(usize, usize, f64),
) {
    let penalties = &program.penalties;
    for i in 0..INPUT * layout.blocks {
        entry(i, i, penalties.input + penalties.change);
    }
    for (k, stage) in program.stages.iter().enumerate().skip(1) {
        let at = layout.state(k);
        for column in 0..STATE {
            (0..=column)
                .for_each(|row| entry(at + row, at + column, stage.curvature[(row, column)]));
        }
        for i in 0..INPUT {
            let free = k < layout.blocks;
            let before = if free { penalties.change } else { penalties.input };
            entry(at + BEFORE + i, at + BEFORE + i, if k < layout.horizon { before } else { 0.0 });
            if free {
                entry(INPUT * k + i, at + BEFORE + i, -penalties.change);
            }
        }
    }
    for slack in 0..layout.slacks {
        entry(layout.slack(slack), layout.slack(slack), penalties.slack_curvature);
    }
}

/// First F ξ + G u − ξ⁺ of each period, then the bounded rows.
fn visit_rows(
    program: &QuadraticProgram,
    layout: Layout,
    entry: &mut dyn FnMut(usize, usize, f64),
) {
    for (k, stage) in program.stages.iter().enumerate().take(layout.horizon) {
        for row in 0..WIDTH {
            let (at, axis) = (WIDTH * k + row, row % INPUT);
            if k > 0 {
                // p⁺ and a⁺ depend on their own axis only.
                let columns = if row < STATE { 0..WIDTH } else { BEFORE + axis..BEFORE + axis + 1 };
                columns.for_each(|column| {
                    entry(at, layout.state(k) + column, stage.transition[column][row]);
                });
            }
            if k < layout.blocks {
                let columns = if row < STATE { 0..INPUT } else { axis..axis + 1 };
                columns.for_each(|column| entry(at, INPUT * k + column, stage.drive[column][row]));
            }
            entry(at, layout.state(k + 1) + row, -1.0);
        }
    }
    let mut at = WIDTH * layout.horizon;
    for row in &program.rows {
        for (bound, sign) in row.bounds.iter().zip([1.0, -1.0]) {
            if *bound == f64::INFINITY {
                continue;
            }
            if row.stage > 0 {
                (0..3).for_each(|i| {
                    entry(at, layout.state(row.stage) + row.first + i, sign * row.by_state[i]);
                });
            }
            if row.stage < layout.blocks {
                (0..INPUT).for_each(|i| entry(at, INPUT * row.stage + i, sign * row.by_input[i]));
            }
            if let Some(slack) = row.slack {
                entry(at, layout.slack(slack), -1.0);
            }
            at += 1;
        }
    }
    for slack in 0..layout.slacks {
        entry(at + slack, layout.slack(slack), -1.0);
    }
}

impl Clarabel {
    /// Sets up the solver for programs of the structure of `program`.
    ///
    /// # Errors
    /// [`SolverError`] if the solver refuses the structure.
    pub fn new(program: &QuadraticProgram) -> Result<Self, SolverError> {
        let layout = Layout {
            horizon: program.horizon(),
            blocks: program.blocks(),
            slacks: program.slacks(),
        };
        let (variables, equations) = (layout.unknowns(), WIDTH * layout.horizon);
        let bounded = program
            .rows
            .iter()
            .flat_map(|row| row.bounds)
            .filter(|bound| *bound < f64::INFINITY)
            .count()
            + layout.slacks;
        let refused = |reason: String| SolverError { variables, rows: equations + bounded, reason };
        let hessian = Entries::visited_by(|entry| visit_hessian(program, layout, entry));
        let rows = Entries::visited_by(|entry| visit_rows(program, layout, entry));
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
        let (gradient, bounds) = (vec![0.0; variables], vec![1.0; equations + bounded]);
        let mut solver = DefaultSolver::new(
            &hessian.csc(variables, variables),
            &gradient,
            &rows.csc(equations + bounded, variables),
            &bounds,
            &[ZeroConeT(equations), NonnegativeConeT(bounded)],
            settings,
        )
        .map_err(|e| refused(e.to_string()))?;
        let until = Arc::new(AtomicU64::new(NEVER));
        let deadline = Arc::clone(&until);
        solver.set_termination_callback(move |_| {
            let until = deadline.load(Ordering::Relaxed);
            Turn { tick: None, until: (until != NEVER).then_some(until) }.is_over()
        });
        Ok(Self { solver, layout, hessian, rows, gradient, bounds, until })
    }

    /// Copies the numbers of `program`.
    fn update(&mut self, program: &QuadraticProgram) {
        let layout = self.layout;
        self.hessian.update(|entry| visit_hessian(program, layout, entry));
        self.rows.update(|entry| visit_rows(program, layout, entry));
        let inputs =
            program.stages.iter().take(layout.blocks).flat_map(|stage| stage.input_gradient);
        let states = program.stages.iter().skip(1).flat_map(|stage| stage.gradient);
        let slacks = std::iter::repeat_n(program.penalties.slack, layout.slacks);
        for (slot, slope) in self.gradient.iter_mut().zip(inputs.chain(states).chain(slacks)) {
            *slot = slope;
        }
        let bounded =
            program.rows.iter().flat_map(|row| row.bounds).filter(|bound| *bound < f64::INFINITY);
        let equations = std::iter::repeat_n(0.0, WIDTH * layout.horizon);
        for (slot, bound) in
            self.bounds.iter_mut().zip(equations.chain(bounded).chain(std::iter::repeat(0.0)))
        {
            *slot = bound;
        }
    }

    /// Solves `program`, and writes inputs and slacks to `solution` if there is a usable answer.
    pub fn solve(
        &mut self,
        program: &QuadraticProgram,
        solution: &mut [f64],
        turn: &Turn,
    ) -> Outcome {
        self.until.store(turn.until.unwrap_or(NEVER), Ordering::Relaxed);
        self.update(program);
        let updated = self
            .solver
            .update_P(&self.hessian.values)
            .and_then(|()| self.solver.update_q(&self.gradient))
            .and_then(|()| self.solver.update_A(&self.rows.values))
            .and_then(|()| self.solver.update_b(&self.bounds));
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
            let inputs = answer.x.iter().take(self.layout.state(1));
            for (slot, value) in
                solution.iter_mut().zip(inputs.chain(answer.x.iter().skip(self.layout.slack(0))))
            {
                *slot = *value;
            }
        }
        outcome
    }
}
