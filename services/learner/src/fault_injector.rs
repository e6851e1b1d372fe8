//! snapshot → bad snapshot: injects faults into the published snapshots.
//!
//! Only the published message is bad. The learner itself continues with its own model, and saves
//! that in its file.

use crate::settings::{SnapshotFaultKind, SnapshotFaults};
use model::AXES;
use model::gp::split_mix::SplitMix64;
use protocol::frame::DecodeError;
use protocol::message::{INPUTS_MAX, Message, ModelSnapshot};

/// A length scale shorter than that of any residual.
const ABSURD_LENGTH_SCALE: f64 = 1e-9;
/// A variance larger than that of any residual \[(m/s)², (m/s)², (rad/s)²\].
const ABSURD_VARIANCE: f64 = 1e30;
/// Noise so small that duplicate points make the covariance singular.
const NEXT_TO_NO_NOISE: f64 = 1e-15;

/// Makes bad snapshots, and stores good ones for them.
#[derive(Debug)]
pub struct SnapshotFaultInjector {
    faults: SnapshotFaults,
    /// The last two good snapshots that were published, oldest first.
    sent: [Option<ModelSnapshot>; 2],
}

impl SnapshotFaultInjector {
    /// Injects `faults`. Without any it stores nothing.
    pub fn new(faults: SnapshotFaults) -> Self {
        Self { faults, sent: [None, None] }
    }

    /// The snapshot to publish in place of `good`, which was learnt up to `tick`; `None` to publish
    /// `good`.
    pub fn in_place_of(&mut self, good: &ModelSnapshot, tick: u64) -> Option<ModelSnapshot> {
        if self.faults.is_empty() {
            return None;
        }
        let bad = self
            .faults
            .strike(tick)
            .and_then(|(kind, mut random)| Some((kind, self.bad(kind, good, &mut random)?)));
        if let Some((kind, bad)) = bad {
            tracing::warn!(
                kind = kind.name(),
                version = bad.head.version,
                tick,
                "a bad snapshot is sent"
            );
            return Some(bad);
        }
        let [_, newer] = &mut self.sent;
        self.sent = [newer.take(), Some(good.clone())];
        None
    }

    /// `None` if there is no snapshot to make it from.
    fn bad(
        &self,
        kind: SnapshotFaultKind,
        good: &ModelSnapshot,
        random: &mut SplitMix64,
    ) -> Option<ModelSnapshot> {
        let mut bad = good.clone();
        let head = &mut bad.head;
        let axis = below(random, AXES);
        match kind {
            SnapshotFaultKind::Stale => {
                let [older, newer] = &self.sent;
                newer.as_ref()?;
                bad = older.clone()?;
                // In lock step it replaces the snapshot that is due.
                (bad.head.effective_tick, bad.head.plant_epoch) =
                    (good.head.effective_tick, good.head.plant_epoch);
            }
            SnapshotFaultKind::Nan => {
                let fields = ModelSnapshot::numbers();
                let field = fields[below(random, fields.len())];
                let mut struck = false;
                bad.visit_numbers(&mut |name, values| {
                    if name == field && !values.is_empty() {
                        values[below(random, values.len())] = f64::NAN;
                        struck = true;
                    }
                });
                if !struck {
                    bad.head.noise_variance[axis] = f64::NAN;
                }
            }
            SnapshotFaultKind::Indefinite => {
                bad = twins(good).ok().filter(|twins| twins.head.points > 1)?;
            }
            SnapshotFaultKind::WrongSize => bad = with_another_input(good).ok()?,
            SnapshotFaultKind::WrongFingerprint => head.fingerprint ^= 1 << below(random, 64),
            SnapshotFaultKind::Absurd => {
                let input = below(random, head.inputs as usize);
                match below(random, 3) {
                    0 => head.length_scale[axis][input] = ABSURD_LENGTH_SCALE,
                    1 => head.signal_variance[axis] = ABSURD_VARIANCE,
                    _ => head.noise_variance[axis] = -head.noise_variance[axis],
                }
            }
            SnapshotFaultKind::Torn => bad = torn(good).ok().filter(|torn| torn != good)?,
        }
        Some(bad)
    }
}

/// Moves all points to one place, without noise.
fn twins(good: &ModelSnapshot) -> Result<ModelSnapshot, DecodeError> {
    let mut bad = ModelSnapshot::new(good.head);
    let place = good.rows().next().map(|row| row.input.to_vec()).unwrap_or_default();
    for row in good.rows() {
        bad.push_with_noise(&place, three(row.target), three(row.weight), NEXT_TO_NO_NOISE)?;
    }
    Ok(bad)
}

/// Adds one input, or removes one where there is no room for more.
fn with_another_input(good: &ModelSnapshot) -> Result<ModelSnapshot, DecodeError> {
    let inputs = good.head.inputs as usize;
    let other = if inputs < INPUTS_MAX { inputs + 1 } else { inputs - 1 };
    let mut head = good.head;
    head.inputs = other as u32;
    let mut bad = ModelSnapshot::new(head);
    for row in good.rows() {
        let mut input = row.input.to_vec();
        input.resize(other, 0.5);
        bad.push_with_noise(&input, three(row.target), three(row.weight), row.noise_scale)?;
    }
    Ok(bad)
}

/// Gives each point the weights of the point half the snapshot away.
fn torn(good: &ModelSnapshot) -> Result<ModelSnapshot, DecodeError> {
    let mut bad = ModelSnapshot::new(good.head);
    let behind = good.rows().skip(good.rows().len() / 2);
    for (row, other) in good.rows().zip(behind.chain(good.rows())) {
        bad.push_with_noise(row.input, three(row.target), three(other.weight), row.noise_scale)?;
    }
    Ok(bad)
}

fn three(values: &[f64]) -> [f64; AXES] {
    std::array::from_fn(|axis| values.get(axis).copied().unwrap_or(f64::NAN))
}

/// A random number below `end`; 0 if there is none.
fn below(random: &mut SplitMix64, end: usize) -> usize {
    (random.uniform() * end as f64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::SnapshotFault;
    use bytemuck::Zeroable;
    use protocol::message::SnapshotHead;

    fn good(version: u64) -> Result<ModelSnapshot, DecodeError> {
        let mut head = SnapshotHead::zeroed();
        (head.version, head.inputs, head.noise_variance) = (version, 6, [0.1; AXES]);
        let mut snapshot = ModelSnapshot::new(head);
        for row in 0..8 {
            let at = f64::from(row) + version as f64;
            snapshot.push(&[at; 6], [at; AXES], [0.5 * at; AXES])?;
        }
        Ok(snapshot)
    }

    #[test]
    fn each_fault_changes_only_the_snapshots_of_its_ticks() -> Result<(), DecodeError> {
        for kind in SnapshotFaultKind::ALL {
            let fault =
                SnapshotFault { kind, from_tick: 30, until_tick: Some(40), probability: 1.0 };
            let mut fault_injector =
                SnapshotFaultInjector::new(SnapshotFaults { seed: 1, snapshot: vec![fault] });
            for tick in [10, 20, 40] {
                assert_eq!(fault_injector.in_place_of(&good(tick)?, tick), None, "{}", kind.name());
            }
            let bad = fault_injector.in_place_of(&good(50)?, 30);
            assert!(bad.is_some_and(|bad| Ok(&bad) != good(50).as_ref()), "{}", kind.name());
        }
        Ok(())
    }

    #[test]
    fn a_stale_snapshot_is_older_than_the_last_good_one_published() -> Result<(), DecodeError> {
        let fault = SnapshotFault {
            kind: SnapshotFaultKind::Stale,
            from_tick: 30,
            until_tick: None,
            probability: 1.0,
        };
        let mut fault_injector =
            SnapshotFaultInjector::new(SnapshotFaults { seed: 1, snapshot: vec![fault] });
        for tick in [10, 20] {
            assert_eq!(fault_injector.in_place_of(&good(tick)?, tick), None);
        }
        for tick in [30, 40] {
            assert_eq!(
                fault_injector.in_place_of(&good(tick)?, tick).map(|bad| bad.head.version),
                Some(10)
            );
        }
        Ok(())
    }
}
