//! Judges which samples are credible: a surprising sample counts less, and an outlier is held back
//! until later ones confirm it.
//!
//! ```text
//! z = innovation / √(1 + v/σₙ²)
//! r = |z| / (4 max(running median of |z|, floor)), the largest over the outputs
//! r ≤ 1    admitted
//! r ≤ 3    admitted with r² times the noise: its weight falls off like 1/r
//! r > 3    held back
//! ```
//! v is the variance of the function at the sample, so a sample at a new input is expected to
//! differ. A single outlier is never admitted. If the world has really changed, nearly all samples
//! are surprising from then on, which confirms the change. A stuck sensor repeats its value to the
//! last bit; such a sample has no information and is not counted.
//!
//! Reference: Huber & Ronchetti, *Robust Statistics*, 2nd ed., 2009, section 4.8, for an influence
//! that falls off.

/// Number of samples in a running median.
const MEDIAN_SAMPLES: usize = 64;
/// Number of samples before any can be surprising.
const SAMPLES_MIN: usize = 10;
/// Threshold of a surprise, in running medians: about 2.7 standard deviations.
const SURPRISING: f64 = 4.0;
/// Threshold of an outlier, as a multiple of the threshold of a surprise.
const WILD: f64 = 3.0;
/// Number of surprises in a row that is a change …
const RUN: u32 = 10;
/// … or this number of surprises …
const MOST: u32 = 14;
/// … in this number of samples. If three in ten samples are outliers, one in three thousand such
/// windows has that many.
pub(crate) const WINDOW: u32 = 20;

/// Verdict on a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Verdict {
    /// Admit it, with this multiple of σₙ² added to its noise.
    Admit(f64),
    /// Hold it back until later samples confirm it.
    Hold,
    /// It and the surprising ones among this number of last samples confirm each other: the world
    /// has changed.
    Changed(u32),
}

/// Running medians of |z|, and the recent surprises.
#[derive(Debug, Clone)]
pub(crate) struct Surprise {
    floor: [f64; 3],
    deviations: [Vec<f64>; 3],
    /// Index in the rings that is written next.
    next: usize,
    /// One bit per sample, the newest lowest.
    surprises: u32,
}

impl Surprise {
    /// No innovation below `floor` times [`SURPRISING`] is surprising, at any median.
    pub(crate) fn new(floor: [f64; 3]) -> Self {
        let ring = || Vec::with_capacity(MEDIAN_SAMPLES);
        Self { floor, deviations: [ring(), ring(), ring()], next: 0, surprises: 0 }
    }

    /// Judges a sample by z of each output.
    pub(crate) fn judge(&mut self, deviations: &[f64; 3]) -> Verdict {
        let ratio = self.ratio(deviations);
        for (ring, deviation) in self.deviations.iter_mut().zip(deviations) {
            match ring.get_mut(self.next) {
                Some(slot) => *slot = deviation.abs(),
                None => ring.push(deviation.abs()),
            }
        }
        self.next = (self.next + 1) % MEDIAN_SAMPLES;
        self.surprises = (self.surprises << 1 | u32::from(ratio > 1.0)) & ((1 << WINDOW) - 1);
        if ratio <= 1.0 {
            return Verdict::Admit(0.0);
        }
        let run = self.surprises.trailing_ones();
        if run >= RUN || self.surprises.count_ones() >= MOST {
            self.surprises = 0;
            return Verdict::Changed(if run >= RUN { run } else { WINDOW });
        }
        if ratio <= WILD { Verdict::Admit(ratio * ratio - 1.0) } else { Verdict::Hold }
    }

    /// Whether a sample in the set is an outlier for the later samples.
    pub(crate) fn is_wild(&self, deviations: &[f64; 3]) -> bool {
        self.ratio(deviations) > WILD
    }

    /// r; zero while too few samples are known.
    fn ratio(&self, deviations: &[f64; 3]) -> f64 {
        if self.deviations[0].len() < SAMPLES_MIN {
            return 0.0;
        }
        let surprise = |(output, deviation): (usize, &f64)| {
            deviation.abs() / (SURPRISING * self.median(output).max(self.floor[output]))
        };
        deviations.iter().enumerate().map(surprise).fold(0.0, f64::max)
    }

    /// Median of at most [`MEDIAN_SAMPLES`] numbers, at least one.
    fn median(&self, output: usize) -> f64 {
        let ring = &self.deviations[output];
        let mut sorted = [f64::INFINITY; MEDIAN_SAMPLES];
        sorted[..ring.len()].copy_from_slice(ring);
        *sorted.select_nth_unstable_by(ring.len() / 2, f64::total_cmp).1
    }
}

#[cfg(test)]
mod tests {
    use super::{Surprise, Verdict, WINDOW};

    /// A judge after fifty samples of ordinary size.
    fn experienced() -> Surprise {
        let mut surprise = Surprise::new([1e-6; 3]);
        for sample in 0..50 {
            let ordinary = (f64::from(sample) * 0.7).sin();
            assert_eq!(surprise.judge(&[ordinary, -ordinary, 0.5 * ordinary]), Verdict::Admit(0.0));
        }
        surprise
    }

    #[test]
    fn a_single_outlier_is_held_back_and_dropped() {
        let mut surprise = experienced();
        assert_eq!(surprise.judge(&[100.0, 0.0, 0.0]), Verdict::Hold);
        assert_eq!(surprise.judge(&[0.1, 0.0, 0.0]), Verdict::Admit(0.0));
    }

    #[test]
    fn a_more_surprising_sample_gets_more_noise() {
        let mut surprise = experienced();
        let doubts: Vec<Verdict> =
            [4.0, 5.0].iter().map(|&deviation| surprise.judge(&[deviation, 0.0, 0.0])).collect();
        assert!(
            matches!(
                doubts[..],
                [Verdict::Admit(first), Verdict::Admit(second)] if 0.0 < first && first < second
            ),
            "{doubts:?}"
        );
    }

    #[test]
    fn a_change_is_accepted_after_ten_samples() {
        let mut surprise = experienced();
        let verdicts: Vec<Verdict> = (0..10).map(|_| surprise.judge(&[0.0, 20.0, 0.0])).collect();
        assert!(verdicts[..9].iter().all(|&verdict| verdict == Verdict::Hold));
        assert_eq!(verdicts[9], Verdict::Changed(10));
    }

    #[test]
    fn a_change_in_most_samples_is_accepted_after_twenty_samples() {
        let mut surprise = experienced();
        let verdicts: Vec<Verdict> = (0..20)
            .map(|i| surprise.judge(&[if i % 5 == 0 { 0.1 } else { 20.0 }, 0.0, 0.0]))
            .collect();
        assert!(verdicts.contains(&Verdict::Changed(WINDOW)), "{verdicts:?}");
    }
}
