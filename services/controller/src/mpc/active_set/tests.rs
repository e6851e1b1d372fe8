use super::*;
use crate::mpc::interior_point::{Clarabel, SolverError};
use crate::mpc::oracle::{Dense, cost, keeps};
use crate::mpc::qp::{BEFORE, Penalties, Row, STATE};
use crate::mpc::solver::Solver;
use crate::settings::SolverSetting;
use model::State;
use model::delay::Split;
use model::linearise::Linearised;
use nalgebra::SMatrix;
use proptest::prelude::*;

/// Source of the numbers of a program.
struct Numbers(u64);

impl Numbers {
    /// SplitMix64, from −1 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn below(&mut self, bound: usize) -> usize {
        ((0.5 + 0.5 * self.next()) * bound as f64) as usize % bound
    }

    fn once_in(&mut self, times: usize) -> bool {
        self.below(times) == 0
    }

    fn matrix<const R: usize, const C: usize>(&mut self, most: f64) -> SMatrix<f64, R, C> {
        SMatrix::from_fn(|_, _| most * self.next())
    }
}

/// Shape of a random program.
#[derive(Clone, Copy)]
struct Shape {
    horizon: usize,
    blocks: usize,
    rows: usize,
    slacks: usize,
    /// Decades that the curvatures span.
    decades: f64,
    /// Smallest bound. Below zero, the zero change may violate the limits.
    bound_min: f64,
}

/// A row, sometimes a duplicate of an earlier one. Some bounds are zero; half of the rows have only
/// one bound.
fn row(numbers: &mut Numbers, shape: Shape, before: &[Row]) -> Row {
    let stage = numbers.below(shape.horizon + 1);
    let free = stage < shape.blocks;
    let mut drawn = || std::array::from_fn(|_| numbers.next());
    let (by_state, by_input) = (drawn(), if free { drawn() } else { [0.0; 3] });
    let places = if stage == 0 { [0; 3] } else { [0, 3, BEFORE] };
    let first = places[numbers.below(3)];
    let slack = (shape.slacks > 0 && numbers.once_in(2)).then(|| numbers.below(shape.slacks));
    let mut bound = || {
        if numbers.once_in(6) {
            0.0
        } else {
            shape.bound_min + (1.0 - shape.bound_min) * (0.5 + 0.5 * numbers.next())
        }
    };
    let bounds = [bound(), bound()];
    let recurs = stage.is_multiple_of(2);
    let mut row = Row { stage, first, by_state, by_input, slack, bounds, recurs };
    if let Some(twin) =
        (!before.is_empty() && numbers.once_in(5)).then(|| before[numbers.below(before.len())])
    {
        row = Row { slack: row.slack, bounds: row.bounds, ..twin };
    }
    if numbers.once_in(2) { Row { bounds: [row.bounds[0], f64::INFINITY], ..row } } else { row }
}

/// A program with or without dynamics that depend on the previous input, with all optional parts.
fn program(numbers: &mut Numbers, shape: Shape) -> QuadraticProgram {
    let mut rows = Vec::new();
    (0..shape.rows).for_each(|_| rows.push(row(numbers, shape, &rows)));
    let change = if numbers.once_in(2) { 0.3 } else { 0.0 };
    let penalties = Penalties { input: 0.1, change, slack: 100.0, slack_curvature: 1.0 };
    let mut program =
        QuadraticProgram::new(shape.horizon, shape.blocks, shape.slacks, rows, penalties);
    let (looks_back, is_split) = (numbers.once_in(2), numbers.once_in(2));
    let scale: [f64; 3] =
        std::array::from_fn(|_| 10_f64.powf(0.25 * shape.decades * numbers.next()));
    let steps: Vec<Linearised> = (0..shape.horizon)
        .map(|_| Linearised {
            next: State::default(),
            by_state: SMatrix::identity() * 0.8 + numbers.matrix(0.2),
            by_input: numbers.matrix::<6, 3>(1.0) * SMatrix::from_diagonal(&scale.into()),
            by_acted: if looks_back { numbers.matrix(0.3) } else { SMatrix::zeros() },
            by_difference: if is_split { numbers.matrix(0.2) } else { SMatrix::zeros() },
            by_residual: SMatrix::zeros(),
        })
        .collect();
    let before = if is_split { [0.5 + 0.5 * numbers.next(); 3] } else { [0.0; 3] };
    program.set_dynamics(&steps, &Split { before, drift: [0.0; 3] });
    for (k, stage) in program.stages.iter_mut().enumerate().skip(1) {
        let factor = numbers.matrix::<4, STATE>(1.0);
        stage.curvature = factor.tr_mul(&factor);
        (0..STATE).for_each(|entry| stage.gradient[entry] = 2.0 * numbers.next());
        if k == shape.horizon {
            stage.curvature *= 3.0;
        }
    }
    for k in 0..shape.horizon {
        for axis in 0..3 {
            program.add_slope(k, axis, 5.0 * scale[axis] * numbers.next());
        }
    }
    program
}

#[test]
fn small_programs_have_the_answer_of_exhaustive_search() {
    let mut numbers = Numbers(1);
    let (mut solved, mut infeasible, mut let_off) = (0, 0, 0);
    for _ in 0..100_000 {
        let horizon = if numbers.once_in(4) { 2 } else { 1 };
        let bound_min = if numbers.once_in(3) { -0.5 } else { 0.0 };
        let (blocks, rows, slacks) =
            (1 + numbers.below(horizon), 1 + numbers.below(3), numbers.below(2));
        let program =
            program(&mut numbers, Shape { horizon, blocks, rows, slacks, decades: 4.0, bound_min });
        let mut x = vec![0.0; program.unknowns()];
        let outcome = ActiveSet::new(&program).solve(&program, &mut x, &Turn::default());
        match Dense::of(&program).brute_force() {
            Some(exact) => {
                assert_eq!(outcome.status, Status::Solved, "{exact} {:?}", program.rows);
                let (ours, best) = (cost(&program, &x), cost(&program, exact.as_slice()));
                assert!(
                    keeps(&program, &x) && (ours - best).abs() < 1e-6 * (1.0 + best.abs()),
                    "{x:?} costs {ours}, {exact} {best}"
                );
                solved += 1;
                let_off += usize::from(x.iter().skip(INPUT * blocks).any(|slack| *slack > 1e-6));
            }
            None if outcome.status == Status::Solved => assert!(keeps(&program, &x), "{x:?}"),
            None => infeasible += 1,
        }
    }
    assert!(
        solved > 80_000 && infeasible > 1_000 && let_off > 1_000,
        "{solved} solved, {infeasible} infeasible, {let_off} by a slack"
    );
}

/// The multiplier of each row of the same program without stages.
fn multipliers(solver: &ActiveSet, program: &QuadraticProgram) -> Vec<f64> {
    let of = |bound: Bound| {
        solver
            .active
            .iter()
            .position(|active| *active == bound)
            .map_or(0.0, |place| solver.multipliers[place])
    };
    let sides = |(row, of_row): (usize, &Row)| {
        [0, 1].map(|side| of_row.bounds[side].is_finite().then_some(Bound::Row(row, side)))
    };
    let of_rows = program.rows.iter().enumerate().flat_map(sides).flatten().map(of);
    let of_slacks = solver
        .slack_multipliers
        .iter()
        .enumerate()
        .map(|(slack, held)| held + of(Bound::Slack(slack)));
    of_rows.chain(of_slacks).collect()
}

proptest! {
    // 256 cases, or the number in PROPTEST_CASES.
    #![proptest_config(ProptestConfig::default())]

    #[test]
    fn large_programs_are_solved_to_optimality_and_never_cost_more_than_by_interior_point(
        seed in any::<u64>(), horizon in 2..21_usize, free in 0.0..1.0_f64, rows in 1..80_usize,
        soft in any::<bool>(), decades in 0.0..6.0_f64
    ) {
        let blocks = 1 + (free * horizon as f64) as usize;
        let slacks = if soft { horizon } else { 0 };
        let shape = Shape { horizon, blocks, rows, slacks, decades, bound_min: 0.0 };
        let program = program(&mut Numbers(seed), shape);
        let (mut ours, mut theirs) = (vec![0.0; program.unknowns()], vec![0.0; program.unknowns()]);
        let mut solver = ActiveSet::new(&program);
        let outcome = solver.solve(&program, &mut ours, &Turn::default());
        let reference = Clarabel::new(&program)
            .map_err(|e: SolverError| TestCaseError::fail(e.to_string()))?
            .solve(&program, &mut theirs, &Turn::default());
        prop_assert_eq!(outcome.status, Status::Solved);
        prop_assert!(keeps(&program, &ours));
        let (dense, multipliers) = (Dense::of(&program), multipliers(&solver, &program));
        let misses = dense.misses(&DVector::from_column_slice(&ours), &multipliers);
        prop_assert!(misses < 1e-6, "{}", misses);
        // Once more, from the rows that are active there.
        let mut again = vec![0.0; program.unknowns()];
        prop_assert!(solver.solve(&program, &mut again, &Turn::default()).usable());
        let multipliers = self::multipliers(&solver, &program);
        let misses = dense.misses(&DVector::from_column_slice(&again), &multipliers);
        prop_assert!(keeps(&program, &again) && misses < 1e-6, "{}", misses);
        // Where curvatures span many decades, the answer of the interior-point method violates
        // bounds within its tolerance, and costs less.
        if reference.usable() {
            let gains = dense.gains(&DVector::from_column_slice(&theirs), &multipliers);
            let (ours, theirs) = (cost(&program, &ours), cost(&program, &theirs));
            prop_assert!(
                ours < theirs + gains + 1e-6 * (1.0 + theirs.abs()),
                "{} is more than {} and {}", ours, theirs, gains
            );
        }
    }
}

#[test]
fn half_of_the_allowed_steps_are_enough() {
    let mut numbers = Numbers(2);
    let mut worst: f64 = 0.0;
    for _ in 0..3000 {
        let horizon = 2 + numbers.below(12);
        let (blocks, rows, slacks) =
            (1 + numbers.below(horizon), 1 + numbers.below(60), [0, horizon][numbers.below(2)]);
        let program = program(
            &mut numbers,
            Shape { horizon, blocks, rows, slacks, decades: 6.0, bound_min: 0.0 },
        );
        let mut x = vec![0.0; program.unknowns()];
        let outcome = ActiveSet::new(&program).solve(&program, &mut x, &Turn::default());
        assert!(outcome.status == Status::Solved && keeps(&program, &x), "{outcome:?}");
        worst = worst.max(f64::from(outcome.iterations) / steps_most(&program) as f64);
    }
    assert!(worst < 0.5, "{worst}");
}

#[test]
fn a_program_that_runs_out_of_steps_is_solved_by_the_interior_point_method()
-> Result<(), SolverError> {
    let mut numbers = Numbers(5);
    for _ in 0..20 {
        let program = program(
            &mut numbers,
            Shape { horizon: 8, blocks: 6, rows: 60, slacks: 8, decades: 2.0, bound_min: 0.0 },
        );
        let (mut whole, mut cut) = (vec![0.0; program.unknowns()], vec![0.0; program.unknowns()]);
        let mut first = Solver::new(SolverSetting::ActiveSet, &program)?;
        assert_eq!(first.solve(&program, &mut whole, &Turn::default()).status, Status::Solved);
        // Another one, which has no bounds of an earlier solution to begin with.
        let mut solver = Solver::new(SolverSetting::ActiveSet, &program)?;
        if let Some(method) = &mut solver.active_set {
            method.most = 1;
            assert_eq!(
                method.solve(&program, &mut cut, &Turn::default()).status,
                Status::OutOfIterations
            );
        }
        assert!(
            solver.solve(&program, &mut cut, &Turn::default()).usable() && keeps(&program, &cut)
        );
        let (whole, cut) = (cost(&program, &whole), cost(&program, &cut));
        assert!((whole - cut).abs() < 1e-5 * (1.0 + whole.abs()), "{whole} {cut}");
    }
    Ok(())
}

#[test]
fn violations_by_rounding_do_not_prevent_termination() {
    let mut numbers = Numbers(6);
    for _ in 0..2000 {
        let mut program = program(
            &mut numbers,
            Shape { horizon: 6, blocks: 4, rows: 40, slacks: 6, decades: 2.0, bound_min: 0.0 },
        );
        let far = 10_f64.powf(4.0 + 4.0 * (0.5 + 0.5 * numbers.next()));
        program
            .stages
            .iter_mut()
            .for_each(|stage| stage.gradient.iter_mut().for_each(|slope| *slope *= far));
        let mut x = vec![0.0; program.unknowns()];
        // It terminates, with any outcome.
        let outcome = ActiveSet::new(&program).solve(&program, &mut x, &Turn::default());
        assert!((outcome.iterations as usize) <= steps_most(&program) + 1, "{outcome:?}");
    }
}

#[test]
fn programs_without_an_answer_have_a_status_and_leave_the_solution_unchanged() {
    let shape = Shape { horizon: 1, blocks: 1, rows: 0, slacks: 0, decades: 0.0, bound_min: 0.0 };
    let mut numbers = Numbers(3);
    let mut contradictory = program(&mut numbers, shape);
    let row = Row {
        stage: 0,
        first: 0,
        by_state: [0.0; 3],
        by_input: [1.0, 0.0, 0.0],
        slack: None,
        bounds: [-1.0, -1.0],
        recurs: true,
    };
    contradictory.rows.push(row);
    let mut flat = program(&mut numbers, shape);
    flat.stages.iter_mut().for_each(|stage| stage.curvature.fill(0.0));
    flat.penalties = Penalties { input: 0.0, change: 0.0, ..flat.penalties };
    let mut unknowable = program(&mut numbers, shape);
    unknowable.stages[0].input_gradient[0] = f64::NAN;
    for (program, status) in
        [(contradictory, Status::Infeasible), (flat, Status::Failed), (unknowable, Status::Failed)]
    {
        let mut untouched = [7.0; 3];
        assert_eq!(
            ActiveSet::new(&program).solve(&program, &mut untouched, &Turn::default()).status,
            status
        );
        assert_eq!(untouched, [7.0; 3]);
    }
}

/// Programs that differ a little from one to the next, and all that `same` changes in them.
fn succession(seed: u64, same: impl Fn(&mut Row)) -> Vec<QuadraticProgram> {
    let shape = Shape { horizon: 6, blocks: 4, rows: 60, slacks: 6, decades: 2.0, bound_min: -0.5 };
    let mut numbers = Numbers(seed);
    let mut program = program(&mut numbers, shape);
    program.rows.iter_mut().for_each(same);
    // Hard rows whose bounds are negative may contradict each other.
    for row in program.rows.iter_mut().filter(|row| row.slack.is_none()) {
        row.bounds = row.bounds.map(f64::abs);
    }
    let mut changed = || {
        for row in &mut program.rows {
            row.by_state.iter_mut().for_each(|slope| *slope += 0.05 * numbers.next());
            row.bounds[0] += if row.slack.is_some() { 0.05 * numbers.next() } else { 0.0 };
        }
        for stage in &mut program.stages {
            stage.gradient.iter_mut().for_each(|slope| *slope += 0.2 * numbers.next());
        }
        program.clone()
    };
    (0..20).map(|_| changed()).collect()
}

#[test]
fn without_rows_that_recur_the_answer_does_not_depend_on_earlier_programs() {
    let programs = succession(4, |row| row.recurs = false);
    let mut one = ActiveSet::new(&programs[0]);
    for program in &programs {
        let (mut used, mut fresh) = ([0.0; 18], [0.0; 18]);
        let outcomes = (
            one.solve(program, &mut used, &Turn::default()),
            ActiveSet::new(program).solve(program, &mut fresh, &Turn::default()),
        );
        assert_eq!((outcomes.0, used), (outcomes.1, fresh));
    }
}

#[test]
fn rows_that_recur_save_steps_and_change_the_answer_by_rounding_alone() {
    let (mut with_memory, mut without) = (0, 0);
    for seed in 0..200 {
        let programs = succession(seed, |row| row.recurs = row.slack.is_some());
        let mut one = ActiveSet::new(&programs[0]);
        for program in &programs {
            let (mut used, mut fresh) = ([0.0; 18], [0.0; 18]);
            let ours = one.solve(program, &mut used, &Turn::default());
            let theirs = ActiveSet::new(program).solve(program, &mut fresh, &Turn::default());
            assert_eq!(ours.status, theirs.status, "{seed}");
            (with_memory, without) = (with_memory + ours.iterations, without + theirs.iterations);
            if theirs.usable() {
                let (ours, theirs) = (cost(program, &used), cost(program, &fresh));
                assert!(keeps(program, &used), "{seed}");
                assert!((ours - theirs).abs() < 1e-7 * (1.0 + theirs.abs()), "{ours} {theirs}");
            }
        }
    }
    assert!(with_memory < without, "{with_memory} steps, {without} without memory");
}
