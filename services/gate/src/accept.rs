//! Decides whether a command may act.

use crate::Bounds;
use protocol::message::{Command, Reason};

/// Largest age of the answered state, in half periods: 1.5 T.
const AGE_LIMIT_HALF_PERIODS: u64 = 3;
/// Silence of a writer after which another writer of the same epoch is accepted \[periods\].
pub(crate) const SILENCE_PERIODS: u64 = 3;

/// The controller whose commands are accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Writer {
    /// Its epoch, the highest so far.
    pub epoch: u64,
    /// Its number, which no other process of the epoch has.
    pub number: u64,
    /// Time of its last command \[ns\].
    pub last_nanos: u64,
}

/// State of the gate when a command arrives.
#[derive(Debug, Clone, Copy)]
pub struct AtArrival {
    /// The plant's own epoch.
    pub plant_epoch: u64,
    /// Its present tick.
    pub tick: u64,
    /// Time of the arrival \[ns\].
    pub now: u64,
    /// Time since the publication of the state that the command answers \[ns\]; `None` if it is no
    /// longer stored.
    pub age_nanos: Option<u64>,
    /// Controller epoch and tick of the last accepted command.
    pub accepted: Option<(u64, u64)>,
    /// Whose commands are accepted, once there was one.
    pub writer: Option<Writer>,
    /// Input that acts at this moment.
    pub acting: [f64; 3],
    /// Input that acted when the period began.
    pub begun_with: [f64; 3],
    /// The command that the surroundings slow at this moment, if they do.
    pub slowed: Option<[f64; 3]>,
}

/// Judges one command. Pure; does not allocate.
///
/// # Errors
/// The [`Reason`] why it may not act.
pub fn judge(command: &Command, at: &AtArrival, bounds: &Bounds) -> Result<(), Reason> {
    let inputs = || std::iter::once(&command.input).chain(command.tail());
    if !inputs().flatten().all(|value| value.is_finite()) {
        return Err(Reason::NotFinite);
    }
    if !inputs().all(|input| bounds.contain(input)) {
        return Err(Reason::OutOfBounds);
    }
    if command.plant_epoch != at.plant_epoch {
        return Err(Reason::OldPlantEpoch);
    }
    judge_writer(command, at, bounds)?;
    if command.stamp.tick > at.tick {
        return Err(Reason::FromTheFuture);
    }
    // Epoch before tick: a controller that takes over may answer the state that the previous one
    // has already answered, but no older one.
    if at.accepted.is_some_and(|(epoch, tick)| {
        command.stamp.tick < tick || (command.stamp.tick, command.stamp.epoch) == (tick, epoch)
    }) {
        return Err(Reason::NotNewer);
    }
    let oldest = bounds.period_nanos * AGE_LIMIT_HALF_PERIODS / 2 + bounds.link_delay_nanos;
    let Some(age) = at.age_nanos.filter(|&age| age <= oldest) else {
        return Err(Reason::TooOld);
    };
    // At this age, an entry of the tail may be the first input to act.
    let first = inputs().nth((age / bounds.period_nanos) as usize);
    let leaps = first.is_some_and(|first| {
        if let Some(asked) = &at.slowed {
            // A writer continues its own plan, or begins with the slowed output.
            return !bounds.allow_change_between([asked, &at.acting, &at.begun_with], first);
        }
        // A tail may have advanced since the period began: both changes together are those of one
        // period.
        [&at.acting, &at.begun_with].iter().any(|from| !bounds.allow_change(from, first))
    });
    let steps = inputs().zip(command.tail());
    if leaps || !steps.into_iter().all(|(before, after)| bounds.allow_change(before, after)) {
        return Err(Reason::TooFast);
    }
    Ok(())
}

/// The higher of two epochs wins. Of two writers of the same epoch the first wins until it is
/// silent.
fn judge_writer(command: &Command, at: &AtArrival, bounds: &Bounds) -> Result<(), Reason> {
    let Some(writer) = at.writer else { return Ok(()) };
    if command.stamp.epoch < writer.epoch {
        return Err(Reason::OldEpoch);
    }
    let another = command.stamp.epoch == writer.epoch && command.stamp.writer != writer.number;
    if another && at.now.saturating_sub(writer.last_nanos) < SILENCE_PERIODS * bounds.period_nanos {
        return Err(Reason::SecondWriter);
    }
    Ok(())
}
