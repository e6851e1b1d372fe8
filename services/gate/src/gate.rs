//! The gate: stores the accepted command, and decides the input of the wheels at every moment.

use crate::Bounds;
use crate::accept::{AtArrival, Writer, judge};
use crate::arbiter::{self, Accepted, Choice, RECOVERY_PERIODS};
use crate::machine::{Machine, Order, OrderError};
use crate::protection::{Before, Protection, Slowed, TooManyObstacles};
use protocol::message::{Command, FallbackLevel, GateState, ObstacleSource, Reason};
use robot::{Obstacle, Robot, Surroundings, Velocity};

/// Number of stored publication times: more than any acceptable age.
const REMEMBERED: usize = 8;

/// The command that drives the wheels now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Acting {
    /// Epoch of the controller; 0 if none drives.
    pub epoch: u64,
    /// Its writer.
    pub writer: u64,
    /// Tick that its command answered.
    pub tick: u64,
}

/// Input of the wheels at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// Body velocity for the wheels \[m/s, m/s, rad/s\].
    pub input: Velocity,
    /// Where it comes from.
    pub fallback_level: FallbackLevel,
    /// Why this source acts.
    pub reason: Reason,
    /// The command that it comes from.
    pub acting: Acting,
}

/// The last accepted command.
#[derive(Debug, Clone, Copy)]
struct Stored {
    command: Command,
    /// Publication time of the answered state \[ns\].
    answered_nanos: u64,
}

/// The gate of one plant instance. All times are nanoseconds of the caller's monotonic clock, or
/// ticks times the period in lock step.
#[derive(Debug, Clone)]
pub struct Gate {
    bounds: Bounds,
    plant_epoch: u64,
    tick: u64,
    /// (tick, time) of the last published states.
    published: [(u64, u64); REMEMBERED],
    stored: Option<Stored>,
    writer: Option<Writer>,
    input: Velocity,
    /// Value of `input` when the period began.
    begun_with: Velocity,
    /// Time at which `input` was last computed.
    input_nanos: u64,
    machine: Machine,
    braking: bool,
    good_periods: u32,
    refused: u64,
    /// Last rejection of the present period.
    refusal: Reason,
    /// The surroundings, if they are known.
    protection: Option<Box<Protection>>,
    /// Why the last command of the present period was slowed.
    slowed_in_period: Reason,
    /// Input of the command that the last output is slower than, and why.
    slowed_command: Option<(Velocity, Reason)>,
}

impl Gate {
    /// An armed gate that has accepted no command yet.
    pub fn new(bounds: Bounds, plant_epoch: u64) -> Self {
        Self {
            bounds,
            plant_epoch,
            tick: 0,
            published: [(u64::MAX, 0); REMEMBERED],
            stored: None,
            writer: None,
            input: [0.0; 3],
            begun_with: [0.0; 3],
            input_nanos: 0,
            machine: Machine::armed(),
            braking: false,
            good_periods: 0,
            refused: 0,
            refusal: Reason::None,
            protection: None,
            slowed_in_period: Reason::None,
            slowed_command: None,
        }
    }

    /// The same, among `surroundings`: it slows the commands of `robot` before it touches them.
    /// Until the first [`see_pose`](Self::see_pose) the wheels stand still.
    #[must_use]
    pub fn among(self, surroundings: &Surroundings, robot: &Robot) -> Self {
        let protection = Protection::new(surroundings, robot, self.bounds.period_nanos);
        Self { protection: Some(Box::new(protection)), ..self }
    }

    /// The same, disarmed: the wheels stand still until [`Order::Arm`].
    #[must_use]
    pub fn disarmed(self) -> Self {
        Self { machine: Machine::disarmed(), ..self }
    }

    /// Publishes the state of `tick` at `now`.
    pub fn begin_period(&mut self, tick: u64, now: u64) {
        self.tick = tick;
        if let Some(slot) = self.published.get_mut(tick as usize % REMEMBERED) {
            *slot = (tick, now);
        }
        self.refusal = Reason::None;
        self.begun_with = self.input;
        self.slowed_in_period = Reason::None;
    }

    /// Sets pose and body velocity, as measured when the period began. Until the next measurement
    /// the gate predicts the pose by its own output. Numbers that are not finite are ignored.
    pub fn see_pose(&mut self, pose: &[f64; 3], velocity: &Velocity) {
        let now = self.published_at(self.tick).unwrap_or(self.input_nanos);
        if let Some(protection) = &mut self.protection {
            protection.see_pose(pose, velocity, &self.begun_with, now);
        }
    }

    /// Replaces the list of obstacles of `source` by one that arrived at `now` and is valid for
    /// `valid_nanos`. A list that is too old bounds the speed until the next one. Without
    /// surroundings, lists are ignored.
    ///
    /// # Errors
    /// [`TooManyObstacles`]; the list before it stays.
    pub fn see_obstacles(
        &mut self,
        source: ObstacleSource,
        obstacles: &[Obstacle],
        now: u64,
        valid_nanos: u64,
    ) -> Result<(), TooManyObstacles> {
        match &mut self.protection {
            Some(protection) => protection.see_obstacles(source, obstacles, now, valid_nanos),
            None => Ok(()),
        }
    }

    /// Judges and stores one command that arrived at `now`.
    ///
    /// # Errors
    /// The [`Reason`] why it will not act.
    pub fn offer(&mut self, command: &Command, now: u64) -> Result<(), Reason> {
        let at_arrival = AtArrival {
            plant_epoch: self.plant_epoch,
            tick: self.tick,
            now,
            age_nanos: self.published_at(command.stamp.tick).map(|at| now.saturating_sub(at)),
            accepted: self.accepted(),
            writer: self.writer,
            acting: self.input,
            begun_with: self.begun_with,
            slowed: self.slowed_command.map(|(asked, _)| asked),
        };
        if let Err(reason) = judge(command, &at_arrival, &self.bounds) {
            self.refuse(reason);
            if let Some(writer) = &mut self.writer
                && (writer.epoch, writer.number) == (command.stamp.epoch, command.stamp.writer)
            {
                writer.last_nanos = now; // rejected, but not silent
            }
            return Err(reason);
        }
        self.writer = Some(Writer {
            epoch: command.stamp.epoch,
            number: command.stamp.writer,
            last_nanos: now,
        });
        let answered_nanos = self.published_at(command.stamp.tick).unwrap_or(now);
        self.stored = Some(Stored { command: *command, answered_nanos });
        // Only an answer to the present period leaves the brake. It was judged by the present wheel
        // speeds, unlike a tail.
        self.braking &= self.good_periods < RECOVERY_PERIODS || command.stamp.tick != self.tick;
        if command.stop().is_stop_request() {
            self.machine.stop(command.stop());
        } else if !self.braking {
            self.machine.drive();
        }
        Ok(())
    }

    /// Counts a malformed message.
    pub fn refuse(&mut self, reason: Reason) {
        self.refused += 1;
        self.refusal = reason;
    }

    /// Input of the wheels at `now`.
    pub fn decide(&mut self, now: u64) -> Decision {
        let (choice, fallback_level, reason) = arbiter::decide(&self.situation(now));
        let stored = self.stored.map(|stored| stored.command);
        let elapsed = now.saturating_sub(self.input_nanos);
        self.input_nanos = now;
        if let Some(protection) = &mut self.protection {
            protection.predict(&self.input, now);
        }
        let asked = match (choice, stored) {
            (Choice::Command, Some(command)) => Some(command.input),
            (Choice::Tail(index), Some(command)) => {
                Some(command.tail().get(index).copied().unwrap_or([0.0; 3]))
            }
            _ => None,
        };
        let Slowed { input, reason: slowed } = match asked {
            Some(asked) => self.slow(&asked, now, elapsed),
            None if choice == Choice::Brake => {
                Slowed::not(self.bounds.braked(&self.input, elapsed))
            }
            None => Slowed::not([0.0; 3]),
        };
        self.input = input;
        self.slowed_command = asked.filter(|_| slowed != Reason::None).map(|asked| (asked, slowed));
        let reason = if slowed == Reason::None { reason } else { slowed };
        if slowed != Reason::None {
            self.slowed_in_period = slowed;
        }
        if choice == Choice::Brake && !self.braking {
            self.braking = true;
            self.good_periods = 0;
        }
        let acting = match (choice, stored) {
            (Choice::Command | Choice::Tail(_), Some(command)) => Acting {
                epoch: command.stamp.epoch,
                writer: command.stamp.writer,
                tick: command.stamp.tick,
            },
            _ => Acting::default(),
        };
        Decision { input: self.input, fallback_level, reason, acting }
    }

    /// Passes over the time until `now`, in which this process did not run: commands and lists get
    /// older, and the ramp of the brake does not advance.
    pub fn pass_over(&mut self, now: u64) {
        self.input_nanos = now;
    }

    /// Lowers each axis of the output to the measured `velocity` of a base that has stopped its
    /// motors by itself, so that the ramp of the brake does not drive it again. NaN lowers nothing.
    pub fn lower_to(&mut self, velocity: &Velocity) {
        for (output, measured) in self.input.iter_mut().zip(velocity) {
            let along = measured * output.signum();
            *output = output.abs().min(along).max(0.0).copysign(*output);
        }
    }

    /// Ends the period at `now`, and returns its fallback level: that of the answer to its own
    /// state, if one arrived in time.
    pub fn end_period(&mut self, now: u64) -> (FallbackLevel, Reason) {
        let answered = self
            .stored
            .map(|stored| stored.command)
            .filter(|command| command.stamp.tick == self.tick);
        if self.braking {
            self.good_periods = if answered.is_some() { self.good_periods + 1 } else { 0 };
        }
        let (fallback_level, reason) = match (self.machine.state(), answered) {
            (GateState::Stopped, _) => (FallbackLevel::LatchedStop, self.machine.stop_reason()),
            (GateState::Disarmed, _) => (FallbackLevel::Waiting, Reason::Disarmed),
            (_, Some(_)) if self.braking => (FallbackLevel::Brake, Reason::Recovering),
            (_, None) if self.braking => (FallbackLevel::Brake, Reason::Missing),
            (_, Some(command)) => {
                (command.fallback_level(), arbiter::own_reason(command.fallback_level()))
            }
            (_, None) => {
                let (_, fallback_level, reason) =
                    arbiter::decide(&self.situation(now.saturating_sub(1)));
                // A tail acted, even if its command arrived late enough to begin with that tail.
                let was_late = matches!(
                    fallback_level,
                    FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan | FallbackLevel::Simple
                );
                (if was_late { FallbackLevel::StoredTail } else { fallback_level }, reason)
            }
        };
        // A sample of this period is of no use for the learner, whatever was rejected.
        let driven = !matches!(
            fallback_level,
            FallbackLevel::Waiting | FallbackLevel::Brake | FallbackLevel::LatchedStop
        );
        if driven && self.slowed_in_period != Reason::None {
            return (fallback_level, self.slowed_in_period);
        }
        (fallback_level, self.explain(reason))
    }

    /// Stops: brakes along the ramp and stands still, whatever commands arrive, until
    /// [`Order::Resume`].
    pub fn stop(&mut self, reason: Reason) {
        self.machine.stop(reason);
    }

    /// Sets whether the robot's own emergency stop is pressed.
    pub fn set_estop(&mut self, pressed: bool) {
        self.machine.set_estop(pressed);
    }

    /// Executes an operator's order. After a stop, the brake is left as after any other brake.
    ///
    /// # Errors
    /// [`OrderError`] if the order is invalid in the present state.
    pub fn order(&mut self, order: Order) -> Result<(), OrderError> {
        self.machine.order(order)?;
        if order == Order::Resume {
            (self.braking, self.good_periods) = (self.stored.is_some(), 0);
        }
        Ok(())
    }

    /// State of the gate, and why it has stopped.
    pub fn machine(&self) -> &Machine {
        &self.machine
    }

    /// Highest controller epoch that was accepted.
    pub fn controller_epoch(&self) -> u64 {
        self.writer.map_or(0, |writer| writer.epoch)
    }

    /// Epoch and tick of the last accepted command.
    pub fn accepted(&self) -> Option<(u64, u64)> {
        self.stored.map(|stored| (stored.command.stamp.epoch, stored.command.stamp.tick))
    }

    /// Number of rejected commands.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// `input` of a command, as far as the surroundings allow it.
    fn slow(&self, input: &Velocity, now: u64, elapsed: u64) -> Slowed {
        let Some(protection) = &self.protection else { return Slowed::not(*input) };
        let before = Before {
            input: self.input,
            begun_with: self.begun_with,
            slowed: self.slowed_command.map_or(Reason::None, |(_, reason)| reason),
            elapsed_nanos: elapsed,
        };
        protection.slow(&self.bounds, input, &before, now)
    }

    fn explain(&self, reason: Reason) -> Reason {
        if self.refusal == Reason::None { reason } else { self.refusal }
    }

    fn published_at(&self, tick: u64) -> Option<u64> {
        self.published.iter().find(|(published, _)| *published == tick).map(|(_, at)| *at)
    }

    fn situation(&self, now: u64) -> arbiter::Situation {
        let accepted = self.stored.map(|stored| Accepted {
            fallback_level: stored.command.fallback_level(),
            age_periods: now.saturating_sub(stored.answered_nanos) / self.bounds.period_nanos,
            tail: u64::from(stored.command.tail_len),
        });
        arbiter::Situation { machine: self.machine, accepted, braking: self.braking }
    }
}

#[cfg(test)]
mod tests;
