//! One base behind its gate, period by period.

use crate::{Base, BaseError, Sensors, Settings, TrueState};
use gate::{Acting, Bounds, Decision, Gate, Machine, Order, OrderError};
use protocol::message::{
    Command, FallbackLevel, OBSTACLES_MAX, ObstacleSource, PlantState, Reason, Truth,
};
use robot::{Obstacle, PerWheel, Velocity, Wheels};

/// Longest time that the base drives between two decisions of the gate: the step of the braking
/// ramp \[ns\].
pub const SLICE_NANOS: u64 = 2_000_000;

/// Time for which the hardware of a base may act on the last velocity of a driver that has died or
/// hangs \[ns\]. A stall of the machine is shorter, as a rule.
pub const WATCHDOG_NANOS: u64 = 100_000_000;

/// Base and gate of one plant epoch. All times are nanoseconds since its start.
pub struct GatedBase<B> {
    base: B,
    gate: Gate,
    wheels: Wheels,
    decision: Decision,
    /// Fallback level and reason of the past period.
    past: (FallbackLevel, Reason),
    /// Time until which the base has been driven.
    at: u64,
    period_nanos: u64,
    witnessed: Witnessed,
    /// Controller that acted in the last slice.
    acting: Acting,
    /// Epoch and writer of the last controller that acted, also if none acts now; `None` before the
    /// first.
    acted_last: Option<(u64, u64)>,
    /// Sum of the gate's output since the last state, weighted by time \[ns\].
    given: Velocity,
    given_nanos: u64,
}

/// Input of the wheels in the past period, for the truth message.
#[derive(Debug, Clone, Copy, Default)]
struct Witnessed {
    wheel_peak: PerWheel,
    acting_age_nanos: u64,
    takeovers: u32,
    takeovers_back: u32,
}

impl<B: Base> GatedBase<B> {
    /// `base` at rest at its start, behind a gate that has received nothing yet.
    pub fn new(base: B, settings: &Settings<'_>, epoch: u64) -> Self {
        let period_nanos = settings.run.period_nanos;
        let link_delay_nanos = settings.link_delay_millis * 1_000_000;
        let bounds = Bounds::new(settings.robot, period_nanos, link_delay_nanos);
        let gate = Gate::new(bounds, epoch);
        let gate = match settings.surroundings {
            Some(surroundings) => gate.among(surroundings, settings.robot),
            None => gate,
        };
        let mut gate = if settings.armed { gate } else { gate.disarmed() };
        let decision = gate.decide(0);
        Self {
            base,
            gate,
            wheels: settings.robot.wheels,
            decision,
            past: (FallbackLevel::Waiting, Reason::NoCommandYet),
            at: 0,
            period_nanos,
            witnessed: Witnessed::default(),
            acting: Acting::default(),
            acted_last: None,
            given: [0.0; 3],
            given_nanos: 0,
        }
    }

    /// The present measurements of the base.
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be read.
    pub fn read(&mut self) -> Result<Sensors, BaseError> {
        self.base.read()
    }

    /// Begins the period of `tick` at `now`, when `sensors` were read. A base that is not simulated
    /// has no truth.
    pub fn begin_period(
        &mut self,
        tick: u64,
        now: u64,
        sensors: &Sensors,
    ) -> (PlantState, Option<Truth>) {
        self.gate.begin_period(tick, now);
        self.gate.see_pose(&sensors.pose, &sensors.velocity);
        let truth = self.base.truth().map(|truth| self.write_truth(tick, &truth));
        (self.write_state(tick, sensors), truth)
    }

    /// Offers a command that arrived at `now` to the gate, and returns the verdict.
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be driven.
    pub fn offer(&mut self, command: &Command, now: u64) -> Result<Result<(), Reason>, BaseError> {
        self.advance(now)?;
        let verdict = self.gate.offer(command, now);
        self.decision = self.gate.decide(now);
        Ok(verdict)
    }

    /// Counts malformed messages.
    pub fn refuse_malformed(&mut self) {
        self.gate.refuse(Reason::Malformed);
    }

    /// Passes an operator's order to the gate.
    ///
    /// # Errors
    /// [`OrderError`] if the order is invalid in the present state.
    pub fn order(&mut self, order: Order) -> Result<(), OrderError> {
        self.gate.order(order)
    }

    /// Stops the robot until an operator resumes it.
    pub fn stop(&mut self, reason: Reason) {
        self.gate.stop(reason);
    }

    /// State of the gate, and why it has stopped.
    pub fn machine(&self) -> &Machine {
        self.gate.machine()
    }

    /// The obstacles that the base sees at `now`, if it has such sensors. The gate takes them as a
    /// list that is valid for `valid_nanos`; those for which it has no room are left out.
    pub fn look_around(&mut self, now: u64, valid_nanos: u64) -> Option<&[Obstacle]> {
        let seen = self.base.obstacles()?;
        let known = seen.get(..OBSTACLES_MAX).unwrap_or(seen);
        // It has room for all of these.
        let _ = self.gate.see_obstacles(ObstacleSource::Robot, known, now, valid_nanos);
        Some(seen)
    }

    /// Passes a list of a planner to the gate: `obstacles` at `now`, valid for `valid_nanos`. Those
    /// for which it has no room are left out.
    pub fn see_planned(&mut self, obstacles: &[Obstacle], now: u64, valid_nanos: u64) {
        let known = obstacles.get(..OBSTACLES_MAX).unwrap_or(obstacles);
        // It has room for all of these.
        let _ = self.gate.see_obstacles(ObstacleSource::Planner, known, now, valid_nanos);
    }

    /// Passes over `nanos` in which this process did not run, if the robot moves on meanwhile, and
    /// returns whether it does: commands are older by that time. A simulated robot, which has a
    /// truth, stands still with this process. After [`WATCHDOG_NANOS`] the base may have stopped its
    /// motors, so the brake begins no faster than the base moves.
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be read.
    pub fn pass_over(&mut self, nanos: u64) -> Result<bool, BaseError> {
        if self.base.truth().is_some() {
            return Ok(false);
        }
        self.at += nanos;
        self.gate.pass_over(self.at);
        if nanos >= WATCHDOG_NANOS {
            self.gate.lower_to(&self.base.read()?.velocity);
        }
        Ok(true)
    }

    /// Drives the base until `now`; the gate decides anew every [`SLICE_NANOS`].
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be driven.
    pub fn advance(&mut self, now: u64) -> Result<(), BaseError> {
        while self.at < now {
            let slice = SLICE_NANOS.min(now - self.at);
            self.decision = self.gate.decide(self.at);
            let input = self.decision.input;
            self.base.watchdog(WATCHDOG_NANOS)?;
            self.base.drive(input, slice)?;
            for (sum, given) in self.given.iter_mut().zip(input) {
                *sum += given * slice as f64;
            }
            self.given_nanos += slice;
            self.witness();
            self.at += slice;
        }
        Ok(())
    }

    /// Drives the base until the end of the period at `now`, and returns its fallback level.
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be driven.
    pub fn end_period(&mut self, now: u64) -> Result<FallbackLevel, BaseError> {
        self.advance(now)?;
        self.past = self.gate.end_period(now);
        Ok(self.past.0)
    }

    /// Input of the motors now \[m/s, m/s, rad/s\].
    fn motor_input(&self) -> Velocity {
        self.base.acting().unwrap_or(self.decision.input)
    }

    /// Records what acts in the slice that begins at `self.at`.
    fn witness(&mut self) {
        let wheels = self.wheels.speeds(self.motor_input());
        let witnessed = &mut self.witnessed;
        for (peak, wheel) in witnessed.wheel_peak.iter_mut().zip(wheels) {
            // This form keeps NaN.
            let within = wheel.is_finite() && wheel.abs() <= *peak;
            *peak = if within { *peak } else { wheel.abs() + 0.0 * *peak };
        }
        let before = std::mem::replace(&mut self.acting, self.decision.acting);
        let Acting { epoch, writer, tick } = self.acting;
        if epoch == 0 {
            return;
        }
        let age = self.at.saturating_sub(tick * self.period_nanos);
        witnessed.acting_age_nanos = witnessed.acting_age_nanos.max(age);
        let other =
            self.acted_last.replace((epoch, writer)).filter(|&last| last != (epoch, writer));
        if let Some(last) = other {
            // A controller that acts after a brake does not take over from another one.
            witnessed.takeovers += u32::from(before.epoch > 0);
            witnessed.takeovers_back += u32::from(epoch < last.0);
        }
    }

    fn write_state(&mut self, tick: u64, sensors: &Sensors) -> PlantState {
        if sensors.pose.iter().chain(&sensors.velocity).any(|value| !value.is_finite()) {
            // A robot without a valid pose stands until an operator resumes it.
            self.gate.stop(Reason::BadState);
        }
        self.gate.set_estop(sensors.estop);
        let mut state: PlantState = bytemuck::Zeroable::zeroed();
        state.stamp.tick = tick;
        state.pose = sensors.pose;
        state.velocity = sensors.velocity;
        state.wheels = self.wheels.count() as u32;
        state.wheel_speed = sensors.wheel_speed.unwrap_or_default();
        state.wheel_speed_valid = u32::from(sensors.wheel_speed.is_some());
        state.current = sensors.current.unwrap_or_default();
        state.current_valid = u32::from(sensors.current.is_some());
        state.input = self.mean_output();
        state.input_delay_s = sensors.input_delay_s;
        state.estop = u32::from(sensors.estop);
        state.gate = self.gate.machine().state().code();
        state.stop = self.gate.machine().stop_reason().code();
        (self.given, self.given_nanos) = ([0.0; 3], 0);
        state.controller_epoch = self.gate.controller_epoch();
        (state.accepted_epoch, state.accepted_tick) = self.gate.accepted().unwrap_or_default();
        state.refused = self.gate.refused();
        state.fallback_level = self.past.0.code();
        state.reason = self.past.1.code();
        state
    }

    /// Mean of the gate's output since the last state; the present output if no time has passed.
    fn mean_output(&self) -> Velocity {
        match self.given_nanos {
            0 => self.decision.input,
            nanos => self.given.map(|sum| sum / nanos as f64),
        }
    }

    fn write_truth(&mut self, tick: u64, now: &TrueState) -> Truth {
        let witnessed = std::mem::take(&mut self.witnessed);
        let Acting { epoch, writer, tick: acting_tick } = self.acting;
        let mut truth: Truth = bytemuck::Zeroable::zeroed();
        truth.stamp.tick = tick;
        truth.pose = now.pose;
        truth.velocity = now.velocity;
        truth.force = now.force;
        truth.wheels = self.wheels.count() as u32;
        truth.wheel_command = self.wheels.speeds(self.motor_input());
        truth.wheel_peak = witnessed.wheel_peak;
        (truth.acting_epoch, truth.acting_writer, truth.acting_tick) = (epoch, writer, acting_tick);
        truth.acting_age_nanos = witnessed.acting_age_nanos;
        (truth.takeovers, truth.takeovers_back) = (witnessed.takeovers, witnessed.takeovers_back);
        truth.fallback_level = self.past.0.code();
        truth.reason = self.past.1.code();
        truth
    }
}
