//! Laws that the posterior obeys.
#![expect(clippy::unwrap_used, reason = "a test ends at the first error")]
#![expect(clippy::float_cmp, reason = "without a sum the result is exact")]

use model::gp::data::DataError;
use model::gp::hyperparameters::Hyperparameters;
use model::gp::kernel::Kernel;
use model::gp::posterior::{MeanAndGradient, Posterior, PosteriorError, VarianceScratch};
use model::gp::split_mix::SplitMix64;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

const D: usize = 3;

fn hyperparameters(noise_variance: f64) -> [Hyperparameters<D>; 3] {
    [
        Hyperparameters::new([1.0, 2.0, 0.7], 1.3, noise_variance),
        Hyperparameters::new([0.5, 0.9, 5.0], 0.4, noise_variance),
        Hyperparameters::new([2.0, 2.0, 2.0], 2.0, noise_variance),
    ]
}

/// The same, of which two have a linear part.
fn with_linear(noise_variance: f64) -> [Hyperparameters<D>; 3] {
    let [first, second, third] = hyperparameters(noise_variance);
    [first.with_linear(0.5), second, third.with_linear(3.0)]
}

fn samples(count: usize, seed: u64) -> (Vec<[f64; D]>, Vec<[f64; 3]>) {
    let mut random = SplitMix64::new(seed);
    let mut draw = || {
        let x: [f64; D] = std::array::from_fn(|_| random.normal());
        (x, [(2.0 * x[0]).sin() + x[1], x[1] * x[2], (x[0] + x[2]).cos()])
    };
    (0..count).map(|_| draw()).unzip()
}

fn query() -> impl Strategy<Value = [f64; D]> {
    prop::array::uniform3(-4.0..4.0)
}

/// Eqs. 2.25 and 2.26 of Rasmussen & Williams, written out.
fn textbook(
    inputs: &[[f64; D]],
    targets: &[f64],
    hyperparameters: &Hyperparameters<D>,
    x: &[f64; D],
) -> (f64, f64) {
    let kernel: &Kernel<D> = &hyperparameters.kernel;
    let count = inputs.len();
    let covariance = DMatrix::from_fn(count, count, |i, j| kernel.value(&inputs[i], &inputs[j]))
        + DMatrix::identity(count, count) * hyperparameters.noise_variance;
    let column = DVector::from_fn(count, |i, _| kernel.value(&inputs[i], x));
    let solved = covariance.cholesky().unwrap().solve(&column);
    (solved.dot(&DVector::from_column_slice(targets)), kernel.prior(x) - solved.dot(&column))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn mean_and_variance_are_those_of_the_textbook(
        count in 1_usize..40,
        seed in any::<u64>(),
        x in query(),
    ) {
        let (inputs, targets) = samples(count, seed);
        let hyperparameters = with_linear(0.01);
        let posterior = Posterior::new(&inputs, &targets, &hyperparameters).unwrap();
        let mean = posterior.mean(&x);
        let variance = posterior.variance(&x, &mut VarianceScratch::new(count));
        for output in 0..3 {
            let of_one: Vec<f64> = targets.iter().map(|target| target[output]).collect();
            let expected = textbook(&inputs, &of_one, &hyperparameters[output], &x);
            prop_assert!((mean[output] - expected.0).abs() < 1e-10);
            prop_assert!((variance[output] - expected.1).abs() < 1e-10);
        }
    }

    #[test]
    fn gradient_matches_finite_differences(
        count in 0_usize..60,
        seed in any::<u64>(),
        x in query(),
    ) {
        let (inputs, targets) = samples(count, seed);
        let posterior = Posterior::new(&inputs, &targets, &with_linear(0.01)).unwrap();
        let MeanAndGradient { mean, gradient } = posterior.mean_and_gradient(&x);
        prop_assert_eq!(mean.map(f64::to_bits), posterior.mean(&x).map(f64::to_bits));
        for input in 0..D {
            let (mut above, mut below) = (x, x);
            above[input] += 1e-5;
            below[input] -= 1e-5;
            let (above, below) = (posterior.mean(&above), posterior.mean(&below));
            for output in 0..3 {
                let difference = (above[output] - below[output]) / 2e-5;
                prop_assert!((gradient[output][input] - difference).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn variance_lies_between_zero_and_the_prior(
        count in 0_usize..60,
        seed in any::<u64>(),
        x in query(),
        log_noise in -30.0..0.0_f64,
    ) {
        let (inputs, targets) = samples(count, seed);
        let hyperparameters = with_linear(log_noise.exp());
        let posterior = Posterior::new(&inputs, &targets, &hyperparameters).unwrap();
        let mut scratch = VarianceScratch::new(count);
        for place in inputs.iter().chain([&x]) {
            let variances = posterior.variance(place, &mut scratch);
            for (variance, of_one) in variances.iter().zip(&hyperparameters) {
                prop_assert!((0.0..=of_one.kernel.prior(place)).contains(variance));
            }
        }
    }

    #[test]
    fn the_mean_interpolates_samples_of_almost_no_noise(
        count in 1_usize..30,
        seed in any::<u64>(),
    ) {
        let (inputs, targets) = samples(count, seed);
        let posterior = Posterior::new(&inputs, &targets, &hyperparameters(1e-8)).unwrap();
        let mut scratch = VarianceScratch::new(count);
        for (input, target) in inputs.iter().zip(&targets) {
            let (mean, variance) = (posterior.mean(input), posterior.variance(input, &mut scratch));
            for output in 0..3 {
                prop_assert!((mean[output] - target[output]).abs() < 1e-2);
                prop_assert!(variance[output] < 1e-6);
            }
        }
    }

    #[test]
    fn without_samples_the_posterior_is_the_prior(x in query()) {
        let hyperparameters = with_linear(0.1);
        let of_no_samples = Posterior::new(&[], &[], &hyperparameters);
        for posterior in [of_no_samples, Posterior::prior_only(&hyperparameters)] {
            let posterior = posterior.unwrap();
            let zero = MeanAndGradient { mean: [0.0; 3], gradient: [[0.0; D]; 3] };
            prop_assert_eq!(posterior.mean_and_gradient(&x), zero);
            let variance = posterior.variance(&x, &mut VarianceScratch::new(0));
            prop_assert_eq!(variance, hyperparameters.map(|of_one| of_one.kernel.prior(&x)));
        }
    }

    #[test]
    fn a_plane_is_extrapolated_beyond_the_data(seed in any::<u64>(), x in query()) {
        let (inputs, _) = samples(20, seed);
        let plane = |x: &[f64; D]| 0.3 + 2.0 * x[0] - x[1] + 0.5 * x[2];
        let targets: Vec<[f64; 3]> = inputs.iter().map(|x| [plane(x); 3]).collect();
        let linear = Hyperparameters::new([1.0; D], 1e-6, 1e-8).with_linear(1.0);
        let posterior = Posterior::new(&inputs, &targets, &[linear; 3]).unwrap();
        let far = x.map(|value| 10.0 * value);
        let error = (posterior.mean(&far)[0] - plane(&far)).abs();
        prop_assert!(error < 0.05 * (1.0 + plane(&far).abs()));
    }
}

#[test]
fn far_from_all_samples_the_posterior_is_the_prior() {
    let (inputs, targets) = samples(20, 1);
    let hyperparameters = hyperparameters(0.1);
    let posterior = Posterior::new(&inputs, &targets, &hyperparameters).unwrap();
    let far = [1e3, -1e3, 1e150];
    assert_eq!(posterior.mean(&far), [0.0; 3]);
    assert_eq!(
        posterior.variance(&far, &mut VarianceScratch::new(20)),
        hyperparameters.map(|of_one| of_one.kernel.variance)
    );
}

#[test]
fn duplicate_inputs_need_only_a_jitter() {
    let (mut inputs, mut targets) = samples(20, 2);
    for twin in 10..20 {
        inputs[twin] = inputs[twin - 10];
        targets[twin] = targets[twin - 10];
    }
    let posterior = Posterior::new(&inputs, &targets, &hyperparameters(1e-18)).unwrap();
    assert!(
        posterior.jitter().iter().all(|&jitter| jitter > 0.0 && jitter < 1e-6),
        "{:?}",
        posterior.jitter()
    );
    let mean = posterior.mean(&inputs[3]);
    assert!(mean.iter().zip(&targets[3]).all(|(mean, target)| (mean - target).abs() < 1e-3));
}

#[test]
fn rounding_does_not_make_a_variance_negative() {
    // One sample with almost no noise: σ² − ‖L⁻¹k‖² at the sample is only rounding, of either sign.
    let mut scratch = VarianceScratch::new(1);
    for prior in 1..100 {
        let certain = [Hyperparameters::new([1.0; D], f64::from(prior), 1e-20); 3];
        let posterior = Posterior::new(&[[0.5; D]], &[[1.0; 3]], &certain).unwrap();
        assert!(
            posterior.variance(&[0.5; D], &mut scratch).iter().all(|&variance| variance >= 0.0)
        );
    }
}

#[test]
fn distinct_samples_need_no_jitter_and_their_weights_solve_the_system() {
    let (inputs, targets) = samples(30, 3);
    let hyperparameters = hyperparameters(0.01);
    let posterior = Posterior::new(&inputs, &targets, &hyperparameters).unwrap();
    assert_eq!(posterior.jitter(), [0.0; 3]);
    assert_eq!(posterior.samples(), 30);
    for (output, weights) in posterior.weights().into_iter().enumerate() {
        for (sample, target) in targets.iter().enumerate() {
            let sum: f64 = inputs
                .iter()
                .zip(weights)
                .map(|(input, weight)| {
                    weight * hyperparameters[output].kernel.value(input, &inputs[sample])
                })
                .sum();
            assert!((sum + 0.01 * weights[sample] - target[output]).abs() < 1e-11);
        }
    }
}

#[test]
fn a_query_with_nan_returns_nan() {
    let (inputs, targets) = samples(9, 3);
    let posterior = Posterior::new(&inputs, &targets, &hyperparameters(0.01)).unwrap();
    assert!(posterior.mean(&[0.0, f64::NAN, 0.0]).iter().all(|mean| mean.is_nan()));
}

#[test]
fn a_scratch_that_is_too_small_grows() {
    let (inputs, targets) = samples(30, 3);
    let posterior = Posterior::new(&inputs, &targets, &hyperparameters(0.01)).unwrap();
    let x = [0.1, 0.2, 0.3];
    let grown = posterior.variance(&x, &mut VarianceScratch::new(0));
    assert_eq!(grown, posterior.variance(&x, &mut VarianceScratch::new(500)));
}

#[test]
fn bad_samples_and_hyperparameters_are_rejected_with_their_index() {
    let (inputs, mut targets) = samples(4, 3);
    let good = hyperparameters(0.1);
    assert_eq!(
        Posterior::new(&inputs[1..], &targets, &good).err(),
        Some(PosteriorError::Data(DataError::Lengths { inputs: 3, targets: 4 }))
    );
    let mut bad = good;
    bad[1].noise_variance = 0.0;
    let message = Posterior::new(&inputs, &targets, &bad).err().unwrap().to_string();
    assert_eq!(message, "output 1: the noise variance is 0; it must be positive and finite");
    targets[2][1] = f64::NEG_INFINITY;
    let message = Posterior::new(&inputs, &targets, &good).err().unwrap().to_string();
    assert_eq!(message, "target 1 of sample 2 is -inf");
}

#[test]
fn a_posterior_can_move_to_another_thread() {
    fn is_send<T: Send>() {}
    is_send::<Posterior<D>>();
}
