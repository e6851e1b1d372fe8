//! The clock: real time, or lock step with the other processes.
//!
//! A simulated world cannot advance while its process does not run. When the machine suspends the
//! process, the world stands still for that time instead of jumping over it. The time is counted
//! and logged. A real robot moves on: its ticks continue one after the other, but its commands are
//! older by that time, so that the gate brakes. The log has each such time, and Health those of a
//! period or more.

use crate::gated::{GatedBase, SLICE_NANOS};
use crate::orders::{Orders, ended_with_stop};
use crate::surroundings::Seen;
use crate::{Base, BaseError, Sensors, Settings};
use process::{Pace, Pulse, Repeated, Stop, step_back};
use protocol::clock::monotonic_nanos;
use protocol::message::{
    Command, Credit, FallbackLevel, Participant, Phase, PlantState, Reason, Truth,
};
use protocol::topic::Topic;
use std::time::{Duration, Instant};
use transport::{Identity, OpenError, Ports, ReceiveError, SendError, Since, Sink, Source};

/// Longest wait in lock step between two checks of the stop signals.
const PATIENCE: Duration = Duration::from_millis(20);
/// A clock check that is later than this is a stall of the machine, not of the world \[ns\].
const STALL_NANOS: u64 = 5_000_000;

/// Unit of a wait, unless it is shorter \[ns\].
const MILLISECOND: u64 = 1_000_000;

/// Why the plant ended before the end of the run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A port could not be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// A state could not be sent.
    #[error(transparent)]
    Send(#[from] SendError),
    /// The base failed.
    #[error(transparent)]
    Base(#[from] BaseError),
}

/// Drives `base` until the end of the run, or until a stop is requested.
///
/// # Errors
/// [`RunError`].
pub fn run(
    base: impl Base,
    settings: &Settings<'_>,
    ports: &Ports,
    identity: Identity,
    stop: &Stop,
) -> Result<(), RunError> {
    let mut plant = Plant::new(base, settings, ports, identity)?;
    settings.run.go_first_to_run();
    plant.pulse.phase(Phase::Ready);
    tracing::info!(epoch = identity.epoch, ticks = settings.ticks(), "starting at rest");
    match settings.run.pace {
        Pace::RealTime => plant.run_real_time(stop)?,
        Pace::LockStep => plant.run_lock_step(stop)?,
    }
    plant.report();
    plant.refused.rest().iter().for_each(tell);
    plant.pulse.last_words(Phase::Finished, settings.run.pace);
    step_back();
    Ok(())
}

/// Length of a sleep when `left` remains of the period \[ns\]: whole milliseconds, which are cheap,
/// then the exact rest.
fn nap(left: u64) -> u64 {
    if left < MILLISECOND { left } else { (left - left % MILLISECOND).min(SLICE_NANOS) }
}

/// The clock of the ticks: the monotonic clock, minus the times in which the machine suspended this
/// process.
#[derive(Debug)]
struct Clock {
    origin: u64,
    /// Last check, on the monotonic clock.
    looked: u64,
}

impl Clock {
    fn begin() -> Self {
        let now = monotonic_nanos();
        Self { origin: now, looked: now }
    }

    /// Time of the ticks at `now` on the monotonic clock, and the time removed since the last check
    /// \[ns\]. The excess over `waited` is removed if it is too long for work.
    fn look(&mut self, now: u64, waited: u64) -> (u64, u64) {
        let beyond = now.saturating_sub(self.looked + waited);
        let stalled = if beyond > STALL_NANOS { beyond } else { 0 };
        (self.origin, self.looked) = (self.origin + stalled, now);
        (now - self.origin, stalled)
    }
}

struct Plant<'a, B> {
    settings: &'a Settings<'a>,
    robot: GatedBase<B>,
    states: Sink<PlantState>,
    truths: Sink<Truth>,
    seen: Seen,
    commands: Source<Command>,
    credits: Source<Credit>,
    pulse: Pulse,
    /// Number of malformed commands that the gate has counted.
    malformed: u64,
    /// Commands that were rejected for other reasons.
    refused: Repeated<Reason>,
    orders: Orders,
    epoch: u64,
    driven: bool,
    /// Time in which this process did not run while the robot moved on \[ns\].
    lost: u64,
}

impl<'a, B: Base> Plant<'a, B> {
    fn new(
        base: B,
        settings: &'a Settings<'a>,
        ports: &Ports,
        identity: Identity,
    ) -> Result<Self, OpenError> {
        let mut commands: Source<Command> =
            ports.source(if settings.run.restarted { Since::Joining } else { Since::First })?;
        // The first wait opens the listener, so that no message sent after "ready" is missed.
        let _ = commands.wait(Duration::ZERO);
        let mut robot = GatedBase::new(base, settings, identity.epoch);
        if settings.run.restarted && ended_with_stop(settings.run) {
            robot.stop(Reason::OperatorStop);
        }
        Ok(Self {
            settings,
            robot,
            states: ports.sink()?,
            truths: ports.sink()?,
            seen: Seen::open(ports, identity.epoch, settings)?,
            commands,
            credits: ports.source(Since::Joining)?,
            pulse: Pulse::new(ports, Participant::Plant)?.exposed(settings.run.exposure),
            malformed: 0,
            refused: Repeated::default(),
            orders: Orders::open(settings.run, identity.epoch),
            epoch: identity.epoch,
            driven: false,
            lost: 0,
        })
    }

    fn run_real_time(&mut self, stop: &Stop) -> Result<(), RunError> {
        let period = self.settings.run.period_nanos;
        let mut clock = Clock::begin();
        for tick in 0..=self.settings.ticks() {
            let (begin, end) = (tick * period, (tick + 1) * period);
            let sensors = self.robot.read()?;
            // What passes until the sensors are read makes commands older, but not this state.
            self.look(&mut clock, 0, tick)?;
            self.publish(tick, begin + self.lost, &sensors)?;
            if tick == self.settings.ticks() || stop.requested() {
                break;
            }
            loop {
                let now = self.look(&mut clock, 0, tick)?;
                if now >= end {
                    break;
                }
                let nap = nap(end - now);
                self.commands.wait(Duration::from_nanos(nap))?;
                let now = self.look(&mut clock, nap, tick)?.min(end);
                self.take_order(tick);
                self.take_commands(now + self.lost)?;
                self.robot.advance(now + self.lost)?;
            }
            self.end_period(end + self.lost)?;
        }
        Ok(())
    }

    /// Time of the ticks now, when the process only waited for `waited` \[ns\] since the last
    /// check.
    fn look(&mut self, clock: &mut Clock, waited: u64, tick: u64) -> Result<u64, BaseError> {
        let (now, stalled) = clock.look(monotonic_nanos(), waited);
        let micros = stalled / 1000;
        if stalled > 0 && self.robot.pass_over(stalled)? {
            self.lost += stalled;
            if stalled >= self.settings.run.period_nanos {
                self.pulse.health().set_last_error("the machine suspended the driver: see its log");
            }
            tracing::warn!(
                tick,
                micros,
                "the machine suspended the driver; its commands are older"
            );
        } else if stalled > 0 {
            self.pulse.health().stalled_nanos += stalled;
            tracing::warn!(
                tick,
                micros,
                "the machine suspended the simulator; its world stood still"
            );
        }
        Ok(now)
    }

    fn run_lock_step(&mut self, stop: &Stop) -> Result<(), RunError> {
        let period = self.settings.run.period_nanos;
        let mut credit = None;
        for tick in 0..=self.settings.ticks() {
            while self.settings.recorded && credit.is_none_or(|through| through < tick) {
                if stop.requested() {
                    return Ok(());
                }
                self.credits.wait(PATIENCE)?;
                while let Some(granted) = self.credits.next()? {
                    credit = Some(granted.through_tick);
                }
                // A restarted recorder needs the last state to know the present tick.
                self.states.refresh()?;
                self.pulse.beat();
            }
            let begin = tick * period;
            let sensors = self.robot.read()?;
            self.publish(tick, begin, &sensors)?;
            while !self.answered(tick, begin)? {
                if stop.requested() {
                    return Ok(());
                }
                self.commands.wait(PATIENCE)?;
                // A restarted controller needs the last state to answer it.
                self.states.refresh()?;
                self.pulse.beat();
            }
            if tick < self.settings.ticks() {
                self.end_period(begin + period)?;
            }
        }
        Ok(())
    }

    fn publish(&mut self, tick: u64, now: u64, sensors: &Sensors) -> Result<(), RunError> {
        self.take_order(tick);
        let (mut state, truth) = self.robot.begin_period(tick, now, sensors);
        // Before the state: the controller that receives it has the list as well.
        self.seen.publish(&mut self.robot, tick, now)?;
        self.states.send(&mut state)?;
        if let Some(mut truth) = truth {
            self.truths.send(&mut truth)?;
        }
        Ok(())
    }

    /// Follows an operator's order, if there is one, in the period of `tick`.
    fn take_order(&mut self, tick: u64) {
        if let Some(order) = self.orders.take() {
            self.orders.answer(tick, self.robot.order(order));
        }
    }

    /// Lock step: whether the answer to `tick` has arrived, accepted or not.
    fn answered(&mut self, tick: u64, now: u64) -> Result<bool, RunError> {
        while let Some(command) = self.commands.next()? {
            self.offer(&command, now)?;
            if command.stamp.tick == tick && command.plant_epoch == self.epoch {
                self.refuse_malformed();
                return Ok(true);
            }
        }
        self.refuse_malformed();
        Ok(false)
    }

    fn take_commands(&mut self, now: u64) -> Result<(), RunError> {
        while let Some(command) = self.commands.next()? {
            self.offer(&command, now)?;
        }
        self.refuse_malformed();
        Ok(())
    }

    /// Counts the commands that could not be decoded since the last call.
    fn refuse_malformed(&mut self) {
        let refused = self.commands.tally().refused;
        for _ in self.malformed..refused {
            self.robot.refuse_malformed();
        }
        self.malformed = refused;
    }

    fn offer(&mut self, command: &Command, now: u64) -> Result<(), RunError> {
        match self.robot.offer(command, now)? {
            Ok(()) if !self.driven => {
                self.driven = true;
                self.pulse.phase(Phase::Running);
            }
            Ok(()) => {}
            Err(reason) => self.refused.note(reason, 1),
        }
        Ok(())
    }

    fn end_period(&mut self, now: u64) -> Result<(), RunError> {
        let fallback_level = self.robot.end_period(now)?;
        let health = self.pulse.health();
        if self.driven && fallback_level >= FallbackLevel::StoredTail {
            health.deadlines_missed += 1;
        } else if self.driven {
            health.deadlines_met += 1;
        }
        self.report();
        Ok(())
    }

    fn report(&mut self) {
        let machine = self.robot.machine();
        self.pulse.show_gate(machine.state(), machine.stop_reason());
        self.pulse.count_source(Topic::Command, self.commands.tally());
        self.pulse.count_sink(&self.states);
        self.pulse.count_sink(&self.truths);
        self.pulse.count_sink(self.seen.sink());
        self.pulse.count_source(Topic::Obstacles, self.seen.planned());
        if self.seen.overflows {
            let text = "more than 64 obstacles: the last ones are ignored";
            self.pulse.health().set_last_error(text);
        }
        self.pulse.beat();
        self.refused.due(Instant::now()).iter().for_each(tell);
    }
}

/// Logs the number of commands that were rejected for a reason.
fn tell((reason, count): &(Reason, u64)) {
    tracing::warn!(count, "commands refused: {reason}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_world_stands_still_while_its_process_is_suspended() {
        const MS: u64 = 1_000_000;
        let mut clock = Clock { origin: 100 * MS, looked: 100 * MS };
        assert_eq!(clock.look(102 * MS, 2 * MS), (2 * MS, 0));
        assert_eq!(clock.look(106 * MS, 0), (6 * MS, 0), "work of 6 ms");
        assert_eq!(clock.look(190 * MS, 2 * MS), (8 * MS, 82 * MS), "a wait of 2 ms that took 84");
        assert_eq!(clock.look(260 * MS, 0), (8 * MS, 70 * MS), "no wait, and 70 ms lost");
        assert_eq!(clock.look(261 * MS, MS), (9 * MS, 0));
    }
}
