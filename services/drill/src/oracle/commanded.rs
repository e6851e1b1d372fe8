//! Rule g: what acts is what its controller sent for this period.

use super::change::body;
use super::{Limits, Rule, Ticks, Violation};
use crate::record::{Message, Record};
use serde_json::Value;
use std::collections::BTreeMap;

/// Rounding on the way from an input to the wheels and back \[m/s, m/s, rad/s\].
const TOLERANCE: f64 = 1e-9;

/// The recorded commands, by epoch of plant and controller, writer, and the answered tick. A
/// command that a link has changed or repeated is there more than once.
pub(super) struct Commanded<'a>(BTreeMap<[u64; 4], Vec<&'a Message>>);

impl<'a> Commanded<'a> {
    pub(super) fn of(record: &'a Record) -> Self {
        let mut commands: BTreeMap<[u64; 4], Vec<&Message>> = BTreeMap::new();
        for command in record.of("command") {
            let key = [
                command.count("plant_epoch"),
                command.stamp("epoch"),
                command.stamp("writer"),
                command.stamp("tick"),
            ];
            commands.entry(key).or_default().push(command);
        }
        Self(commands)
    }

    /// The truth of a tick reports what acted until then. A command that is missing from the record
    /// is not judged.
    pub(super) fn judge(
        &self,
        epoch: u64,
        truths: &Ticks<'_>,
        limits: &Limits,
        violations: &mut Vec<Violation>,
    ) {
        for (&tick, truth) in truths {
            let (acting, answered) = (truth.count("acting_epoch"), truth.count("acting_tick"));
            let Some(age) = tick
                .checked_sub(1)
                .and_then(|past| past.checked_sub(answered))
                .filter(|_| acting > 0)
            else {
                continue;
            };
            let Some(commands) =
                self.0.get(&[epoch, acting, truth.count("acting_writer"), answered])
            else {
                continue;
            };
            let Some(acts) = body(truth, limits) else { continue };
            let inputs: Vec<Value> = commands.iter().map(|command| entry(command, age)).collect();
            if !inputs.iter().any(|input| is_near(input, &acts)) {
                let expected = inputs.iter().map(Value::to_string).collect::<Vec<_>>().join(" or ");
                let found = format!("{acts:.4?} acts of the answer to tick {answered}");
                violations.push(Violation {
                    rule: Rule::AsCommanded,
                    epoch,
                    tick,
                    found,
                    expected,
                });
            }
        }
    }
}

/// The input of a command for a state that is `age` periods old.
fn entry(command: &Message, age: u64) -> Value {
    match age.checked_sub(1) {
        None => command.fields["input"].clone(),
        Some(later) => command.fields["tail"][later as usize].clone(),
    }
}

fn is_near(input: &Value, acts: &[f64; 3]) -> bool {
    let input: Vec<f64> =
        input.as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    input.len() == acts.len()
        && input
            .iter()
            .zip(acts)
            .all(|(sent, acts)| (sent - acts).abs() <= TOLERANCE * (1.0 + sent.abs()))
}
