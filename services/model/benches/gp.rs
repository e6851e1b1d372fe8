//! Time of a query in the controller and of a fit in the learner, on the samples of the reference
//! problem.
#![expect(clippy::unwrap_used, reason = "a bench ends at the first error")]

#[path = "../tests/reference_problem/gp_data.rs"]
mod gp_data;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use model::gp::fit::{FitOptions, fit};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::likelihood::Likelihood;
use model::gp::posterior::{Posterior, VarianceScratch};

const START: Hyperparameters<6> = Hyperparameters::new([1.0; 6], 1.0, 0.1);
const TYPICAL: Hyperparameters<6> =
    Hyperparameters::new([2.0, 2.0, 1.0, 2.5, 2.5, 1.2], 1.0, 0.0025);
const QUERY: [f64; 6] = [1.0, -0.5, 0.2, 1.2, -0.6, 0.1];

fn fit_all(
    inputs: &[[f64; 6]],
    targets: &[[f64; 3]],
    start: &[Hyperparameters<6>; 3],
    options: &FitOptions<6>,
) -> [Hyperparameters<6>; 3] {
    std::array::from_fn(|output| {
        let of_one: Vec<f64> = targets.iter().map(|target| target[output]).collect();
        fit(inputs, &of_one, &start[output], options).unwrap().hyperparameters
    })
}

fn query(criterion: &mut Criterion) {
    for samples in [100, 200, 500] {
        let (inputs, targets) = gp_data::gp_data(samples, 7);
        let posterior = Posterior::new(&inputs, &targets, &[TYPICAL; 3]).unwrap();
        let mut scratch = VarianceScratch::new(samples);
        criterion.bench_with_input(
            BenchmarkId::new("mean and gradient, 3 outputs", samples),
            &posterior,
            |bencher, posterior| {
                bencher.iter(|| posterior.mean_and_gradient(black_box(&QUERY)));
            },
        );
        criterion.bench_with_input(
            BenchmarkId::new("mean, 3 outputs", samples),
            &posterior,
            |bencher, posterior| {
                bencher.iter(|| posterior.mean(black_box(&QUERY)));
            },
        );
        criterion.bench_with_input(
            BenchmarkId::new("variance, 3 outputs", samples),
            &posterior,
            |bencher, posterior| {
                bencher.iter(|| posterior.variance(black_box(&QUERY), &mut scratch));
            },
        );
        criterion.bench_with_input(
            BenchmarkId::new("condition, 3 outputs", samples),
            &samples,
            |bencher, _| {
                bencher.iter(|| Posterior::new(black_box(&inputs), &targets, &[TYPICAL; 3]));
            },
        );
        let of_one: Vec<f64> = targets.iter().map(|target| target[0]).collect();
        let mut likelihood = Likelihood::new(&inputs, &of_one).unwrap();
        criterion.bench_with_input(
            BenchmarkId::new("likelihood and gradient, 1 output", samples),
            &samples,
            |bencher, _| {
                bencher.iter(|| likelihood.evaluate(black_box(&TYPICAL)));
            },
        );
    }
}

fn learn(criterion: &mut Criterion) {
    let (inputs, targets) = gp_data::gp_data(200, 7);
    let cold = FitOptions { max_iterations: 100, ..FitOptions::default() };
    criterion.bench_function("fit from the start, 3 outputs, 200 samples", |bencher| {
        bencher.iter(|| fit_all(black_box(&inputs), &targets, &[START; 3], &cold));
    });

    // The window moves by ten samples; the search begins at the previous optimum.
    let before = fit_all(&inputs[..100], &targets[..100], &[START; 3], &cold);
    let warm = FitOptions { max_evaluations: 12, ..FitOptions::default() };
    criterion.bench_function("refit with 12 evaluations, 3 outputs, 100 samples", |bencher| {
        bencher.iter(|| fit_all(black_box(&inputs[10..110]), &targets[10..110], &before, &warm));
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = query, learn
}
criterion_main!(benches);
