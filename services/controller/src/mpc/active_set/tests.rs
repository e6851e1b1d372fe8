use super::*;
use crate::mpc::interior_point::{Clarabel, SolverError};
use proptest::prelude::*;

/// Where the numbers of a program come from.
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
}

/// How a drawn program is shaped.
#[derive(Clone, Copy)]
struct Shape {
    dense: usize,
    rows: usize,
    slacks: usize,
    /// Decades that the curvatures span.
    decades: f64,
}

/// A program whose rows are kept by x = 0, slacks at their bounds, unless `bound_min` is below zero. Some rows are twins, some bounds are 0.
fn program(numbers: &mut Numbers, shape: Shape, bound_min: f64) -> QuadraticProgram {
    let Shape { dense, rows, slacks, decades } = shape;
    let mut program = QuadraticProgram::new(dense + slacks, rows + slacks);
    let factor = DMatrix::from_fn(dense, dense, |_, _| numbers.next());
    let scale = DVector::from_fn(dense, |_, _| 10_f64.powf(0.25 * decades * numbers.next()));
    let hessian = factor.transpose() * &factor + DMatrix::identity(dense, dense) * 0.1;
    for column in 0..dense {
        for row in 0..=column {
            program.hessian[(row, column)] = scale[row] * hessian[(row, column)] * scale[column];
        }
        program.gradient[column] = 5.0 * scale[column] * numbers.next();
    }
    for row in 0..rows {
        let twin = if row > 0 && numbers.below(5) == 0 { Some(numbers.below(row)) } else { None };
        for column in 0..dense {
            let drawn = if numbers.below(3) == 0 { 0.0 } else { numbers.next() };
            program.rows[(row, column)] = twin.map_or(drawn, |twin| program.rows[(twin, column)]);
        }
        if slacks > 0 && numbers.below(2) == 0 {
            program.rows[(row, dense + numbers.below(slacks))] = -1.0;
        }
        program.bounds[row] = if numbers.below(6) == 0 { 0.0 } else { bound_min + (1.0 - bound_min) * (0.5 + 0.5 * numbers.next()) };
    }
    for slack in 0..slacks {
        program.rows[(rows + slack, dense + slack)] = -1.0;
        program.add_square(dense + slack, 1.0, 0.0);
        program.add_linear(dense + slack, 100.0);
    }
    let all = (0..rows + slacks).flat_map(|row| (0..dense + slacks).map(move |column| (row, column)));
    program.set_structure(all.collect());
    program.set_slack_rows((rows..rows + slacks).collect());
    program
}

fn full_hessian(program: &QuadraticProgram) -> DMatrix<f64> {
    DMatrix::from_fn(program.variables(), program.variables(), |row, column| program.hessian[(row.min(column), row.max(column))])
}

/// The answer, by trying every set of active rows.
fn brute_force(program: &QuadraticProgram) -> Option<DVector<f64>> {
    let (unknowns, hessian) = (program.variables(), full_hessian(program));
    (0..1_u32 << program.bounds.len()).filter(|set| set.count_ones() as usize <= unknowns).find_map(|set| {
        let rows: Vec<usize> = (0..program.bounds.len()).filter(|row| set >> row & 1 == 1).collect();
        let size = unknowns + rows.len();
        let mut system = DMatrix::zeros(size, size);
        let mut right = DVector::zeros(size);
        system.view_mut((0, 0), (unknowns, unknowns)).copy_from(&hessian);
        for column in 0..unknowns {
            right[column] = -program.gradient[column];
        }
        for (place, &row) in rows.iter().enumerate() {
            for column in 0..unknowns {
                system[(unknowns + place, column)] = program.rows[(row, column)];
                system[(column, unknowns + place)] = program.rows[(row, column)];
            }
            right[unknowns + place] = program.bounds[row];
        }
        let found = system.clone().lu().solve(&right)?;
        // Twins among the rows make a system singular, and its answer worthless.
        let answers = (system * &found - &right).amax() < 1e-9 * (1.0 + right.amax());
        let x = found.rows(0, unknowns).into_owned();
        let optimal = found.rows(unknowns, rows.len()).iter().all(|multiplier| *multiplier > -1e-7);
        (answers && optimal && program.satisfied_by(x.as_slice(), 1e-7)).then_some(x)
    })
}

fn cost(program: &QuadraticProgram, x: &[f64]) -> f64 {
    let x = DVector::from_column_slice(x);
    (0.5 * full_hessian(program) * &x + DVector::from_column_slice(&program.gradient)).dot(&x)
}

#[test]
fn small_programs_have_the_answer_that_trying_all_sets_of_rows_gives() {
    let mut numbers = Numbers(1);
    let (mut solved, mut infeasible) = (0, 0);
    for _ in 0..100_000 {
        let shape = Shape { dense: 1 + numbers.below(3), rows: 1 + numbers.below(5), slacks: numbers.below(2), decades: 4.0 };
        let bound_min = if numbers.below(4) == 0 { -0.5 } else { 0.0 };
        let program = program(&mut numbers, shape, bound_min);
        let mut x = vec![0.0; program.variables()];
        let outcome = ActiveSet::new(&program).solve(&program, &mut x, &Turn::default());
        match brute_force(&program) {
            Some(exact) => {
                assert_eq!(outcome.status, Status::Solved, "{exact} {:?} {:?}", program.rows, program.bounds);
                let (ours, best) = (cost(&program, &x), cost(&program, exact.as_slice()));
                assert!(
                    program.satisfied_by(&x, 1e-7) && (ours - best).abs() < 1e-6 * (1.0 + best.abs()),
                    "{x:?} costs {ours}, {exact} {best}"
                );
                solved += 1;
            }
            None if outcome.status == Status::Solved => assert!(program.satisfied_by(&x, 1e-7), "{x:?}"),
            None => infeasible += 1,
        }
    }
    assert!(solved > 80_000 && infeasible > 1_000, "{solved} solved, {infeasible} infeasible");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn large_programs_have_the_answer_of_the_interior_point_method(
        seed in any::<u64>(), dense in 6..31_usize, rows in 1..120_usize, slacks in 0..8_usize, decades in 0.0..6.0_f64
    ) {
        let mut numbers = Numbers(seed);
        let program = program(&mut numbers, Shape { dense, rows, slacks, decades }, 0.0);
        let (mut ours, mut theirs) = (vec![0.0; program.variables()], vec![0.0; program.variables()]);
        let outcome = ActiveSet::new(&program).solve(&program, &mut ours, &Turn::default());
        let reference = Clarabel::new(&program).map_err(|e: SolverError| TestCaseError::fail(e.to_string()))?.solve(&program, &mut theirs, &Turn::default());
        prop_assert_eq!(outcome.status, Status::Solved);
        prop_assert!(program.satisfied_by(&ours, 1e-7));
        if reference.usable() {
            let (ours, theirs) = (cost(&program, &ours), cost(&program, &theirs));
            prop_assert!(ours < theirs + 1e-6 * (1.0 + theirs.abs()), "{} is more than {}", ours, theirs);
        }
    }
}

#[test]
fn what_cannot_be_answered_is_said() {
    let shape = Shape { dense: 2, rows: 2, slacks: 0, decades: 0.0 };
    let mut numbers = Numbers(3);
    let mut contradictory = program(&mut numbers, shape, 0.0);
    for (row, sign) in [(0, 1.0), (1, -1.0)] {
        (contradictory.rows[(row, 0)], contradictory.rows[(row, 1)]) = (sign, 0.0);
    }
    contradictory.bounds.copy_from_slice(&[-1.0, -1.0]);
    let mut flat = program(&mut numbers, shape, 0.0);
    flat.hessian.fill(0.0);
    let mut unknowable = program(&mut numbers, shape, 0.0);
    unknowable.gradient[0] = f64::NAN;
    for (program, status) in [(contradictory, Status::Infeasible), (flat, Status::Failed), (unknowable, Status::Failed)] {
        let mut untouched = [7.0; 2];
        assert_eq!(ActiveSet::new(&program).solve(&program, &mut untouched, &Turn::default()).status, status);
        assert_eq!(untouched, [7.0; 2]);
    }
}

#[test]
fn the_answer_does_not_depend_on_what_was_solved_before() {
    let shape = Shape { dense: 12, rows: 60, slacks: 4, decades: 2.0 };
    let mut numbers = Numbers(4);
    let programs: Vec<QuadraticProgram> = (0..10).map(|_| program(&mut numbers, shape, 0.0)).collect();
    let mut one = ActiveSet::new(&programs[0]);
    for program in &programs {
        let (mut used, mut fresh) = ([0.0; 16], [0.0; 16]);
        let outcomes =
            (one.solve(program, &mut used, &Turn::default()), ActiveSet::new(program).solve(program, &mut fresh, &Turn::default()));
        assert_eq!((outcomes.0, used), (outcomes.1, fresh));
    }
}
