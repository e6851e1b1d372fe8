//! Damaged messages, offered to the decoder and, where it takes them, to the gate.

use super::measure::Measured;
use super::session::Trouble;
use gate::{Bounds, Gate};
use model::robot::Robot;
use protocol::VERSION;
use protocol::frame;
use protocol::message::{Command, Message, Reason, Rung};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// T \[ns\].
const PERIOD: u64 = 20_000_000;
/// The plant's own epoch.
const EPOCH: u64 = 7;
/// What no number of a command may be.
const BAD: [f64; 5] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, -1e300];

/// Offers `count` commands, each damaged in one way; none may be accepted.
///
/// # Errors
/// If the undamaged one is refused.
pub(super) fn run(count: u64, seed: u64) -> Result<Measured, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let bounds = Bounds::new(&Robot::example(), PERIOD, 0);
    let good = sealed(good());
    accepted(&good, &bounds).map_err(|reason| format!("the undamaged command was refused: {reason}"))?;
    let mut violations = Vec::new();
    for index in 0..count {
        let bytes = damaged(&good, &mut random);
        if accepted(&bytes, &bounds).is_ok() {
            violations.push(format!("damaged command {index} of seed {seed} was accepted"));
        }
    }
    Ok(Measured { injections: count, violations, ..Measured::default() })
}

/// What a controller would answer to the state of tick 0.
fn good() -> Command {
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.stamp.epoch, command.stamp.writer) = (3, 5);
    command.plant_epoch = EPOCH;
    command.rung = Rung::FreshPlan.code();
    command.input = [0.1, 0.0, 0.0];
    command.tail_len = 2;
    command
}

fn sealed(mut command: Command) -> Vec<u8> {
    command.stamp_mut().version = VERSION;
    command.stamp_mut().kind = Command::KIND;
    let mut bytes = vec![0; command.byte_len()];
    frame::encode(&command, &mut bytes);
    bytes
}

/// Damaged on the way (bits, length), or by a writer that has gone mad and seals what it says.
fn damaged(good: &[u8], random: &mut Pcg64Mcg) -> Vec<u8> {
    let mut bytes = good.to_vec();
    match random.random_range(0..4_u8) {
        0 => {
            for _ in 0..random.random_range(1..=8_u8) {
                let place = random.random_range(0..bytes.len());
                let bit = 1 << random.random_range(0..8_u8);
                // Twice the same bit would be no damage.
                if let (Some(byte), Some(good)) = (bytes.get_mut(place), good.get(place)) {
                    *byte = good ^ bit;
                }
            }
            bytes
        }
        1 => {
            bytes.truncate(random.random_range(0..good.len()));
            bytes
        }
        2 => {
            let mut command = self::good();
            let bad = BAD[random.random_range(0..BAD.len())];
            let axis = random.random_range(0..3_usize);
            match random.random_range(0..3_usize) {
                0 => command.input[axis] = bad,
                entry => command.tail[entry - 1][axis] = bad,
            }
            sealed(command)
        }
        _ => {
            let mut command = self::good();
            match random.random_range(0..4_u8) {
                0 => command.plant_epoch = EPOCH + random.random_range(1..u64::MAX - EPOCH),
                1 => command.stamp.tick = random.random_range(1..u64::MAX),
                2 => command.tail_len = random.random_range(5..u32::MAX),
                _ => command.rung = random.random_range(7..u32::MAX),
            }
            sealed(command)
        }
    }
}

/// What decoder and gate of a robot that has just published its first state say of it.
fn accepted(bytes: &[u8], bounds: &Bounds) -> Result<(), String> {
    let command = frame::decode::<Command>(bytes).map_err(|error| error.to_string())?;
    let mut gate = Gate::new(*bounds, EPOCH);
    gate.begin_period(0, 0);
    gate.offer(&command, PERIOD / 4).map_err(|reason: Reason| reason.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_many_damaged_commands_none_is_accepted() -> Result<(), Trouble> {
        let measured = run(20_000, 1)?;
        assert_eq!((measured.injections, measured.violations), (20_000, Vec::new()));
        Ok(())
    }
}
