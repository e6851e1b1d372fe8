//! Numbers → positions along an axis, with round ticks.

/// Number of decades above which not each has a tick of its own.
const DECADES_MAX: f64 = 5.0;

/// Smallest and largest of a set of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// The smallest.
    pub low: f64,
    /// The largest.
    pub high: f64,
}

impl Extent {
    /// That of no numbers.
    pub const NONE: Self = Self { low: f64::INFINITY, high: f64::NEG_INFINITY };

    /// That of `values`. Numbers that are not finite do not count.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut extent = Self::NONE;
        extent.include(values);
        extent
    }

    /// Extends it to `values`.
    pub fn include(&mut self, values: impl IntoIterator<Item = f64>) {
        for value in values.into_iter().filter(|value| value.is_finite()) {
            (self.low, self.high) = (self.low.min(value), self.high.max(value));
        }
    }

    /// From the smallest to the largest.
    pub fn length(&self) -> f64 {
        self.high - self.low
    }

    /// The same with a margin, so that no point lies on the edge; never empty.
    #[must_use]
    pub fn padded(&self) -> Self {
        if self.low > self.high || !self.length().is_finite() {
            return Self { low: 0.0, high: 1.0 };
        }
        let least = 1e-9 * self.low.abs().max(self.high.abs()).max(1e-3);
        let margin = if self.length() > least {
            0.06 * self.length()
        } else {
            (0.1 * self.high.abs()).max(1e-3)
        };
        let padded = Self { low: self.low - margin, high: self.high + margin };
        if padded.length().is_finite() { padded } else { *self }
    }
}

/// Scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scale {
    Linear,
    /// To the base of 10.
    Logarithmic,
}

/// One axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    extent: Extent,
    scale: Scale,
}

/// A number on an axis, and its label.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// The number.
    pub value: f64,
    /// Its label.
    pub label: String,
}

impl Axis {
    /// From one end of `extent` to the other.
    pub fn linear(extent: Extent) -> Self {
        Self { extent, scale: Scale::Linear }
    }

    /// The same, logarithmic: whole decades around the positive part of `extent`. At most nine.
    pub fn logarithmic(extent: Extent) -> Self {
        let high = if extent.high > 0.0 && extent.high.is_finite() {
            extent.high.log10().ceil().min(300.0)
        } else {
            0.0
        };
        let low = if extent.low > 0.0 && extent.low <= extent.high {
            extent.low.log10().floor()
        } else {
            high - 3.0
        };
        let low = low.clamp(high - 9.0, high - 1.0);
        Self {
            extent: Extent { low: 10_f64.powf(low), high: 10_f64.powf(high) },
            scale: Scale::Logarithmic,
        }
    }

    /// Position of `value`: 0 at the low end, 1 at the high one, NaN if it has none.
    pub fn share(&self, value: f64) -> f64 {
        let Extent { low, high } = self.extent;
        match self.scale {
            Scale::Linear => (value - low) / (high - low),
            // 0 lies below every edge, and is drawn at the lower one.
            Scale::Logarithmic => {
                (value.max(f64::MIN_POSITIVE).log10() - low.log10()) / (high.log10() - low.log10())
            }
        }
    }

    /// About `wanted` ticks, never more than twice as many.
    pub fn ticks(&self, wanted: usize) -> Vec<Tick> {
        match self.scale {
            Scale::Linear => self.linear_ticks(wanted),
            Scale::Logarithmic => self.decades(),
        }
    }

    fn linear_ticks(&self, wanted: usize) -> Vec<Tick> {
        let Extent { low, high } = self.extent;
        let step = nice_step((high - low) / wanted.max(1) as f64);
        // Rounding must not remove a tick at an end.
        let (first, last) = ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor());
        let count = last - first;
        if !step.is_finite() || !(0.0..=2.0 * wanted as f64).contains(&count) {
            return [low, high]
                .into_iter()
                .map(|value| Tick { value, label: scientific(value) })
                .collect();
        }
        (0..=count as usize)
            .map(|index| (first + index as f64) * step)
            .map(|value| Tick { value, label: label(value, step) })
            .collect()
    }

    fn decades(&self) -> Vec<Tick> {
        let (low, high) = (self.extent.low.log10().round(), self.extent.high.log10().round());
        let every = ((high - low) / DECADES_MAX).ceil().max(1.0) as usize;
        let exponents = (low as i32..=high as i32).step_by(every);
        exponents
            .map(|exponent| 10_f64.powi(exponent))
            .map(|value| Tick { value, label: label(value, value) })
            .collect()
    }
}

/// 1, 2 or 5 times a power of 10, at least `least`.
fn nice_step(least: f64) -> f64 {
    let decade = 10_f64.powf(least.log10().floor());
    let nice = [1.0, 2.0, 5.0]
        .into_iter()
        .map(|factor| factor * decade)
        .find(|step| *step >= least * (1.0 - 1e-9));
    nice.unwrap_or(10.0 * decade)
}

/// `value` with the decimals that a step of `step` needs.
fn label(value: f64, step: f64) -> String {
    if !(1e-5..1e6).contains(&step) || value.abs() >= 1e7 {
        return scientific(value);
    }
    let decimals = (-(step.log10() + 1e-9).floor()).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    // No minus sign before zeros.
    if text.bytes().any(|byte| (b'1'..=b'9').contains(&byte)) {
        text
    } else {
        text.trim_start_matches('-').to_owned()
    }
}

fn scientific(value: f64) -> String {
    if value == 0.0 { "0".to_owned() } else { format!("{value:.1e}").replace(".0e", "e") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(low: f64, high: f64, wanted: usize) -> Vec<String> {
        Axis::linear(Extent { low, high })
            .ticks(wanted)
            .into_iter()
            .map(|tick| tick.label)
            .collect()
    }

    #[test]
    fn ticks_are_at_round_numbers() {
        assert_eq!(labels(0.0, 25.0, 5), ["0", "5", "10", "15", "20", "25"]);
        assert_eq!(labels(-0.013, 0.021, 4), ["-0.01", "0.00", "0.01", "0.02"]);
        assert_eq!(labels(-1.1, 0.2, 4), ["-1.0", "-0.5", "0.0"]);
        assert_eq!(labels(0.0, 3600.0, 5), ["0", "1000", "2000", "3000"]);
        assert_eq!(labels(-2e-7, 2e-7, 4), ["-2e-7", "-1e-7", "0", "1e-7", "2e-7"]);
    }

    #[test]
    fn an_extent_without_a_round_tick_has_ticks_at_its_ends() {
        for (low, high) in [(1e300, 1.000_000_000_000_000_2e300), (-1e308, 1e308)] {
            let ticks = labels(low, high, 5);
            assert!((1..=11).contains(&ticks.len()), "{ticks:?}");
        }
    }

    #[test]
    fn every_tick_lies_on_its_axis() {
        for (low, high) in [(0.0, 1.0), (-3.3, 71.9), (1e-6, 2e-6), (-1e5, -9e4)] {
            for wanted in 2..9 {
                let axis = Axis::linear(Extent { low, high });
                let ticks = axis.ticks(wanted);
                assert!(
                    ticks.iter().all(|tick| (-1e-9..=1.0 + 1e-9).contains(&axis.share(tick.value))),
                    "{ticks:?}"
                );
                assert!(
                    (2..=2 * wanted + 1).contains(&ticks.len()),
                    "{low} {high} {wanted}: {ticks:?}"
                );
            }
        }
    }

    #[test]
    fn a_logarithmic_axis_has_whole_decades() {
        let axis = Axis::logarithmic(Extent { low: 0.0031, high: 0.9 });
        let labels: Vec<String> = axis.ticks(5).into_iter().map(|tick| tick.label).collect();
        assert_eq!(labels, ["0.001", "0.01", "0.1", "1"]);
        assert!((axis.share(0.01) - 1.0 / 3.0).abs() < 1e-12);
        assert!(axis.share(0.0) < 0.0);
    }

    #[test]
    fn numbers_that_are_not_finite_do_not_extend_an_axis() {
        let extent = Extent::of([1.0, f64::NAN, f64::INFINITY, 3.0]);
        assert_eq!(extent, Extent { low: 1.0, high: 3.0 });
        assert_eq!(Extent::NONE.padded(), Extent { low: 0.0, high: 1.0 });
        let flat = Extent::of([2.0, 2.0]).padded();
        assert!(flat.low < 2.0 && flat.high > 2.0);
    }
}
