//! Checks of samples before anything is computed from them.

/// Why samples are not usable for regression.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum DataError {
    /// The numbers of inputs and targets differ.
    #[error("{inputs} inputs but {targets} targets")]
    Lengths {
        /// Number of inputs.
        inputs: usize,
        /// Number of targets.
        targets: usize,
    },
    /// An input holds NaN or an infinity.
    #[error("input {dimension} of sample {sample} is {value}")]
    Input {
        /// Index of the sample.
        sample: usize,
        /// Index of the input within it.
        dimension: usize,
        /// Its value.
        value: f64,
    },
    /// The numbers of inputs and noise scales differ.
    #[error("{inputs} inputs but {noise_scales} noise scales")]
    NoiseScales {
        /// Number of inputs.
        inputs: usize,
        /// Number of noise scales.
        noise_scales: usize,
    },
    /// A noise scale is not a positive number.
    #[error("the noise scale of sample {sample} is {value}; it must be positive and finite")]
    NoiseScale {
        /// Index of the sample.
        sample: usize,
        /// Its value.
        value: f64,
    },
    /// A target is NaN or an infinity.
    #[error("target {output} of sample {sample} is {value}")]
    Target {
        /// Index of the sample.
        sample: usize,
        /// Index of the output.
        output: usize,
        /// Its value.
        value: f64,
    },
}

/// Rejects samples of unequal number, or with a value that is not finite.
pub(crate) fn check<const D: usize, const P: usize>(
    inputs: &[[f64; D]],
    targets: &[[f64; P]],
) -> Result<(), DataError> {
    if inputs.len() != targets.len() {
        return Err(DataError::Lengths { inputs: inputs.len(), targets: targets.len() });
    }
    if let Some((sample, dimension, value)) = first_not_finite(inputs) {
        return Err(DataError::Input { sample, dimension, value });
    }
    if let Some((sample, output, value)) = first_not_finite(targets) {
        return Err(DataError::Target { sample, output, value });
    }
    Ok(())
}

/// Rejects noise scales of another number than the samples, or with one that is not positive and
/// finite.
pub(crate) fn check_noise_scale(samples: usize, noise_scale: &[f64]) -> Result<(), DataError> {
    if noise_scale.len() != samples {
        return Err(DataError::NoiseScales { inputs: samples, noise_scales: noise_scale.len() });
    }
    let bad =
        noise_scale.iter().enumerate().find(|(_, value)| !(value.is_finite() && **value > 0.0));
    bad.map_or(Ok(()), |(sample, &value)| Err(DataError::NoiseScale { sample, value }))
}

fn first_not_finite<const D: usize>(rows: &[[f64; D]]) -> Option<(usize, usize, f64)> {
    let entries = rows.iter().enumerate().flat_map(|(row, values)| {
        values.iter().enumerate().map(move |(i, &value)| (row, i, value))
    });
    entries.into_iter().find(|(_, _, value)| !value.is_finite())
}
