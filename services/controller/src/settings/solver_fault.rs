//! Injected faults of the optimiser: in their ticks it reports something else than its result.

use model::gp::split_mix::SplitMix64;
use serde::{Deserialize, Serialize};
use settings::Impossible;

/// Faults of the optimiser that are injected. By default none, at no cost.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolverFaults {
    /// Seed of all random choices.
    #[serde(default)]
    pub seed: u64,
    /// The faults. If several happen in one tick, the first one counts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solver: Vec<SolverFault>,
}

/// One fault of the optimiser.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolverFault {
    /// Result that it reports.
    pub kind: SolverFaultKind,
    /// First tick in which it happens.
    #[serde(default)]
    pub from_tick: u64,
    /// First tick in which it no longer happens; without a value it lasts to the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_tick: Option<u64>,
    /// Probability in each tick, up to 1.
    #[serde(default = "certain")]
    pub probability: f64,
}

/// Result that a faulty optimiser reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SolverFaultKind {
    /// No input satisfies the limits.
    Infeasible,
    /// It has run out of iterations.
    OutOfIterations,
    /// Solved, but the answer is not a number.
    Nan,
    /// Solved, but the answer is far outside the limits.
    Wrong,
}

const fn certain() -> f64 {
    1.0
}

impl SolverFaults {
    /// Whether there are no faults.
    pub fn is_empty(&self) -> bool {
        self.solver.is_empty()
    }

    /// Checks that such faults are possible.
    ///
    /// # Errors
    /// [`Impossible`] names the first impossible setting; faults count from 0.
    pub fn check(&self) -> Result<(), Impossible> {
        if i64::try_from(self.seed).is_err() {
            return Err(Impossible::new(
                "seed",
                "at most 9223372036854775807, the largest number of TOML",
            ));
        }
        for (index, fault) in self.solver.iter().enumerate() {
            let impossible = |key: &str, expected: String| {
                Err(Impossible::new(format!("solver.{index}.{key}"), expected))
            };
            if !(fault.probability > 0.0 && fault.probability <= 1.0) {
                return impossible("probability", "a number greater than 0 and at most 1".into());
            }
            if fault.until_tick.is_some_and(|until| until <= fault.from_tick) {
                return impossible(
                    "until_tick",
                    format!("a tick after from_tick = {}, or nothing", fault.from_tick),
                );
            }
        }
        Ok(())
    }

    /// The fault in `tick`, with random numbers for that tick. The same seed, tick and place in the
    /// list give the same fault. Does not allocate.
    pub fn strike(&self, tick: u64) -> Option<(SolverFaultKind, SplitMix64)> {
        self.solver.iter().zip(1_u64..).find_map(|(fault, place)| {
            let within =
                tick >= fault.from_tick && fault.until_tick.is_none_or(|until| tick < until);
            let mut random = within.then(|| {
                SplitMix64::new(SplitMix64::new(self.seed ^ (place << 32)).bits() ^ tick)
            })?;
            (random.uniform() < fault.probability).then_some((fault.kind, random))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(text: &str) -> Result<SolverFaults, toml::de::Error> {
        toml::from_str(text)
    }

    #[test]
    fn a_fault_happens_in_its_ticks_with_its_probability_and_repeatably()
    -> Result<(), toml::de::Error> {
        let text = "seed = 3\n[[solver]]\nkind = \"out-of-iterations\"\nfrom_tick = 100\n\
                    until_tick = 1100\nprobability = 0.3\n";
        let ticks = |faults: &SolverFaults| {
            (0..2000).filter(|&tick| faults.strike(tick).is_some()).collect::<Vec<_>>()
        };
        let struck = ticks(&told(text)?);
        assert!((250..350).contains(&struck.len()), "{}", struck.len());
        assert!(struck.iter().all(|tick| (100..1100).contains(tick)));
        assert_eq!(struck, ticks(&told(text)?));
        assert_ne!(struck, ticks(&told(&text.replace("seed = 3", "seed = 4"))?));
        Ok(())
    }

    #[test]
    fn impossible_faults_are_named() -> Result<(), toml::de::Error> {
        for (keys, key) in [
            ("probability = 0.0", "solver.0.probability"),
            ("probability = nan", "solver.0.probability"),
            ("from_tick = 5\nuntil_tick = 5", "solver.0.until_tick"),
        ] {
            let faults = told(&format!("[[solver]]\nkind = \"nan\"\n{keys}\n"))?;
            assert_eq!(faults.check().err().map(|impossible| impossible.key), Some(key.into()));
        }
        assert!(told("[[solver]]\nkind = \"tired\"\n").is_err());
        Ok(())
    }
}
