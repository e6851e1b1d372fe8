//! Which samples to believe: a surprising one counts less, and a wild one is held back until its successors confirm it.
//!
//! ```text
//! z = innovation / √(1 + v/σₙ²)        r = |z| / (4 max(running median of |z|, floor)), the largest over the outputs
//! r ≤ 1    believed
//! r ≤ 3    believed with r² times the noise: its pull falls off like 1/r
//! r > 3    held back
//! ```
//! v is the variance of the function where the sample was made, so that what is merely new is expected to differ. A single wild sample never
//! gets in. If the world has really changed, nearly all samples are surprising from then on: that is the confirmation. A sensor that is stuck
//! repeats itself to the last bit, which tells nothing and counts for nothing.
//!
//! Reference: Huber & Ronchetti, *Robust Statistics*, 2nd ed., 2009, section 4.8, for a pull that falls off.

/// Samples that a running median looks back on.
const MEDIAN_SAMPLES: usize = 64;
/// Samples that must have been seen before any is surprising.
const SAMPLES_MIN: usize = 10;
/// In running medians: about 2.7 standard deviations.
const SURPRISING: f64 = 4.0;
/// Beyond so many times the surprising a sample is held back.
const WILD: f64 = 3.0;
/// So many surprises in a row are a change …
const RUN: u32 = 10;
/// … and so are so many …
const MOST: u32 = 14;
/// … of so many samples. Of samples of which three in ten are wild, one in three thousand such windows has that many.
pub(crate) const WINDOW: u32 = 20;

/// What to do with a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Verdict {
    /// It is believed, with so many times σₙ² added to its noise.
    Admit(f64),
    /// It waits for its successors.
    Hold,
    /// It and the surprising ones among so many last samples confirm each other: the world has changed.
    Changed(u32),
}

/// Running medians of |z|, and who was surprising lately.
#[derive(Debug, Clone)]
pub(crate) struct Surprise {
    floor: [f64; 3],
    deviations: [Vec<f64>; 3],
    /// Place in the rings that is written next.
    next: usize,
    /// One bit per sample, the newest lowest.
    surprises: u32,
}

impl Surprise {
    /// Nothing below `floor` times [`SURPRISING`] is surprising, whatever the median.
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

    /// Whether a sample that is in looks wild to those that came after it.
    pub(crate) fn is_wild(&self, deviations: &[f64; 3]) -> bool {
        self.ratio(deviations) > WILD
    }

    /// r; zero before enough is known.
    fn ratio(&self, deviations: &[f64; 3]) -> f64 {
        if self.deviations[0].len() < SAMPLES_MIN {
            return 0.0;
        }
        let surprise = |(output, deviation): (usize, &f64)| {
            deviation.abs() / (SURPRISING * self.median(output).max(self.floor[output]))
        };
        deviations.iter().enumerate().map(surprise).fold(0.0, f64::max)
    }

    /// Of at most [`MEDIAN_SAMPLES`] numbers, at least one.
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

    /// One that has seen fifty samples of ordinary size.
    fn experienced() -> Surprise {
        let mut surprise = Surprise::new([1e-6; 3]);
        for sample in 0..50 {
            let ordinary = (f64::from(sample) * 0.7).sin();
            assert_eq!(surprise.judge(&[ordinary, -ordinary, 0.5 * ordinary]), Verdict::Admit(0.0));
        }
        surprise
    }

    #[test]
    fn a_single_wild_sample_is_held_back_and_forgotten() {
        let mut surprise = experienced();
        assert_eq!(surprise.judge(&[100.0, 0.0, 0.0]), Verdict::Hold);
        assert_eq!(surprise.judge(&[0.1, 0.0, 0.0]), Verdict::Admit(0.0));
    }

    #[test]
    fn a_surprising_sample_counts_the_less_the_more_it_surprises() {
        let mut surprise = experienced();
        let doubts: Vec<Verdict> =
            [4.0, 5.0].iter().map(|&deviation| surprise.judge(&[deviation, 0.0, 0.0])).collect();
        assert!(
            matches!(doubts[..], [Verdict::Admit(first), Verdict::Admit(second)] if 0.0 < first && first < second),
            "{doubts:?}"
        );
    }

    #[test]
    fn a_change_is_believed_after_ten_samples() {
        let mut surprise = experienced();
        let verdicts: Vec<Verdict> = (0..10).map(|_| surprise.judge(&[0.0, 20.0, 0.0])).collect();
        assert!(verdicts[..9].iter().all(|&verdict| verdict == Verdict::Hold));
        assert_eq!(verdicts[9], Verdict::Changed(10));
    }

    #[test]
    fn a_change_that_shows_most_of_the_time_is_believed_after_twenty_samples() {
        let mut surprise = experienced();
        let verdicts: Vec<Verdict> = (0..20)
            .map(|i| surprise.judge(&[if i % 5 == 0 { 0.1 } else { 20.0 }, 0.0, 0.0]))
            .collect();
        assert!(verdicts.contains(&Verdict::Changed(WINDOW)), "{verdicts:?}");
    }
}
