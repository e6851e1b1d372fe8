//! The fit against the reference problem, which scipy's L-BFGS-B solved: raw inputs, no priors, no
//! restarts.
#![expect(clippy::unwrap_used, reason = "a test ends at the first error")]

#[path = "reference_problem/gp_data.rs"]
mod gp_data;

use model::gp::fit::{FitOptions, fit};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::likelihood::Likelihood;

const START: Hyperparameters<6> = Hyperparameters::new([1.0; 6], 1.0, 0.1);

fn output(targets: &[[f64; 3]], output: usize) -> Vec<f64> {
    targets.iter().map(|target| target[output]).collect()
}

#[test]
fn the_likelihood_of_the_fit_is_that_of_the_reference() {
    let (inputs, targets) = gp_data::gp_data(200, 7);
    for (index, reference) in [210.159, 154.971, 257.895].into_iter().enumerate() {
        let options = FitOptions { max_iterations: 100, ..FitOptions::default() };
        let targets = output(&targets, index);
        let fitted = fit(&inputs, &targets, &START, &options).unwrap();
        assert!(fitted.log_likelihood >= reference - 0.01, "{index}: {fitted:?}");
        let again =
            Likelihood::new(&inputs, &targets).unwrap().evaluate(&fitted.hyperparameters).unwrap();
        assert!((again.log_likelihood - fitted.log_likelihood).abs() < 1e-9);
    }
}

#[test]
fn a_repeated_fit_has_the_same_bits() {
    let (inputs, targets) = gp_data::gp_data(60, 7);
    let targets = output(&targets, 0);
    let once = fit(&inputs, &targets, &START, &FitOptions::default()).unwrap();
    let again = fit(&inputs, &targets, &START, &FitOptions::default()).unwrap();
    assert_eq!(once, again);
}
