//! Faults of snapshots: in their ticks, the learner publishes other snapshots than it has learnt.

use model::gp::split_mix::SplitMix64;
use serde::{Deserialize, Serialize};
use settings::Impossible;

/// The injected faults. By default none, at no cost.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SnapshotFaults {
    /// Seed of all random choices.
    #[serde(default)]
    pub seed: u64,
    /// The faults. If several apply to a snapshot, the first counts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub snapshot: Vec<SnapshotFault>,
}

/// One kind of bad snapshot, published in place of good ones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SnapshotFault {
    /// Kind of the fault.
    pub kind: SnapshotFaultKind,
    /// First tick of the fault, by the last training sample.
    #[serde(default)]
    pub from_tick: u64,
    /// First tick after the fault; absent is the end of the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_tick: Option<u64>,
    /// Probability for each snapshot, up to 1.
    #[serde(default = "certain")]
    pub probability: f64,
}

/// Kind of a bad snapshot. Its checksum is valid in every case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SnapshotFaultKind {
    /// An earlier snapshot, published again as if it were new. The first two are never stale.
    Stale,
    /// One of its numbers is NaN.
    Nan,
    /// Its points are all the same, and without noise: their covariance has no factor.
    Indefinite,
    /// It has one additional input.
    WrongSize,
    /// It was learnt for another robot.
    WrongFingerprint,
    /// One of its hyperparameters is impossible for any residual.
    Absurd,
    /// Half of it belongs to another snapshot.
    Torn,
}

impl SnapshotFaultKind {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::Stale,
        Self::Nan,
        Self::Indefinite,
        Self::WrongSize,
        Self::WrongFingerprint,
        Self::Absurd,
        Self::Torn,
    ];

    /// Name in files and logs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stale => "stale",
            Self::Nan => "nan",
            Self::Indefinite => "indefinite",
            Self::WrongSize => "wrong-size",
            Self::WrongFingerprint => "wrong-fingerprint",
            Self::Absurd => "absurd",
            Self::Torn => "torn",
        }
    }
}

const fn certain() -> f64 {
    1.0
}

impl SnapshotFaults {
    /// Whether there are no faults.
    pub fn is_empty(&self) -> bool {
        self.snapshot.is_empty()
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
        for (index, fault) in self.snapshot.iter().enumerate() {
            let impossible = |key: &str, expected: String| {
                Err(Impossible::new(format!("snapshot.{index}.{key}"), expected))
            };
            if !(fault.probability > 0.0 && fault.probability <= 1.0) {
                return impossible("probability", "a number greater than 0 and at most 1".into());
            }
            if fault.until_tick.is_some_and(|until| until <= fault.from_tick) {
                return impossible(
                    "until_tick",
                    format!("a tick after from_tick = {}, or no key", fault.from_tick),
                );
            }
        }
        Ok(())
    }

    /// The fault of the snapshot of `tick`, with random numbers of its own. They depend only on
    /// seed, tick and index in the list.
    pub fn strike(&self, tick: u64) -> Option<(SnapshotFaultKind, SplitMix64)> {
        self.snapshot.iter().zip(1_u64..).find_map(|(fault, place)| {
            let within =
                tick >= fault.from_tick && fault.until_tick.is_none_or(|until| tick < until);
            let mut random = within.then(|| {
                SplitMix64::new(SplitMix64::new(self.seed ^ (place << 32)).bits() ^ tick)
            })?;
            (random.uniform() < fault.probability).then_some((fault.kind, random))
        })
    }
}
