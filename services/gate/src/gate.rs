//! The gate: stores the accepted command, and decides the input of the wheels at every moment.

use crate::Bounds;
use crate::accept::{self, judge};
use crate::arbiter::{self, Accepted, Choice, RECOVERY_PERIODS, decide};
use crate::machine::{Machine, Order, OrderError};
use crate::protection::{Protection, Slowed, TooManyObstacles};
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
    /// Highest epoch, its writer, and the time of its last command.
    writer: Option<(u64, u64, u64)>,
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
    slowed: Reason,
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
            slowed: Reason::None,
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
        self.slowed = Reason::None;
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
        let at_arrival = accept::AtArrival {
            plant_epoch: self.plant_epoch,
            tick: self.tick,
            age_nanos: self.published_at(command.stamp.tick).map(|at| now.saturating_sub(at)),
            accepted: self.accepted(),
            writer: self
                .writer
                .map(|(epoch, writer, heard)| (epoch, writer, now.saturating_sub(heard))),
            acting: self.input,
            begun_with: self.begun_with,
        };
        if let Err(reason) = judge(command, &at_arrival, &self.bounds) {
            self.refuse(reason);
            if let Some((epoch, writer, heard)) = &mut self.writer
                && (*epoch, *writer) == (command.stamp.epoch, command.stamp.writer)
            {
                *heard = now; // rejected, but not silent
            }
            return Err(reason);
        }
        self.writer = Some((command.stamp.epoch, command.stamp.writer, now));
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
        let (choice, fallback_level, reason) = decide(&self.situation(now));
        let stored = self.stored.map(|stored| stored.command);
        let elapsed = now.saturating_sub(self.input_nanos);
        self.input_nanos = now;
        if let Some(protection) = &mut self.protection {
            protection.predict(&self.input, now);
        }
        let Slowed { input, reason: slowed } = match (choice, stored) {
            (Choice::Command, Some(command)) => self.slow(&command.input, now, elapsed),
            (Choice::Tail(index), Some(command)) => {
                let input = command.tail().get(index).copied().unwrap_or([0.0; 3]);
                self.slow(&input, now, elapsed)
            }
            (Choice::Brake, _) => Slowed::not(self.bounds.braked(&self.input, elapsed)),
            _ => Slowed::not([0.0; 3]),
        };
        self.input = input;
        let reason = if slowed == Reason::None { reason } else { slowed };
        if slowed != Reason::None {
            self.slowed = slowed;
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
                let (_, fallback_level, reason) = decide(&self.situation(now.saturating_sub(1)));
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
        if driven && self.slowed != Reason::None {
            return (fallback_level, self.slowed);
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
        self.writer.map_or(0, |(epoch, ..)| epoch)
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
        match &self.protection {
            Some(protection) => protection.slow(&self.bounds, input, &self.input, now, elapsed),
            None => Slowed::not(*input),
        }
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
mod tests {
    use super::*;
    use robot::Robot;

    const PERIOD: u64 = 100_000_000;

    fn gate() -> Gate {
        let mut robot = Robot::example();
        (robot.limits.input_rate_mps2, robot.limits.yaw_input_rate_radps2) = (20.0, 40.0);
        (robot.limits.brake_mps2, robot.limits.yaw_brake_radps2) = (10.0, 20.0);
        Gate::new(Bounds::new(&robot, PERIOD, 0), 7)
    }

    fn command(epoch: u64, writer: u64, tick: u64) -> Command {
        let mut command: Command = bytemuck::Zeroable::zeroed();
        (command.stamp.epoch, command.stamp.writer, command.stamp.tick) = (epoch, writer, tick);
        command.plant_epoch = 7;
        command.fallback_level = FallbackLevel::FreshPlan.code();
        command.input = [1.0, 0.0, 0.0];
        command.tail = [[0.9, 0.0, 0.0], [0.8, 0.0, 0.0], [0.7, 0.0, 0.0], [0.0; 3]];
        command.tail_len = 3;
        command
    }

    #[test]
    fn without_a_command_the_wheels_stand_still_and_the_reason_is_waiting() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        let decision = gate.decide(PERIOD / 2);
        assert_eq!((decision.input, decision.fallback_level), ([0.0; 3], FallbackLevel::Waiting));
        assert_eq!(gate.end_period(PERIOD), (FallbackLevel::Waiting, Reason::NoCommandYet));
    }

    #[test]
    fn after_the_last_command_acts_the_tail_and_after_three_periods_the_brake() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        assert_eq!(gate.offer(&command(1, 5, 0), 10), Ok(()));
        let at = |gate: &mut Gate, periods: f64| gate.decide((periods * PERIOD as f64) as u64);
        assert_eq!(at(&mut gate, 0.5).input[0], 1.0);
        assert_eq!(
            (at(&mut gate, 1.0).input[0], at(&mut gate, 1.0).fallback_level),
            (0.9, FallbackLevel::StoredTail)
        );
        assert_eq!(at(&mut gate, 2.99).input[0], 0.8);
        assert_eq!(at(&mut gate, 3.0).fallback_level, FallbackLevel::Brake);
        let slowing = at(&mut gate, 3.05).input[0];
        assert!(slowing < 0.8 && slowing > 0.0);
        assert_eq!(at(&mut gate, 5.0).input, [0.0; 3]);
    }

    #[test]
    fn each_kind_of_bad_command_is_rejected_with_its_reason() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        gate.begin_period(1, PERIOD);
        gate.begin_period(2, 2 * PERIOD);
        let now = 2 * PERIOD + 10;
        assert_eq!(gate.offer(&command(3, 5, 1), 2 * PERIOD + 10), Ok(()));
        let with = |change: &dyn Fn(&mut Command)| {
            let mut bad = command(3, 5, 2);
            change(&mut bad);
            bad
        };
        for (bad, reason) in [
            (with(&|c| c.input[1] = f64::NAN), Reason::NotFinite),
            (with(&|c| c.tail[2][0] = f64::INFINITY), Reason::NotFinite),
            (with(&|c| c.input[0] = 5.1), Reason::OutOfBounds),
            (with(&|c| c.input = [4.9, 4.9, 5.9]), Reason::OutOfBounds),
            (with(&|c| c.input[0] = -4.9), Reason::TooFast),
            (with(&|c| c.plant_epoch = 6), Reason::OldPlantEpoch),
            (with(&|c| c.stamp.epoch = 2), Reason::OldEpoch),
            (with(&|c| c.stamp.writer = 6), Reason::SecondWriter),
            (with(&|c| c.stamp.tick = 3), Reason::FromTheFuture),
            (with(&|c| c.stamp.tick = 1), Reason::NotNewer),
        ] {
            assert_eq!(gate.offer(&bad, now), Err(reason), "{bad:?}");
        }
        assert_eq!(gate.offer(&command(3, 5, 2), now + 3 * PERIOD / 2), Err(Reason::TooOld));
        assert_eq!(gate.refused(), 11);
        assert_eq!(gate.offer(&command(3, 5, 2), now), Ok(()));
    }

    #[test]
    fn a_second_writer_of_the_same_epoch_is_accepted_once_the_first_is_silent() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
        gate.begin_period(4, 4 * PERIOD);
        assert_eq!(gate.offer(&command(1, 6, 4), 4 * PERIOD), Ok(()));
    }

    #[test]
    fn a_tail_entry_and_a_command_together_keep_the_change_limit_of_one_command() {
        let most = 2.2 * 2.0; // of the rate in a period
        let with = |input: f64, tail: f64, tick| {
            let mut command = command(1, 5, tick);
            (command.input[0], command.tail, command.tail_len) = (input, [[tail, 0.0, 0.0]; 4], 2);
            command
        };
        let mut gate = gate();
        gate.begin_period(0, 0);
        assert_eq!(gate.offer(&with(1.0, -1.0, 0), 10), Ok(()));
        assert_eq!(gate.decide(PERIOD - 1).input[0], 1.0);
        gate.begin_period(1, PERIOD);
        assert_eq!(gate.decide(PERIOD + 10).input[0], -1.0, "the tail has advanced");
        let too_far = 1.0 - most - 0.1;
        assert!(
            (too_far - -1.0_f64).abs() < most,
            "relative to the acting input it would be allowed"
        );
        assert_eq!(gate.offer(&with(too_far, too_far, 1), PERIOD + 20), Err(Reason::TooFast));
        assert_eq!(gate.offer(&with(1.0 - most, -3.0, 1), PERIOD + 30), Ok(()));
    }

    #[test]
    fn a_late_command_is_judged_by_the_entry_of_its_tail_that_acts_first() {
        let most = 2.2 * 2.0;
        let late = |tail: f64| {
            let mut command = command(1, 5, 1);
            (command.input[0], command.tail, command.tail_len) = (4.0, [[tail, 0.0, 0.0]; 4], 4);
            command
        };
        let mut gate = gate();
        gate.begin_period(0, 0);
        let mut first = command(1, 5, 0);
        (first.input[0], first.tail) = (0.0, [[0.0; 3]; 4]);
        assert_eq!(gate.offer(&first, 10), Ok(()));
        gate.begin_period(1, PERIOD);
        gate.begin_period(2, 2 * PERIOD);
        assert_eq!(gate.decide(2 * PERIOD).input[0], 0.0);
        let now = 2 * PERIOD + PERIOD / 4;
        assert_eq!(
            gate.offer(&late(most + 0.1), now),
            Err(Reason::TooFast),
            "relative to its input it would be a small step"
        );
        assert_eq!(gate.offer(&late(most - 0.1), now), Ok(()));
        assert_eq!(gate.decide(now).input[0], most - 0.1);
    }

    #[test]
    fn only_an_answer_to_the_present_period_leaves_the_brake() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
        for tick in 1..5 {
            gate.begin_period(tick, tick * PERIOD);
            gate.decide(tick * PERIOD);
            gate.end_period((tick + 1) * PERIOD - 1);
        }
        for tick in 5..8 {
            let now = tick * PERIOD;
            gate.begin_period(tick, now);
            assert_eq!(gate.offer(&command(1, 5, tick), now + 10), Ok(()));
            assert_eq!(gate.decide(now + 20).input, [0.0; 3]);
            assert_eq!(
                gate.end_period(now + PERIOD - 1),
                (FallbackLevel::Brake, Reason::Recovering)
            );
        }
        let now = 8 * PERIOD;
        gate.begin_period(8, now);
        assert_eq!(
            gate.decide(now + 5).input,
            [0.0; 3],
            "three good periods are over, and this one has no answer yet"
        );
        assert_eq!(gate.offer(&command(1, 5, 8), now + 10), Ok(()));
        assert_eq!(gate.decide(now + 20).input, [1.0, 0.0, 0.0]);
        assert_eq!(gate.end_period(now + PERIOD - 1), (FallbackLevel::FreshPlan, Reason::None));
    }

    #[test]
    fn a_greater_epoch_takes_over_within_a_period_but_never_with_an_older_answer() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        gate.begin_period(1, PERIOD);
        assert_eq!(gate.offer(&command(1, 5, 1), PERIOD + 10), Ok(()));
        assert_eq!(gate.offer(&command(2, 6, 0), PERIOD + 20), Err(Reason::NotNewer));
        assert_eq!(
            gate.offer(&command(2, 6, 1), PERIOD + 30),
            Ok(()),
            "it is slower, but of a greater epoch"
        );
        assert_eq!(gate.offer(&command(1, 5, 1), PERIOD + 40), Err(Reason::OldEpoch));
        assert_eq!(gate.offer(&command(2, 6, 1), PERIOD + 50), Err(Reason::NotNewer));
    }

    #[test]
    fn leaving_the_brake_needs_three_good_periods() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
        gate.decide(0);
        gate.decide(4 * PERIOD);
        let mut driving = Vec::new();
        for tick in 5..10 {
            gate.begin_period(tick, tick * PERIOD);
            assert_eq!(gate.offer(&command(1, 5, tick), tick * PERIOD + 5), Ok(()));
            driving.push(gate.decide(tick * PERIOD + 10).acting.epoch > 0);
            gate.end_period((tick + 1) * PERIOD);
        }
        assert_eq!(driving, [false, false, false, true, true]);
    }

    #[test]
    fn answers_a_little_into_each_period_keep_their_fallback_level() {
        let mut gate = gate();
        for tick in 0..20 {
            let begin = tick * PERIOD;
            gate.begin_period(tick, begin);
            gate.decide(begin);
            gate.decide(begin + PERIOD / 40);
            let mut simple = command(1, 5, tick);
            simple.fallback_level = FallbackLevel::Simple.code();
            assert_eq!(gate.offer(&simple, begin + PERIOD / 20), Ok(()));
            gate.decide(begin + PERIOD / 2);
            assert_eq!(gate.end_period(begin + PERIOD).0, FallbackLevel::Simple, "tick {tick}");
        }
    }

    #[test]
    fn a_stop_is_latched_against_every_command_until_it_is_resumed() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        let mut asking = command(1, 5, 0);
        asking.stop = Reason::HeadingError.code();
        assert_eq!(gate.offer(&asking, 0), Ok(()));
        assert_eq!(gate.decide(1).fallback_level, FallbackLevel::LatchedStop);
        assert_eq!(gate.end_period(PERIOD), (FallbackLevel::LatchedStop, Reason::HeadingError));
        let period = |gate: &mut Gate, tick: u64| {
            let now = tick * PERIOD;
            gate.begin_period(tick, now);
            gate.decide(now);
            // Another controller has taken over from the one that requested the stop.
            assert_eq!(gate.offer(&command(2, 6, tick), now + 5), Ok(()));
            let input = gate.decide(now + 10).input;
            (input, gate.end_period(now + PERIOD).0)
        };
        for tick in 1..9 {
            assert_eq!(
                period(&mut gate, tick),
                ([0.0; 3], FallbackLevel::LatchedStop),
                "tick {tick}"
            );
        }
        assert_eq!(gate.order(Order::Resume), Ok(()));
        let after: Vec<FallbackLevel> = (9..13).map(|tick| period(&mut gate, tick).1).collect();
        assert_eq!(
            after,
            [
                FallbackLevel::Brake,
                FallbackLevel::Brake,
                FallbackLevel::Brake,
                FallbackLevel::FreshPlan
            ]
        );
        assert_eq!(gate.machine().state(), GateState::Driving);
    }

    #[test]
    fn a_stop_brakes_along_the_ramp() {
        let mut gate = gate();
        gate.begin_period(0, 0);
        assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
        assert_eq!(gate.decide(0).input[0], 1.0);
        gate.stop(Reason::BadState);
        let slowing = gate.decide(PERIOD / 2).input[0];
        assert!((slowing - 0.5).abs() < 1e-12, "10 m/s² for 50 ms from 1 m/s: {slowing}");
        assert_eq!(gate.decide(PERIOD).input, [0.0; 3]);
    }

    #[test]
    fn a_disarmed_gate_drives_once_it_is_armed() {
        let mut gate = gate().disarmed();
        gate.begin_period(0, 0);
        assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
        assert_eq!(gate.decide(1).input, [0.0; 3]);
        assert_eq!(gate.end_period(PERIOD), (FallbackLevel::Waiting, Reason::Disarmed));
        assert_eq!(gate.order(Order::Arm), Ok(()));
        gate.begin_period(1, PERIOD);
        assert_eq!(gate.offer(&command(1, 5, 1), PERIOD), Ok(()));
        assert_eq!(gate.decide(PERIOD).input[0], 1.0);
        assert_eq!(gate.end_period(2 * PERIOD), (FallbackLevel::FreshPlan, Reason::None));
    }
}
