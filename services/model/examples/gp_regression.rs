//! Gaussian-process regression alone: `cargo run -p model --example gp_regression`.
//!
//! Fits the hyperparameters to 40 samples of sin(x), and prints mean and deviation of three
//! queries: two between the samples, and one far away from them.

use model::gp::fit::{FitOptions, fit};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::posterior::{Posterior, VarianceScratch};
use std::error::Error;
use std::io::{self, Write};

fn main() -> Result<(), Box<dyn Error>> {
    let inputs: Vec<[f64; 1]> = (0..40).map(|i| [0.2 * f64::from(i)]).collect();
    let values: Vec<f64> = inputs.iter().map(|[x]| x.sin() + 0.01 * (37.0 * x).sin()).collect();
    let start = Hyperparameters::new([1.0], 1.0, 1e-2); // length scale, variance, noise variance
    let fitted = fit(&inputs, &values, &start, &FitOptions::default())?;
    // The posterior has three outputs, one for each axis of a body velocity.
    let targets: Vec<[f64; 3]> = values.iter().map(|&value| [value, 0.0, 0.0]).collect();
    let posterior = Posterior::new(&inputs, &targets, &[fitted.hyperparameters; 3])?;
    let mut scratch = VarianceScratch::new(posterior.samples());
    let mut out = io::stdout();
    writeln!(out, "noise {:.4}", fitted.hyperparameters.noise_variance.sqrt())?;
    for x in [1.1, 4.3, 30.0] {
        let [mean, ..] = posterior.mean(&[x]);
        let [variance, ..] = posterior.variance(&[x], &mut scratch);
        writeln!(
            out,
            "x {x:.1} sin {:.4} mean {mean:.4} deviation {:.4}",
            x.sin(),
            variance.sqrt()
        )?;
    }
    Ok(())
}
