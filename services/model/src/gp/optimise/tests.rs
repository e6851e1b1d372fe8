#![expect(clippy::unwrap_used, reason = "a test ends at the first error")]

use super::{Convergence, MinimiseError, MinimiseOptions, SearchBox, minimise};
use nalgebra::{DMatrix, DVector, dvector};
use proptest::prelude::*;

fn rosenbrock(x: &DVector<f64>) -> (f64, DVector<f64>) {
    let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
    (a * a + 100.0 * b * b, dvector![-2.0 * a - 400.0 * x[0] * b, 200.0 * b])
}

fn within(lower: DVector<f64>, upper: DVector<f64>) -> SearchBox {
    SearchBox { lower, upper }
}

const TIGHT: MinimiseOptions = MinimiseOptions {
    max_evaluations: 500,
    max_iterations: 500,
    gradient_tolerance: 1e-9,
    decrease_tolerance: 0.0,
    largest_step: f64::INFINITY,
    first_curvature: 1.0,
};

#[test]
fn finds_the_minimum_of_rosenbrocks_valley() {
    let within = within(dvector![-5.0, -5.0], dvector![5.0, 5.0]);
    let minimum = minimise(rosenbrock, &dvector![-1.2, 1.0], &within, &TIGHT).unwrap();
    assert!((minimum.point - dvector![1.0, 1.0]).norm() < 1e-7);
    assert!(minimum.evaluations < 80, "{}", minimum.evaluations);
}

#[test]
fn finds_the_minimum_of_rosenbrocks_valley_on_a_bound() {
    // With x₀ ≤ ½ the minimum is at (½, ¼).
    let within = within(dvector![-2.0, -2.0], dvector![0.5, 2.0]);
    let minimum = minimise(rosenbrock, &dvector![-1.2, 1.0], &within, &TIGHT).unwrap();
    assert!((minimum.point - dvector![0.5, 0.25]).norm() < 1e-7);
}

#[test]
fn a_quadratic_with_its_minimum_outside_ends_on_the_right_face() {
    // ½ (x − c)ᵀ A (x − c), c = (2, 2); on x₀ = 1 the other follows from
    // A₁₀ (1 − 2) + A₁₁ (x₁ − 2) = 0.
    let matrix = DMatrix::from_row_slice(2, 2, &[3.0, 1.0, 1.0, 2.0]);
    let objective = |x: &DVector<f64>| {
        let gradient = &matrix * x.add_scalar(-2.0);
        (0.5 * x.add_scalar(-2.0).dot(&gradient), gradient)
    };
    let within = within(dvector![-1.0, -1.0], dvector![1.0, 3.0]);
    let minimum = minimise(objective, &dvector![-1.0, 0.0], &within, &TIGHT).unwrap();
    assert!((minimum.point - dvector![1.0, 2.5]).norm() < 1e-7);
    assert_eq!(minimum.convergence, Convergence::Gradient);
}

proptest! {
    #[test]
    fn the_projected_gradient_vanishes_at_the_minimum_of_a_convex_quadratic(
        root in prop::collection::vec(-1.0..1.0_f64, 25),
        centre in prop::collection::vec(-3.0..3.0_f64, 5),
        start in prop::collection::vec(-2.0..2.0_f64, 5),
    ) {
        let root = DMatrix::from_vec(5, 5, root);
        let matrix = &root * root.transpose() + DMatrix::identity(5, 5) * 0.1;
        let centre = DVector::from_vec(centre);
        let objective = |x: &DVector<f64>| {
            let gradient = &matrix * (x - &centre);
            (0.5 * (x - &centre).dot(&gradient), gradient)
        };
        let within = within(DVector::repeat(5, -1.0), DVector::repeat(5, 1.0));
        let minimum = minimise(objective, &DVector::from_vec(start), &within, &TIGHT).unwrap();
        let gradient = objective(&minimum.point).1;
        prop_assert!(within.projected(&minimum.point, &gradient).amax() < 1e-6);
        prop_assert!(minimum.point.amax() <= 1.0);
    }

    #[test]
    fn the_budget_is_kept_and_no_step_increases_the_function(budget in 1_usize..40) {
        let within = within(dvector![-5.0, -5.0], dvector![5.0, 5.0]);
        let mut calls = 0;
        let options = MinimiseOptions { max_evaluations: budget, ..TIGHT };
        let counted = |x: &DVector<f64>| { calls += 1; rosenbrock(x) };
        let start = dvector![-1.2, 1.0];
        let minimum = minimise(counted, &start, &within, &options).unwrap();
        prop_assert_eq!(calls, minimum.evaluations);
        prop_assert!(calls <= budget && minimum.value <= rosenbrock(&start).0);
    }
}

#[test]
fn a_region_without_values_is_avoided() {
    let objective = |x: &DVector<f64>| {
        if x[0] <= 0.0 {
            (f64::NAN, dvector![f64::NAN])
        } else {
            (x[0] - x[0].ln(), dvector![1.0 - 1.0 / x[0]])
        }
    };
    let within = within(dvector![f64::NEG_INFINITY], dvector![f64::INFINITY]);
    let minimum = minimise(objective, &dvector![5.0], &within, &TIGHT).unwrap();
    assert!((minimum.point[0] - 1.0).abs() < 1e-7);
}

#[test]
fn a_minimisation_that_cannot_start_reports_the_reason() {
    let unit = within(dvector![0.0], dvector![1.0]);
    let options = MinimiseOptions::default();
    let bad = minimise(|x| (f64::NAN, x.clone()), &dvector![0.5], &unit, &options);
    assert!(matches!(bad, Err(MinimiseError::Start { .. })));
    let bad = minimise(|x| (0.0, x.clone()), &dvector![0.5, 0.5], &unit, &options);
    assert_eq!(bad, Err(MinimiseError::Lengths { start: 2, lower: 1, upper: 1 }));
    let bad = minimise(
        |x| (0.0, x.clone()),
        &dvector![0.5],
        &within(dvector![1.0], dvector![0.0]),
        &options,
    );
    assert_eq!(bad, Err(MinimiseError::EmptyBox { variable: 0, lower: 1.0, upper: 0.0 }));
}
