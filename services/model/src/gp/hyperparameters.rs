//! The hyperparameters of one output, their logarithms (the variables of the optimiser), and their
//! bounds.

use crate::gp::kernel::{Kernel, PLACE_INPUTS};

/// Parameters of one output that maximise the marginal likelihood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hyperparameters<const D: usize> {
    /// Covariance of the function.
    pub kernel: Kernel<D>,
    /// σₙ²: variance of the noise of one observation, in squared output units.
    pub noise_variance: f64,
}

/// Why hyperparameters are rejected.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum HyperparametersError {
    /// A length scale is not a positive number.
    #[error("length scale {dimension} is {value}; it must be positive and finite")]
    LengthScale {
        /// Index of the input.
        dimension: usize,
        /// Its value.
        value: f64,
    },
    /// The prior variance is not a positive number.
    #[error("the prior variance is {value}; it must be positive and finite")]
    Variance {
        /// Its value.
        value: f64,
    },
    /// The linear variance is neither zero nor a positive number.
    #[error("the linear variance is {value}; it must be zero or positive, and finite")]
    LinearVariance {
        /// Its value.
        value: f64,
    },
    /// The place variance is neither zero nor a positive number.
    #[error("the place variance is {value}; it must be zero or positive, and finite")]
    PlaceVariance {
        /// Its value.
        value: f64,
    },
    /// A place part needs a linear part, and more inputs than those of the place.
    #[error("a place part needs a linear part and more than {PLACE_INPUTS} inputs")]
    PlaceAlone,
    /// The noise variance is not a positive number.
    #[error("the noise variance is {value}; it must be positive and finite")]
    NoiseVariance {
        /// Its value.
        value: f64,
    },
}

impl<const D: usize> Hyperparameters<D> {
    /// Length scales in input units, prior variance σ² and noise variance σₙ² in squared output
    /// units; without a linear and a place part.
    pub const fn new(length_scale: [f64; D], variance: f64, noise_variance: f64) -> Self {
        let (linear_variance, place_variance) = (0.0, 0.0);
        Self {
            kernel: Kernel { variance, length_scale, linear_variance, place_variance },
            noise_variance,
        }
    }

    /// The same with a linear part of prior variance λ², in squared output units. Zero means no
    /// linear part.
    #[must_use]
    pub const fn with_linear(mut self, linear_variance: f64) -> Self {
        self.kernel.linear_variance = linear_variance;
        self
    }

    /// The same with a place part of prior variance π², in squared output units. Zero means no
    /// place part. It needs a linear part.
    #[must_use]
    pub const fn with_place(mut self, place_variance: f64) -> Self {
        self.kernel.place_variance = place_variance;
        self
    }

    /// Rejects values that are not positive and finite; linear and place variance may be zero.
    pub fn check(&self) -> Result<(), HyperparametersError> {
        let good = |value: f64| value.is_finite() && value > 0.0;
        for (dimension, &value) in self.kernel.length_scale.iter().enumerate() {
            if !good(value) {
                return Err(HyperparametersError::LengthScale { dimension, value });
            }
        }
        if !good(self.kernel.variance) {
            return Err(HyperparametersError::Variance { value: self.kernel.variance });
        }
        if !(good(self.kernel.linear_variance) || self.kernel.linear_variance == 0.0) {
            return Err(HyperparametersError::LinearVariance {
                value: self.kernel.linear_variance,
            });
        }
        let place_variance = self.kernel.place_variance;
        if !(good(place_variance) || place_variance == 0.0) {
            return Err(HyperparametersError::PlaceVariance { value: place_variance });
        }
        if place_variance != 0.0 && (self.kernel.linear_variance == 0.0 || D <= PLACE_INPUTS) {
            return Err(HyperparametersError::PlaceAlone);
        }
        if !good(self.noise_variance) {
            return Err(HyperparametersError::NoiseVariance { value: self.noise_variance });
        }
        Ok(())
    }

    /// Natural logarithm of each; a linear or place variance of zero has none.
    pub fn ln(&self) -> LogHyperparameters<D> {
        LogHyperparameters {
            length_scale: self.kernel.length_scale.map(f64::ln),
            variance: self.kernel.variance.ln(),
            noise_variance: self.noise_variance.ln(),
            linear_variance: (self.kernel.linear_variance != 0.0)
                .then(|| self.kernel.linear_variance.ln()),
            place_variance: (self.kernel.place_variance != 0.0)
                .then(|| self.kernel.place_variance.ln()),
        }
    }
}

/// One number per logarithm of a hyperparameter: its value, or a derivative with respect to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogHyperparameters<const D: usize> {
    /// Of ln ℓ.
    pub length_scale: [f64; D],
    /// Of ln σ².
    pub variance: f64,
    /// Of ln σₙ².
    pub noise_variance: f64,
    /// Of ln λ²; `None` of a kernel without a linear part.
    pub linear_variance: Option<f64>,
    /// Of ln π²; `None` of a kernel without a place part.
    pub place_variance: Option<f64>,
}

impl<const D: usize> LogHyperparameters<D> {
    /// The hyperparameters of these logarithms.
    pub fn exp(&self) -> Hyperparameters<D> {
        Hyperparameters::new(
            self.length_scale.map(f64::exp),
            self.variance.exp(),
            self.noise_variance.exp(),
        )
        .with_linear(self.linear_variance.map_or(0.0, f64::exp))
        .with_place(self.place_variance.map_or(0.0, f64::exp))
    }

    /// In the optimiser's order: length scales, variance, noise variance, the linear variance if
    /// there is a linear part, and the place variance if there is a place part.
    pub fn iter(&self) -> impl Iterator<Item = f64> + '_ {
        self.length_scale
            .iter()
            .copied()
            .chain([self.variance, self.noise_variance])
            .chain(self.linear_variance)
            .chain(self.place_variance)
    }

    /// From the optimiser's order; `None` unless there are D + 2, D + 3 with a linear part, or
    /// D + 4 with a place part too.
    pub fn from_slice(values: &[f64]) -> Option<Self> {
        let (length_scale, rest) = values.split_first_chunk::<D>()?;
        let (&[variance, noise_variance], rest) = rest.split_first_chunk()?;
        let (linear_variance, place_variance) = match *rest {
            [] => (None, None),
            [linear_variance] => (Some(linear_variance), None),
            [linear_variance, place_variance] => (Some(linear_variance), Some(place_variance)),
            _ => return None,
        };
        let length_scale = *length_scale;
        Some(Self { length_scale, variance, noise_variance, linear_variance, place_variance })
    }
}

/// Box of the hyperparameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds<const D: usize> {
    /// Smallest allowed, inclusive.
    pub lower: Hyperparameters<D>,
    /// Largest allowed, inclusive.
    pub upper: Hyperparameters<D>,
}

impl<const D: usize> Default for Bounds<D> {
    /// 10⁻³ … 10³ for all, except the noise variance, which begins at 10⁻⁶.
    fn default() -> Self {
        Self {
            lower: Hyperparameters::new([1e-3; D], 1e-3, 1e-6).with_linear(1e-3),
            upper: Hyperparameters::new([1e3; D], 1e3, 1e3).with_linear(1e3),
        }
    }
}

impl<const D: usize> Bounds<D> {
    /// The nearest logarithms within the box. A kernel without a linear or place part stays without
    /// it.
    pub fn clamp(&self, log: &LogHyperparameters<D>) -> LogHyperparameters<D> {
        let (lower, upper) = (self.lower.ln(), self.upper.ln());
        LogHyperparameters {
            length_scale: std::array::from_fn(|i| {
                log.length_scale[i].max(lower.length_scale[i]).min(upper.length_scale[i])
            }),
            variance: log.variance.max(lower.variance).min(upper.variance),
            noise_variance: log.noise_variance.max(lower.noise_variance).min(upper.noise_variance),
            linear_variance: log
                .linear_variance
                .map(|value| clamp(value, lower.linear_variance, upper.linear_variance)),
            place_variance: log
                .place_variance
                .map(|value| clamp(value, lower.place_variance, upper.place_variance)),
        }
    }
}

/// The nearest value within the bounds that exist.
fn clamp(value: f64, lower: Option<f64>, upper: Option<f64>) -> f64 {
    let value = lower.map_or(value, |lower| value.max(lower));
    upper.map_or(value, |upper| value.min(upper))
}

#[cfg(test)]
mod tests {
    use super::{Bounds, Hyperparameters, HyperparametersError, LogHyperparameters};

    #[test]
    fn logarithms_convert_back_in_the_order_of_the_optimiser() {
        let plain = Hyperparameters::new([1.0, 2.0, 3.0], 4.0, 5.0);
        let linear = plain.with_linear(6.0);
        for (here, count) in [(plain, 5), (linear, 6), (linear.with_place(7.0), 7)] {
            let there: Vec<f64> = here.ln().iter().collect();
            assert_eq!(there.len(), count);
            let back = LogHyperparameters::<3>::from_slice(&there).map(|log| log.exp());
            assert!(back.is_some_and(|back| {
                back.ln().iter().zip(&there).all(|(back, there)| (back - there).abs() < 1e-15)
            }));
            assert_eq!(LogHyperparameters::<4>::from_slice(&there).is_none(), count == 5);
        }
        assert_eq!(LogHyperparameters::<2>::from_slice(&[0.0; 7]), None);
    }

    #[test]
    fn hyperparameters_that_are_not_positive_are_rejected() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(
                Hyperparameters::new([1.0, bad], 1.0, 1.0).check(),
                Err(HyperparametersError::LengthScale { dimension: 1, .. })
            ));
            assert!(matches!(
                Hyperparameters::new([1.0], bad, 1.0).check(),
                Err(HyperparametersError::Variance { .. })
            ));
            assert!(matches!(
                Hyperparameters::new([1.0], 1.0, bad).check(),
                Err(HyperparametersError::NoiseVariance { .. })
            ));
            let linear = Hyperparameters::new([1.0], 1.0, 1.0).with_linear(bad).check();
            assert_eq!(linear.is_ok(), bad == 0.0, "a kernel without a linear part is one");
            let place = Hyperparameters::new([1.0; 5], 1.0, 1.0).with_linear(1.0).with_place(bad);
            assert_eq!(place.check().is_ok(), bad == 0.0, "a kernel without a place part is one");
        }
    }

    #[test]
    fn a_place_part_needs_a_linear_part_and_other_inputs() {
        let placed = Hyperparameters::new([1.0; 5], 1.0, 1.0).with_place(1.0);
        assert_eq!(placed.check(), Err(HyperparametersError::PlaceAlone));
        assert_eq!(placed.with_linear(1.0).check(), Ok(()));
        let alone = Hyperparameters::new([1.0; 4], 1.0, 1.0).with_linear(1.0).with_place(1.0);
        assert_eq!(alone.check(), Err(HyperparametersError::PlaceAlone));
    }

    #[test]
    fn clamped_hyperparameters_lie_on_the_bounds() {
        let bounds = Bounds::<1>::default();
        let clamped = bounds.clamp(&Hyperparameters::new([1e9], 1e-9, 1.0).ln()).exp();
        assert!((clamped.kernel.length_scale[0] - 1e3).abs() < 1e-9);
        assert!((clamped.kernel.variance - 1e-3).abs() < 1e-12);
        assert!((clamped.noise_variance - 1.0).abs() < 1e-12);
        assert_eq!(clamped.kernel.linear_variance.to_bits(), 0.0_f64.to_bits());
        let linear =
            bounds.clamp(&Hyperparameters::new([1.0], 1.0, 1.0).with_linear(1e9).ln()).exp();
        assert!((linear.kernel.linear_variance - 1e3).abs() < 1e-9);
    }
}
