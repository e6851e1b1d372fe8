//! What samples must be before anything is computed from them.

/// Why samples are unfit for regression.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum DataError {
    /// One target belongs to one input.
    #[error("{inputs} inputs but {targets} targets")]
    Lengths {
        /// How many inputs.
        inputs: usize,
        /// How many targets.
        targets: usize,
    },
    /// An input holds NaN or an infinity.
    #[error("input {dimension} of sample {sample} is {value}")]
    Input {
        /// Index of the sample.
        sample: usize,
        /// Index of the input within it.
        dimension: usize,
        /// What it is.
        value: f64,
    },
    /// Every sample has a noise of its own, or all the same.
    #[error("{inputs} inputs but {noise_scales} noise scales")]
    NoiseScales {
        /// How many inputs.
        inputs: usize,
        /// How many noise scales.
        noise_scales: usize,
    },
    /// A noise scale is not a positive number.
    #[error("the noise scale of sample {sample} is {value}; it must be positive and finite")]
    NoiseScale {
        /// Index of the sample.
        sample: usize,
        /// What it is.
        value: f64,
    },
    /// A target is NaN or an infinity.
    #[error("target {output} of sample {sample} is {value}")]
    Target {
        /// Index of the sample.
        sample: usize,
        /// Index of the output.
        output: usize,
        /// What it is.
        value: f64,
    },
}

/// Refuses samples of unequal number, or with a value that is not finite.
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

/// Refuses noise scales of another number than the samples, or of which one is not a positive number.
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
