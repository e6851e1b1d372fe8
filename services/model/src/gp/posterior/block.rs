//! Eight samples side by side, in the order of vector registers.

use crate::gp::exponential::exponential;
use std::ops::Range;

/// Samples in a block.
pub(super) const LANES: usize = 8;

/// Eight samples side by side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block<const D: usize> {
    /// X / ℓ
    pub(super) inputs: [[f64; LANES]; D],
    /// σ² α
    pub(super) weights: [f64; LANES],
    /// π² α
    pub(super) place_weights: [f64; LANES],
}

impl<const D: usize> Block<D> {
    /// Samples of zero weight.
    pub(super) const EMPTY: Self =
        Self { inputs: [[0.0; LANES]; D], weights: [0.0; LANES], place_weights: [0.0; LANES] };

    /// 1 + (X/ℓ)·x of each sample.
    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn one_plus_products(&self, x: &[f64]) -> [f64; LANES] {
        let mut products = [1.0; LANES];
        for (inputs, x) in self.inputs.iter().zip(x) {
            for (sum, input) in products.iter_mut().zip(inputs) {
                *sum += input * x;
            }
        }
        products
    }

    /// weight · exp(−½ ‖x − X‖²) of each sample over some inputs, everything in length scales.
    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn shares(
        &self,
        x: &[f64; D],
        over: Range<usize>,
        weights: &[f64; LANES],
    ) -> [f64; LANES] {
        let mut shares = [0.0; LANES];
        for (inputs, x) in self.inputs[over.clone()].iter().zip(&x[over]) {
            for (sum, input) in shares.iter_mut().zip(inputs) {
                let difference = input - x;
                *sum += difference * difference;
            }
        }
        for (share, weight) in shares.iter_mut().zip(weights) {
            *share = weight * exponential(-0.5 * *share);
        }
        shares
    }

    /// gradient −= share · (x − X) of each sample over some inputs, everything in length scales.
    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn add_slopes(
        &self,
        x: &[f64; D],
        over: Range<usize>,
        shares: &[f64; LANES],
        gradient: &mut [[f64; LANES]; D],
    ) {
        for input in over {
            for ((sum, share), own) in
                gradient[input].iter_mut().zip(shares).zip(&self.inputs[input])
            {
                *sum += share * (own - x[input]);
            }
        }
    }
}

/// sums += shares
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
pub(super) fn add(sums: &mut [f64; LANES], shares: &[f64; LANES]) {
    for (sum, share) in sums.iter_mut().zip(shares) {
        *sum += share;
    }
}
