//! Damaged messages, offered to the readers of every topic and, as commands, to the gate. Each
//! message comes in its memory form and in its network form.
//!
//! The messages are offered in a separate process, [`print()`], so that a panic and the growth of
//! memory can be detected.

mod numbers;

use super::measure::Measured;
use super::session::Trouble;
use gate::{Bounds, Gate};
use protocol::VERSION;
use protocol::frame::{self, DecodeError};
use protocol::message::{
    Command, Credit, FallbackLevel, Health, Message, ModelSnapshot, Plan, PlantState, Reason,
    ResidualSample, SnapshotHead, Stamp, TAIL_MAX, Truth,
};
use protocol::topic::OnTopic;
use protocol::wire;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use robot::Robot;
use serde::{Deserialize, Serialize};
use std::fs;
use std::process::Command as Process;
use std::time::Duration;
use transport::{Exchange, Identity, Ports, Since, Source};

/// T \[ns\].
const PERIOD: u64 = 20_000_000;
/// The plant's own epoch.
const EPOCH: u64 = 7;
/// Epoch and writer of the controller that the gate obeys.
const CONTROLLER: (u64, u64) = (3, 5);
/// The tick that the commands answer.
const TICK: u64 = 1;
/// Values that no used number may have.
const BAD: [f64; 5] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, -1e300];
/// Largest growth of the memory in use after the first tenth of the messages \[KiB\].
const GROWTH_KIBIBYTES: u64 = 512;

/// How many messages to offer.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct OfferOptions {
    /// Number of damaged messages.
    pub count: u64,
    /// Seed of the damage.
    pub seed: u64,
}

/// Result of the offers.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Offered {
    /// Number of damaged messages.
    injections: u64,
    /// The accepted messages, one line each.
    violations: Vec<String>,
    /// Memory in use after a tenth of the messages, and at the end \[KiB\].
    kibibytes: [u64; 2],
}

/// Offers damaged messages, and prints the result on the standard output.
///
/// # Errors
/// If an undamaged message is rejected.
pub fn print(options: &OfferOptions) -> Result<(), Trouble> {
    terminal::print(serde_json::to_string(&offer(options.count, options.seed)?)?);
    Ok(())
}

/// Offers `count` damaged messages in a separate process. None may be accepted, nothing may panic,
/// and the memory may not grow.
///
/// # Errors
/// If the messages could not be offered.
pub(super) fn run(count: u64, seed: u64) -> Result<Measured, Trouble> {
    let output = Process::new(std::env::current_exe()?)
        .arg("offer")
        .args([count.to_string(), seed.to_string()])
        .output()?;
    if !output.status.success() {
        let violations = vec![format!(
            "it ended with {}: {}",
            output.status,
            String::from_utf8_lossy(&output.stderr).trim()
        )];
        return Ok(Measured { injections: count, violations, ..Measured::default() });
    }
    let Offered { injections, mut violations, kibibytes: [before, after] } =
        serde_json::from_slice(&output.stdout)?;
    if after > before + GROWTH_KIBIBYTES {
        violations.push(format!(
            "{after} KiB of memory in use, expected {before} and {GROWTH_KIBIBYTES} more at most"
        ));
    }
    let notes = vec![format!(
        "memory in use: {before} KiB when a tenth had been offered, {after} KiB in the end"
    )];
    Ok(Measured { injections, violations, notes, ..Measured::default() })
}

/// Encoding of a message.
#[derive(Debug, Clone, Copy)]
enum Encoding {
    /// As it lies in memory, shared or not.
    Memory,
    /// As a program in another language reads it.
    Network,
}

impl Encoding {
    const BOTH: [Self; 2] = [Self::Memory, Self::Network];

    /// One of the two, at random.
    fn any(random: &mut Pcg64Mcg) -> Self {
        if random.random() { Self::Memory } else { Self::Network }
    }

    /// As a program of this version encodes it.
    fn sealed<T: Message>(self, message: T) -> Vec<u8> {
        self.sealed_as(message, VERSION, T::KIND)
    }

    fn sealed_as<T: Message>(self, mut message: T, version: u16, kind: u16) -> Vec<u8> {
        *message.stamp_mut() = Stamp { version, kind, ..*message.stamp() };
        let mut bytes = vec![0; message.byte_len()];
        match self {
            Self::Memory => frame::encode(&message, &mut bytes),
            Self::Network => {
                wire::encode(&message, &mut bytes);
            }
        }
        bytes
    }

    fn decode<T: Message>(self, bytes: &[u8]) -> Result<T, DecodeError> {
        match self {
            Self::Memory => frame::decode(bytes),
            Self::Network => wire::decode(bytes),
        }
    }
}

/// Offers every number that a receiver checks. Then nine of ten messages are commands for the gate,
/// and the others go to the readers of all topics.
fn offer(count: u64, seed: u64) -> Result<Offered, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut offered = Offered::default();
    numbers::offer(&mut offered)?;
    for tenth in 0..10 {
        let share = count / 10 + u64::from(tenth < count % 10);
        let to_readers = share / 10;
        offer_to_gate(share - to_readers, &mut random, &mut offered)?;
        offer_to_readers(to_readers, &mut random, &mut offered)?;
        offered.kibibytes[usize::from(tenth > 0)] = resident_kibibytes()?;
    }
    Ok(offered)
}

/// Memory in use by this process.
fn resident_kibibytes() -> Result<u64, Trouble> {
    let status = fs::read_to_string("/proc/self/status")?;
    let resident = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:")?.split_whitespace().next()?.parse().ok());
    Ok(resident.ok_or("the system does not report how much memory is in use")?)
}

fn offer_to_gate(count: u64, random: &mut Pcg64Mcg, offered: &mut Offered) -> Result<(), Trouble> {
    let gate = obeying()?;
    for encoding in Encoding::BOTH {
        accepted(&encoding.sealed(good()), encoding, &gate)
            .map_err(|reason| format!("the undamaged command was rejected: {reason}"))?;
    }
    for _ in 0..count {
        let encoding = Encoding::any(random);
        let bytes = damaged(encoding, random);
        if accepted(&bytes, encoding, &gate).is_ok() {
            offered.violations.push(format!("damaged command {} was accepted", offered.injections));
        }
        offered.injections += 1;
    }
    Ok(())
}

/// The gate of a robot that has obeyed a controller in its first period, and has just published the
/// state of the second.
fn obeying() -> Result<Gate, Trouble> {
    let mut gate = Gate::new(Bounds::new(&Robot::example(), PERIOD, 0), EPOCH);
    gate.begin_period(0, 0);
    let mut first = good();
    first.stamp.tick = 0;
    gate.offer(&first, PERIOD / 4)
        .map_err(|reason: Reason| format!("the first command was rejected: {reason}"))?;
    gate.decide(PERIOD / 4);
    gate.begin_period(TICK, PERIOD);
    Ok(gate)
}

/// The command that its controller would send.
fn good() -> Command {
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.stamp.epoch, command.stamp.writer) = CONTROLLER;
    command.stamp.tick = TICK;
    command.plant_epoch = EPOCH;
    command.fallback_level = FallbackLevel::FreshPlan.code();
    command.input = [0.1, 0.0, 0.0];
    command.tail_len = TAIL_MAX as u32;
    command
}

/// A random number other than this one.
fn other_than(one: u16, random: &mut Pcg64Mcg) -> u16 {
    one.wrapping_add(random.random_range(1..=u16::MAX))
}

/// A command that is damaged on the way (bits, length), or sealed with a valid checksum by a faulty
/// writer or by one of another version.
fn damaged(encoding: Encoding, random: &mut Pcg64Mcg) -> Vec<u8> {
    let mut command = good();
    match random.random_range(0..5_u8) {
        0 => return with_other_bits(&encoding.sealed(command), random),
        1 => {
            let mut bytes = encoding.sealed(command);
            bytes.truncate(random.random_range(0..bytes.len()));
            return bytes;
        }
        2 => return encoding.sealed_as(command, other_than(VERSION, random), Command::KIND),
        3 => {
            // A random number of it: in the input, or in the tail up to its last entry.
            let bad = BAD[random.random_range(0..BAD.len())];
            let mut numbers = command.input.iter_mut().chain(command.tail.as_flattened_mut());
            if let Some(number) = numbers.nth(random.random_range(0..3 * (1 + TAIL_MAX))) {
                *number = bad;
            }
        }
        _ => match random.random_range(0..7_u8) {
            0 => command.plant_epoch = EPOCH.wrapping_add(random.random_range(1..u64::MAX)),
            1 => command.stamp.tick = TICK.wrapping_add(random.random_range(1..u64::MAX)),
            // The network encoding cannot carry a wrong tail length.
            2 if matches!(encoding, Encoding::Memory) => {
                command.tail_len = random.random_range(1 + TAIL_MAX as u32..=u32::MAX);
            }
            3 => command.fallback_level = random.random_range(7..=u32::MAX),
            4 => command.stamp.epoch = random.random_range(0..CONTROLLER.0),
            5 => command.stamp.writer = CONTROLLER.1.wrapping_add(random.random_range(1..u64::MAX)),
            _ => return encoding.sealed_as(command, VERSION, other_than(Command::KIND, random)),
        },
    }
    encoding.sealed(command)
}

fn with_other_bits(good: &[u8], random: &mut Pcg64Mcg) -> Vec<u8> {
    let mut bytes = good.to_vec();
    for _ in 0..random.random_range(1..=8_u8) {
        let place = random.random_range(0..bytes.len());
        let bit = 1 << random.random_range(0..8_u8);
        // XOR with the good byte: the same bit twice would otherwise be no damage.
        if let (Some(byte), Some(good)) = (bytes.get_mut(place), good.get(place)) {
            *byte = good ^ bit;
        }
    }
    bytes
}

/// Whether decoder and gate accept it.
fn accepted(bytes: &[u8], encoding: Encoding, gate: &Gate) -> Result<(), String> {
    let command: Command = encoding.decode(bytes).map_err(|error| error.to_string())?;
    gate.clone().offer(&command, PERIOD + PERIOD / 4).map_err(|reason: Reason| reason.to_string())
}

/// Offers to the reader of each topic in turn. The reader must accept none, and must count every
/// one.
fn offer_to_readers(
    count: u64,
    random: &mut Pcg64Mcg,
    offered: &mut Offered,
) -> Result<(), Trouble> {
    let each = count / 8;
    let snapshot = ModelSnapshot::new(SnapshotHead { inputs: 6, ..bytemuck::Zeroable::zeroed() });
    offer_to_reader::<PlantState>(
        &bytemuck::Zeroable::zeroed(),
        count - 7 * each,
        random,
        offered,
    )?;
    offer_to_reader::<Command>(&bytemuck::Zeroable::zeroed(), each, random, offered)?;
    offer_to_reader::<ResidualSample>(&bytemuck::Zeroable::zeroed(), each, random, offered)?;
    offer_to_reader::<ModelSnapshot>(&snapshot, each, random, offered)?;
    offer_to_reader::<Plan>(&bytemuck::Zeroable::zeroed(), each, random, offered)?;
    offer_to_reader::<Health>(&bytemuck::Zeroable::zeroed(), each, random, offered)?;
    offer_to_reader::<Truth>(&bytemuck::Zeroable::zeroed(), each, random, offered)?;
    offer_to_reader::<Credit>(&bytemuck::Zeroable::zeroed(), each, random, offered)
}

fn offer_to_reader<T: OnTopic + Clone>(
    good: &T,
    count: u64,
    random: &mut Pcg64Mcg,
    offered: &mut Offered,
) -> Result<(), Trouble> {
    let ports = Ports::in_memory(&Exchange::new(false, Duration::from_secs(1)), Identity::new(1));
    let (mut source, mut sink): (Source<T>, _) =
        (ports.source(Since::First)?, ports.raw_sink(T::TOPIC)?);
    for encoding in Encoding::BOTH {
        encoding.decode::<T>(&encoding.sealed(good.clone()))?;
    }
    let mut sent = 0;
    for _ in 0..count {
        let encoding = Encoding::any(random);
        let mut bytes = encoding.sealed(good.clone());
        match random.random_range(0..4_u8) {
            0 => bytes = with_other_bits(&bytes, random),
            // Memory carriers may move whole words only.
            1 if matches!(encoding, Encoding::Memory) => {
                bytes.truncate(8 * random.random_range(1..bytes.len() / 8));
            }
            1 => bytes.truncate(random.random_range(0..bytes.len())),
            2 => bytes = encoding.sealed_as(good.clone(), other_than(VERSION, random), T::KIND),
            _ => bytes = encoding.sealed_as(good.clone(), VERSION, other_than(T::KIND, random)),
        }
        let taken_in = match encoding {
            Encoding::Memory => {
                sink.send_raw(&bytes)?;
                sent += 1;
                source.next()?.is_some()
            }
            Encoding::Network => wire::decode::<T>(&bytes).is_ok(),
        };
        if taken_in {
            offered.violations.push(format!(
                "damaged {} {} was accepted",
                T::NAME,
                offered.injections
            ));
        }
        offered.injections += 1;
    }
    let refused = source.tally().refused;
    if refused != sent {
        offered.violations.push(format!(
            "{refused} of {sent} damaged messages on topic {} were counted",
            T::TOPIC.name()
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_messages_are_all_rejected_and_counted() -> Result<(), Trouble> {
        let offered = offer(20_000, 1)?;
        assert_eq!(offered.violations, Vec::<String>::new());
        assert_eq!(offered.injections, 20_000 + 1_050, "with those of single numbers");
        Ok(())
    }
}
