//! One output: its samples, weights and factor.

use super::block::{Block, LANES, add};
use crate::gp::covariance::{Covariance, factor_scratch, factorise};
use crate::gp::hyperparameters::Hyperparameters;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::{Mat, MatMut, Par};

/// Posterior of one function.
#[derive(Debug, Clone)]
pub(super) struct Output<const D: usize> {
    pub(super) hyperparameters: Hyperparameters<D>,
    /// 1 / ℓ
    pub(super) rate: [f64; D],
    pub(super) blocks: Vec<Block<D>>,
    /// w, of the plane of the linear part.
    pub(super) slope: [f64; D],
    /// b, of that plane.
    pub(super) offset: f64,
    pub(super) weights: Vec<f64>,
    /// Columns of L one after the other, each from its diagonal down. The diagonal holds
    /// reciprocals.
    pub(super) factor: Vec<f64>,
    pub(super) jitter: f64,
}

/// Memory of the factorisation, shared by the outputs.
pub(super) struct Work<const D: usize> {
    covariance: Covariance<D>,
    factor: Mat<f64>,
    /// Targets, then weights.
    pub(super) weights: Vec<f64>,
    memory: MemBuffer,
}

impl<const D: usize> Work<D> {
    pub(super) fn new(samples: usize) -> Self {
        Self {
            covariance: Covariance::new(samples),
            factor: Mat::zeros(samples, samples),
            weights: Vec::with_capacity(samples),
            memory: MemBuffer::new(factor_scratch(samples)),
        }
    }
}

impl<const D: usize> Output<D> {
    pub(super) fn prior(hyperparameters: Hyperparameters<D>) -> Self {
        let rate = hyperparameters.kernel.length_scale.map(f64::recip);
        let (slope, offset) = ([0.0; D], 0.0);
        Self {
            hyperparameters,
            rate,
            blocks: Vec::new(),
            slope,
            offset,
            weights: Vec::new(),
            factor: Vec::new(),
            jitter: 0.0,
        }
    }

    /// `None` if the covariance does not factorise.
    pub(super) fn condition(
        &mut self,
        inputs: &[[f64; D]],
        noise_scale: &[f64],
        work: &mut Work<D>,
    ) -> Option<()> {
        let Hyperparameters { kernel, noise_variance } = self.hyperparameters;
        work.covariance.fill(inputs, &kernel);
        self.jitter = factorise(
            work.covariance.sum(),
            noise_variance,
            noise_scale,
            &mut work.factor,
            &mut work.memory,
        )
        .ok()?;
        llt::solve::solve_in_place(
            work.factor.as_ref(),
            MatMut::from_column_major_slice_mut(&mut work.weights, inputs.len(), 1),
            Par::Seq,
            MemStack::new(&mut work.memory),
        );
        self.weights.clone_from(&work.weights);
        let total = |share: &dyn Fn(usize) -> f64| {
            kernel.linear_variance * (0..inputs.len()).map(share).sum::<f64>()
        };
        let split = kernel.local_inputs();
        self.slope = std::array::from_fn(|input| {
            if input < split {
                total(&|sample| self.weights[sample] * inputs[sample][input])
            } else {
                0.0
            }
        });
        self.offset = total(&|sample| self.weights[sample]);
        self.factor = Vec::with_capacity(inputs.len() * (inputs.len() + 1) / 2);
        for column in 0..inputs.len() {
            let entries = &work.factor.col_as_slice(column)[column..];
            self.factor.push(entries[0].recip());
            self.factor.extend_from_slice(&entries[1..]);
        }
        self.blocks = vec![Block::EMPTY; inputs.len().div_ceil(LANES)];
        for (sample, weight) in self.weights.iter().enumerate() {
            let block = &mut self.blocks[sample / LANES];
            block.weights[sample % LANES] = kernel.variance * weight;
            block.place_weights[sample % LANES] = kernel.place_variance * weight;
            for (lanes, column) in block.inputs.iter_mut().zip(work.covariance.scaled()) {
                lanes[sample % LANES] = column[sample];
            }
        }
        Some(())
    }

    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn scaled(&self, x: &[f64; D]) -> [f64; D] {
        std::array::from_fn(|i| x[i] * self.rate[i])
    }

    /// w·x + b
    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn plane(&self, x: &[f64; D]) -> f64 {
        self.slope.iter().zip(x).fold(self.offset, |sum, (slope, x)| sum + slope * x)
    }

    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn mean(&self, x: &[f64; D]) -> f64 {
        let plane = self.plane(x);
        let (split, x) = (self.hyperparameters.kernel.local_inputs(), self.scaled(x));
        let mut mean = [0.0; LANES];
        for block in &self.blocks {
            add(&mut mean, &block.shares(&x, 0..split, &block.weights));
            if split < D {
                add(&mut mean, &block.shares(&x, split..D, &block.place_weights));
            }
        }
        mean.iter().sum::<f64>() + plane
    }

    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn mean_and_gradient(&self, x: &[f64; D]) -> (f64, [f64; D]) {
        let plane = self.plane(x);
        let (split, x) = (self.hyperparameters.kernel.local_inputs(), self.scaled(x));
        let mut mean = [0.0; LANES];
        let mut gradient = [[0.0; LANES]; D];
        for block in &self.blocks {
            let shares = block.shares(&x, 0..split, &block.weights);
            add(&mut mean, &shares);
            block.add_slopes(&x, 0..split, &shares, &mut gradient);
            if split < D {
                let shares = block.shares(&x, split..D, &block.place_weights);
                add(&mut mean, &shares);
                block.add_slopes(&x, split..D, &shares, &mut gradient);
            }
        }
        let slope =
            std::array::from_fn(|i| gradient[i].iter().sum::<f64>() * self.rate[i] + self.slope[i]);
        (mean.iter().sum::<f64>() + plane, slope)
    }

    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    pub(super) fn variance(&self, x: &[f64; D], column: &mut [f64]) -> f64 {
        let kernel = &self.hyperparameters.kernel;
        let prior = kernel.prior(x);
        let scaled = self.scaled(x);
        // Xᵢ·x = (Xᵢ/ℓ)·(ℓ x)
        let stretched: [f64; D] = std::array::from_fn(|i| x[i] * kernel.length_scale[i]);
        let split = kernel.local_inputs();
        for (lanes, block) in column.as_chunks_mut::<LANES>().0.iter_mut().zip(&self.blocks) {
            *lanes = block.shares(&scaled, 0..split, &[kernel.variance; LANES]);
            if kernel.linear_variance != 0.0 {
                let products = block.one_plus_products(&stretched[..split]);
                for (share, product) in lanes.iter_mut().zip(&products) {
                    *share += kernel.linear_variance * product;
                }
            }
            if split < D {
                add(lanes, &block.shares(&scaled, split..D, &[kernel.place_variance; LANES]));
            }
        }
        // L⁻¹k by columns: once an entry is known, its contribution is subtracted from all below.
        let mut explained = 0.0;
        let mut rest = &mut column[..self.weights.len()];
        let mut factor = self.factor.as_slice();
        while let Some((first, below)) = rest.split_first_mut() {
            let (entries, further) = factor.split_at(below.len() + 1);
            let solved = *first * entries[0];
            explained += solved * solved;
            for (entry, factor) in below.iter_mut().zip(&entries[1..]) {
                *entry -= solved * factor;
            }
            (rest, factor) = (below, further);
        }
        (prior - explained).min(prior).max(0.0)
    }
}
