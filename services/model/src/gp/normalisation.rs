//! Inputs in units of a typical value (eq. 36 of the paper).
//!
//! The paper takes mean and spread from the data. Data recorded at constant speed has almost no
//! spread, and a division by it turns sensor noise into huge inputs. A scale that moves with the
//! data also changes the meaning of the hyperparameters. Scales fixed by physics avoid both.

/// Affine map of every input to a range about one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normalisation<const D: usize> {
    /// Zero of each normalised input, in input units.
    pub mean: [f64; D],
    /// Unit of each normalised input, in input units; positive.
    pub scale: [f64; D],
}

impl<const D: usize> Normalisation<D> {
    /// The map that changes nothing.
    pub const IDENTITY: Self = Self { mean: [0.0; D], scale: [1.0; D] };

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
    use super::Normalisation;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn invert_undoes_apply(x in [-5.0..5.0, -5.0..5.0]) {
            let normalisation = Normalisation { mean: [1.0, -2.0], scale: [0.3, 7.0] };
            let back = normalisation.invert(&normalisation.apply(&x));
            prop_assert!((back[0] - x[0]).abs() < 1e-12 && (back[1] - x[1]).abs() < 1e-12);
        }
    }
}
