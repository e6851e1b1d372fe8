//! Inputs to zero mean and unit spread (eq. 36 of the paper), with a floor under the spread.

/// Affine map that brings every input to zero mean and unit spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normalisation<const D: usize> {
    /// Mean of each input, in input units.
    pub mean: [f64; D],
    /// Spread that counts as one, in input units; positive.
    pub scale: [f64; D],
}

/// Why samples gave no normalisation.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NormalisationError {
    /// A sample holds NaN or an infinity.
    #[error("input {dimension} of sample {sample} is {value}")]
    NotFinite {
        /// Index of the sample.
        sample: usize,
        /// Index of the input within it.
        dimension: usize,
        /// What it is.
        value: f64,
    },
    /// The floor must be a positive number of input units.
    #[error("the floor of input {dimension} is {value}; it must be positive and finite")]
    Floor {
        /// Index of the input.
        dimension: usize,
        /// What it is.
        value: f64,
    },
    /// The spread of a finite input exceeds what a double can hold.
    #[error("the spread of input {dimension} overflows")]
    Overflow {
        /// Index of the input.
        dimension: usize,
    },
}

impl<const D: usize> Normalisation<D> {
    /// The map that changes nothing.
    pub const IDENTITY: Self = Self { mean: [0.0; D], scale: [1.0; D] };

    /// Mean and standard deviation of the samples; where the data has less spread than `floor`, the floor.
    ///
    /// The floor comes from physics: data recorded at constant speed has next to no spread, and a division by that would turn
    /// sensor noise into huge inputs. Without samples the mean is zero and the scale is the floor.
    pub fn from_samples(samples: &[[f64; D]], floor: &[f64; D]) -> Result<Self, NormalisationError> {
        for (dimension, &value) in floor.iter().enumerate() {
            if !(value.is_finite() && value > 0.0) {
                return Err(NormalisationError::Floor { dimension, value });
            }
        }
        for (sample, row) in samples.iter().enumerate() {
            if let Some((dimension, &value)) = row.iter().enumerate().find(|(_, value)| !value.is_finite()) {
                return Err(NormalisationError::NotFinite { sample, dimension, value });
            }
        }
        let mut normalisation = Self { mean: [0.0; D], scale: *floor };
        if samples.is_empty() {
            return Ok(normalisation);
        }
        let count = samples.len() as f64;
        for dimension in 0..D {
            let mean = samples.iter().map(|row| row[dimension] / count).sum::<f64>();
            let variance = samples.iter().map(|row| (row[dimension] - mean).powi(2) / count).sum::<f64>();
            if !variance.is_finite() {
                return Err(NormalisationError::Overflow { dimension });
            }
            normalisation.mean[dimension] = mean;
            normalisation.scale[dimension] = variance.sqrt().max(floor[dimension]);
        }
        Ok(normalisation)
    }

    /// (x − mean) / scale. Does not allocate.
    pub fn apply(&self, x: &[f64; D]) -> [f64; D] {
        std::array::from_fn(|i| (x[i] - self.mean[i]) / self.scale[i])
    }

    /// mean + scale · z, the inverse of [`apply`](Self::apply). Does not allocate.
    pub fn invert(&self, z: &[f64; D]) -> [f64; D] {
        std::array::from_fn(|i| self.mean[i] + self.scale[i] * z[i])
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "a test ends at the first surprise")]

    use super::{Normalisation, NormalisationError};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn normalised_samples_have_zero_mean_and_at_most_unit_spread(
            samples in prop::collection::vec([-5.0..5.0, 100.0..100.001], 1..40),
        ) {
            let normalisation = Normalisation::from_samples(&samples, &[0.1, 0.1]).unwrap();
            let count = samples.len() as f64;
            for i in 0..2 {
                let normalised: Vec<f64> = samples.iter().map(|x| normalisation.apply(x)[i]).collect();
                prop_assert!((normalised.iter().sum::<f64>() / count).abs() < 1e-9);
                prop_assert!(normalised.iter().map(|z| z * z).sum::<f64>() / count < 1.0 + 1e-9);
                prop_assert!(normalisation.scale[i] >= 0.1);
            }
        }

        #[test]
        fn invert_undoes_apply(x in [-5.0..5.0, -5.0..5.0]) {
            let normalisation = Normalisation { mean: [1.0, -2.0], scale: [0.3, 7.0] };
            let back = normalisation.invert(&normalisation.apply(&x));
            prop_assert!((back[0] - x[0]).abs() < 1e-12 && (back[1] - x[1]).abs() < 1e-12);
        }
    }

    #[test]
    fn data_without_spread_takes_the_floor() {
        let normalisation = Normalisation::from_samples(&[[2.7]; 30], &[0.5]).unwrap();
        assert!((normalisation.scale[0] - 0.5).abs() < 1e-15);
        assert!((normalisation.apply(&[3.2])[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn bad_samples_and_floors_are_refused() {
        assert!(matches!(
            Normalisation::from_samples(&[[0.0, 1.0], [0.0, f64::NAN]], &[1.0, 1.0]),
            Err(NormalisationError::NotFinite { sample: 1, dimension: 1, .. })
        ));
        assert_eq!(Normalisation::from_samples(&[[0.0]], &[0.0]), Err(NormalisationError::Floor { dimension: 0, value: 0.0 }));
        assert_eq!(Normalisation::from_samples(&[[1e300], [-1e300]], &[1.0]), Err(NormalisationError::Overflow { dimension: 0 }));
    }
}
