//! Figures that are also measured on peers, one JSON line each: time per kernel term, fits from the
//! start to convergence, and samples inserted into a full dictionary.
//!
//! `taskset -c 1 cargo bench -p model --bench learner`
#![expect(clippy::disallowed_methods, reason = "a bench has a clock")]
#![expect(clippy::print_stdout, reason = "a bench prints its figures")]

#[path = "../tests/reference_problem/gp_data.rs"]
mod gp_data;

use model::gp::dictionary::{Dictionary, Observation, Selection};
use model::gp::fit::{FitOptions, fit};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::normalisation::Normalisation;
use model::gp::posterior::Posterior;
use serde_json::json;
use std::error::Error;
use std::hint::black_box;
use std::time::Instant;

const START: Hyperparameters<6> = Hyperparameters::new([1.0; 6], 1.0, 0.1);
const TYPICAL: Hyperparameters<6> =
    Hyperparameters::new([2.0, 2.0, 1.0, 2.5, 2.5, 1.2], 1.0, 0.0025);

fn main() -> Result<(), Box<dyn Error>> {
    for points in [50, 100, 200, 500, 1000, 2000] {
        query(points)?;
    }
    for points in [200, 500] {
        learn(points);
    }
    for kept in [100, 200, 400] {
        keep(kept)?;
    }
    Ok(())
}

/// Mean and Jacobian of three outputs, at the inputs of the samples.
fn query(points: usize) -> Result<(), Box<dyn Error>> {
    let (inputs, targets) = gp_data::gp_data(points, 7);
    let posterior = Posterior::new(&inputs, &targets, &[TYPICAL; 3])?;
    let (queries, _) = gp_data::gp_data(1000, 99);
    let micros = median((0..200).map(|_| {
        let begin = Instant::now();
        for query in &queries {
            black_box(posterior.mean_and_gradient(black_box(query)));
        }
        1e6 * begin.elapsed().as_secs_f64() / queries.len() as f64
    }));
    println!(
        "{}",
        json!({
            "query": "mean and Jacobian",
            "M": points,
            "p50_us": micros,
            "ns_per_term": 1e3 * micros / (3 * points) as f64,
        })
    );
    Ok(())
}

/// Fits the hyperparameters of three outputs, raw inputs, no priors, no restarts.
fn learn(points: usize) {
    let (inputs, targets) = gp_data::gp_data(points, 7);
    let options = FitOptions { max_iterations: 100, ..FitOptions::default() };
    let mut likelihoods = [0.0; 3];
    let mut fits = |_| {
        let begin = Instant::now();
        for (output, likelihood) in likelihoods.iter_mut().enumerate() {
            let of_one: Vec<f64> = targets.iter().map(|target| target[output]).collect();
            *likelihood = fit(&inputs, &of_one, &START, &options)
                .map_or(f64::NAN, |fitted| fitted.log_likelihood);
        }
        begin.elapsed().as_secs_f64()
    };
    let seconds = median((0..5).map(&mut fits));
    println!(
        "{}",
        json!({ "fit": "three outputs", "n": points, "fit_s": seconds, "lml_each": likelihoods })
    );
}

/// Inserts samples one by one into a full dictionary.
fn keep(kept: usize) -> Result<(), Box<dyn Error>> {
    let mut dictionary = Dictionary::new(Selection {
        capacity: kept,
        normalisation: Normalisation::IDENTITY,
        kernel: TYPICAL.with_linear(1.0),
        memory_samples: 2000.0,
        noise_floor: [0.2; 3],
    });
    let (inputs, targets) = gp_data::gp_data(kept + 4000, 7);
    let mut times = Vec::new();
    for (input, target) in inputs.into_iter().zip(targets) {
        let full = dictionary.len() == kept;
        let begin = Instant::now();
        black_box(dictionary.insert(Observation { input, target }));
        if full {
            times.push(1e6 * begin.elapsed().as_secs_f64());
        }
    }
    times.sort_by(f64::total_cmp);
    let at = |share: f64| {
        times
            .get((share * times.len() as f64) as usize)
            .copied()
            .ok_or("the dictionary was never full")
    };
    println!(
        "{}",
        json!({
            "dictionary": "a sample into a full one",
            "n": kept,
            "p50_us": at(0.5)?,
            "p99_us": at(0.99)?,
            "samples": times.len(),
        })
    );
    Ok(())
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
