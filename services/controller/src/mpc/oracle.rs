//! The cost of a program in stages without stages, and its answer by exhaustive search: slow, and
//! straight from the definition.

use super::qp::{BEFORE, INPUT, QuadraticProgram, STATE, Vector, WIDTH};
use nalgebra::{DMatrix, DVector, SMatrix};

/// Unknowns and the states that follow from them.
struct Point {
    unknowns: DVector<f64>,
    states: Vec<Vector>,
}

impl Point {
    fn new(program: &QuadraticProgram, unknowns: DVector<f64>) -> Self {
        let mut states = vec![[0.0; WIDTH]; program.stages.len()];
        program.follow(unknowns.as_slice(), &mut states);
        Self { unknowns, states }
    }

    fn unit(program: &QuadraticProgram, unknown: usize) -> Self {
        Self::new(
            program,
            DVector::from_fn(program.unknowns(), |row, _| if row == unknown { 1.0 } else { 0.0 }),
        )
    }

    fn input(&self, k: usize, axis: usize) -> f64 {
        self.unknowns[INPUT * k + axis]
    }
}

/// aᵀ H b, as the module of the program has it.
fn curvature(program: &QuadraticProgram, a: &Point, b: &Point) -> f64 {
    let (penalties, slacks) = (&program.penalties, INPUT * program.blocks()..program.unknowns());
    let mut sum: f64 =
        slacks.map(|slack| penalties.slack_curvature * a.unknowns[slack] * b.unknowns[slack]).sum();
    for (k, stage) in program.stages.iter().enumerate() {
        let x =
            |point: &Point| SMatrix::<f64, STATE, 1>::from_column_slice(&point.states[k][..STATE]);
        sum += x(a).dot(&(stage.curvature * x(b)));
        for axis in 0..3 {
            let before = |point: &Point| point.states[k][BEFORE + axis];
            if k < program.blocks() {
                let change = |point: &Point| point.input(k, axis) - before(point);
                sum += penalties.input * a.input(k, axis) * b.input(k, axis)
                    + penalties.change * change(a) * change(b);
            } else if k < program.horizon() {
                sum += penalties.input * before(a) * before(b);
            }
        }
    }
    sum
}

fn slope(program: &QuadraticProgram, at: &Point) -> f64 {
    let slacks = at
        .unknowns
        .iter()
        .skip(INPUT * program.blocks())
        .map(|slack| program.penalties.slack * slack);
    let states = program
        .stages
        .iter()
        .zip(&at.states)
        .flat_map(|(stage, state)| stage.gradient.into_iter().zip(*state));
    let inputs = program
        .stages
        .iter()
        .take(program.blocks())
        .flat_map(|stage| stage.input_gradient)
        .zip(at.unknowns.iter().copied());
    slacks.sum::<f64>() + states.chain(inputs).map(|(slope, by)| slope * by).sum::<f64>()
}

pub(crate) fn cost(program: &QuadraticProgram, unknowns: &[f64]) -> f64 {
    let at = Point::new(program, DVector::from_column_slice(unknowns));
    0.5 * curvature(program, &at, &at) + slope(program, &at)
}

pub(crate) fn keeps(program: &QuadraticProgram, unknowns: &[f64]) -> bool {
    let at = Point::new(program, DVector::from_column_slice(unknowns));
    program.satisfied_by(unknowns, &at.states, 1e-7)
}

/// The same program without stages: H, h, and rows G x ≤ b.
pub(crate) struct Dense {
    pub(crate) hessian: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
    rows: Vec<(DVector<f64>, f64)>,
}

impl Dense {
    pub(crate) fn of(program: &QuadraticProgram) -> Self {
        let units: Vec<Point> =
            (0..program.unknowns()).map(|unknown| Point::unit(program, unknown)).collect();
        let free = INPUT * program.blocks();
        let mut rows = Vec::new();
        for row in &program.rows {
            let value = DVector::from_iterator(
                units.len(),
                units.iter().map(|unit| {
                    row.value(&unit.states, unit.unknowns.as_slice()[..free].as_chunks::<INPUT>().0)
                }),
            );
            for (bound, sign) in
                row.bounds.iter().zip([1.0, -1.0]).filter(|(bound, _)| bound.is_finite())
            {
                let mut value = sign * &value;
                if let Some(slack) = row.slack {
                    value[free + slack] = -1.0;
                }
                rows.push((value, *bound));
            }
        }
        rows.extend((free..program.unknowns()).map(|slack| (-&units[slack].unknowns, 0.0)));
        Self {
            hessian: DMatrix::from_fn(units.len(), units.len(), |row, column| {
                curvature(program, &units[row], &units[column])
            }),
            gradient: DVector::from_fn(units.len(), |row, _| slope(program, &units[row])),
            rows,
        }
    }

    /// Distance of `x`, with a multiplier per row, from a solution (Karush, Kuhn and Tucker): the
    /// largest of three errors, each relative to its terms. They are the remaining gradient, a
    /// multiplier below zero, and the distance from its bound of a row with a multiplier. Rows are
    /// those of the program with a bound, upper before lower, then slacks.
    pub(crate) fn misses(&self, x: &DVector<f64>, multipliers: &[f64]) -> f64 {
        assert_eq!(multipliers.len(), self.rows.len());
        let bent = &self.hessian * x;
        let (mut left, mut scale) =
            (&bent + &self.gradient, bent.abs() + self.gradient.abs().add_scalar(1.0));
        let most = multipliers.iter().copied().fold(1.0, f64::max);
        let mut misses: f64 = 0.0;
        for ((row, bound), &multiplier) in self.rows.iter().zip(multipliers) {
            left += row * multiplier;
            scale += row.abs() * multiplier.abs();
            misses = misses.max(-multiplier / most);
            if multiplier > 1e-9 * most {
                let made_of = 1.0 + bound.abs() + row.abs().dot(&x.abs());
                misses = misses.max((row.dot(x) - bound).abs() / made_of);
            }
        }
        misses.max(left.abs().component_div(&scale).max())
    }

    /// Largest cost that `x` can save against the answer with these multipliers, because of its
    /// violated bounds (weak duality).
    pub(crate) fn gains(&self, x: &DVector<f64>, multipliers: &[f64]) -> f64 {
        self.rows
            .iter()
            .zip(multipliers)
            .map(|((row, bound), multiplier)| multiplier * (row.dot(x) - bound).max(0.0))
            .sum()
    }

    /// The answer, found by trying every set of active rows.
    pub(crate) fn brute_force(&self) -> Option<DVector<f64>> {
        let unknowns = self.gradient.len();
        (0..1_u32 << self.rows.len()).filter(|set| set.count_ones() as usize <= unknowns).find_map(
            |set| {
                let active: Vec<&(DVector<f64>, f64)> = self
                    .rows
                    .iter()
                    .enumerate()
                    .filter(|(row, _)| set >> row & 1 == 1)
                    .map(|(_, row)| row)
                    .collect();
                let size = unknowns + active.len();
                let mut system = DMatrix::zeros(size, size);
                let mut right = DVector::zeros(size);
                system.view_mut((0, 0), (unknowns, unknowns)).copy_from(&self.hessian);
                right.rows_mut(0, unknowns).copy_from(&-&self.gradient);
                for (place, (row, bound)) in active.iter().enumerate() {
                    system
                        .view_mut((unknowns + place, 0), (1, unknowns))
                        .copy_from(&row.transpose());
                    system.view_mut((0, unknowns + place), (unknowns, 1)).copy_from(row);
                    right[unknowns + place] = *bound;
                }
                let found = system.clone().lu().solve(&right)?;
                // Duplicate rows make a system singular, and its answer invalid.
                let answers = (system * &found - &right).amax() < 1e-9 * (1.0 + right.amax());
                let x = found.rows(0, unknowns).into_owned();
                let optimal =
                    found.rows(unknowns, active.len()).iter().all(|multiplier| *multiplier > -1e-7);
                let kept = self
                    .rows
                    .iter()
                    .all(|(row, bound)| row.dot(&x) <= bound + 1e-7 * (1.0 + bound.abs()));
                (answers && optimal && kept).then_some(x)
            },
        )
    }
}
