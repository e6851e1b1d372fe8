//! Whether one command may act at all.

use crate::Bounds;
use protocol::message::{Command, Reason};

/// Most that the answered state's age may be, in half periods: 1.5 T.
const AGE_LIMIT_HALF_PERIODS: u64 = 3;
/// Silence after which another writer of the same epoch is listened to \[periods\].
pub(crate) const SILENCE_PERIODS: u64 = 3;

/// What the gate knows when a command comes.
#[derive(Debug, Clone, Copy)]
pub struct Situation {
    /// The plant's own epoch.
    pub plant_epoch: u64,
    /// Its present tick.
    pub tick: u64,
    /// Time since the state that the command answers was published; `None` if that is too long ago to be remembered \[ns\].
    pub age_nanos: Option<u64>,
    /// Controller epoch and tick of the last accepted command.
    pub accepted: Option<(u64, u64)>,
    /// Highest controller epoch so far, its writer, and the time since that was last heard \[ns\].
    pub writer: Option<(u64, u64, u64)>,
    /// Input that acts at this moment.
    pub acting: [f64; 3],
    /// Input that acted when the period began.
    pub begun_with: [f64; 3],
}

/// Judges one command. Pure, does not allocate.
///
/// # Errors
/// The [`Reason`] why it may not act.
pub fn judge(command: &Command, situation: &Situation, bounds: &Bounds) -> Result<(), Reason> {
    let inputs = || std::iter::once(&command.input).chain(command.tail());
    if !inputs().flatten().all(|value| value.is_finite()) {
        return Err(Reason::NotFinite);
    }
    if !inputs().all(|input| bounds.contain(input)) {
        return Err(Reason::OutOfBounds);
    }
    if command.plant_epoch != situation.plant_epoch {
        return Err(Reason::OldPlantEpoch);
    }
    judge_writer(command, situation, bounds)?;
    if command.stamp.tick > situation.tick {
        return Err(Reason::FromTheFuture);
    }
    // Epoch before tick: a controller that takes over may answer a state that the other one has answered already, but no older one.
    if situation.accepted.is_some_and(|(epoch, tick)| {
        command.stamp.tick < tick || (command.stamp.tick, command.stamp.epoch) == (tick, epoch)
    }) {
        return Err(Reason::NotNewer);
    }
    let oldest = bounds.period_nanos * AGE_LIMIT_HALF_PERIODS / 2 + bounds.link_delay_nanos;
    let Some(age) = situation.age_nanos.filter(|&age| age <= oldest) else {
        return Err(Reason::TooOld);
    };
    // By its age, it may be the tail that acts first. And a tail may have moved on since the period began: both changes together are one period's.
    let first = inputs().nth((age / bounds.period_nanos) as usize);
    let leaps = |from: &[f64; 3]| first.is_some_and(|first| !bounds.allow_change(from, first));
    let steps = inputs().zip(command.tail());
    if leaps(&situation.acting)
        || leaps(&situation.begun_with)
        || !steps.into_iter().all(|(before, after)| bounds.allow_change(before, after))
    {
        return Err(Reason::TooFast);
    }
    Ok(())
}

/// Of two epochs the higher; of two writers with the same epoch the first, until it has been silent.
fn judge_writer(command: &Command, situation: &Situation, bounds: &Bounds) -> Result<(), Reason> {
    let Some((epoch, writer, silent_nanos)) = situation.writer else { return Ok(()) };
    if command.stamp.epoch < epoch {
        return Err(Reason::OldEpoch);
    }
    let another = command.stamp.epoch == epoch && command.stamp.writer != writer;
    if another && silent_nanos < SILENCE_PERIODS * bounds.period_nanos {
        return Err(Reason::SecondWriter);
    }
    Ok(())
}
