//! The samples of the reference problem: residual accelerations of a mecanum base, drawn like those
//! of its `gp_data(n, seed)`.

use model::gp::split_mix::SplitMix64;

const LARGEST_INPUT: [f64; 3] = [3.2, 3.2, 1.05];
const SPREAD: [f64; 3] = [0.6, 0.6, 0.3];
const NOISE: f64 = 0.05;

/// Unmodelled acceleration at body velocity `v` under input `u`.
pub(crate) fn residual([vx, vy, w]: [f64; 3], [ux, uy, uw]: [f64; 3]) -> [f64; 3] {
    [
        -0.6 * (1.5 * vx).tanh() - 0.15 * vx + 0.25 * vy * w - 0.2 * (ux - vx).sin(),
        -(1.5 * vy).tanh() - 0.25 * vy - 0.25 * vx * w - 0.12 * uy * vx.sin(),
        -0.5 * (2.0 * w).tanh() + 0.05 * vx * vy + 0.1 * (ux - vx) - 0.1 * uw * vx.abs() / 3.0,
    ]
}

/// Inputs (v, u) and the three residuals, in the order of draws that all implementations share.
pub(crate) fn gp_data(samples: usize, seed: u64) -> (Vec<[f64; 6]>, Vec<[f64; 3]>) {
    let mut random = SplitMix64::new(seed);
    let mut draw = || {
        let v: [f64; 3] =
            std::array::from_fn(|i| (2.0 * random.uniform() - 1.0) * LARGEST_INPUT[i]);
        let u: [f64; 3] = std::array::from_fn(|i| {
            (v[i] + SPREAD[i] * random.normal()).clamp(-LARGEST_INPUT[i], LARGEST_INPUT[i])
        });
        let noise: [f64; 3] = std::array::from_fn(|_| random.normal());
        let g = residual(v, u);
        ([v[0], v[1], v[2], u[0], u[1], u[2]], std::array::from_fn(|i| g[i] + NOISE * noise[i]))
    };
    (0..samples).map(|_| draw()).unzip()
}
