#![expect(clippy::unwrap_used, reason = "a test ends at the first error")]
#![expect(clippy::float_cmp, reason = "the test promises the same bits")]

use super::{Posterior, VarianceScratch};
use crate::gp::hyperparameters::Hyperparameters;
use crate::gp::split_mix::SplitMix64;
use faer::traits::pulp::Arch;

#[test]
fn the_bits_do_not_depend_on_the_register_width() {
    let mut random = SplitMix64::new(11);
    let inputs: Vec<[f64; 6]> = (0..77).map(|_| std::array::from_fn(|_| random.normal())).collect();
    let targets: Vec<[f64; 3]> =
        inputs.iter().map(|_| std::array::from_fn(|_| random.normal())).collect();
    let plain = Hyperparameters::new([1.0, 0.5, 2.0, 0.3, 1.0, 1.5], 1.7, 0.05);
    let linear = plain.with_linear(0.2);
    for hyperparameters in [[plain, linear, plain.with_linear(10.0)], [linear.with_place(0.7); 3]] {
        let wide = Posterior::new(&inputs, &targets, &hyperparameters).unwrap();
        let narrow = Posterior { machine: Arch::Scalar, ..wide.clone() };
        let mut scratch = VarianceScratch::new(77);
        for _ in 0..50 {
            let x: [f64; 6] = std::array::from_fn(|_| random.normal());
            assert_eq!(wide.mean_and_gradient(&x), narrow.mean_and_gradient(&x));
            assert_eq!(wide.variance(&x, &mut scratch), narrow.variance(&x, &mut scratch));
        }
    }
}
