//! One simulated robot behind its gate: what a driver does, with a simulated world in place of motors and sensors.

use crate::settings::Settings;
use crate::truth::World;
use gate::{Acting, Bounds, Decision, Gate};
use model::robot::{Geometry, kinematics};
use protocol::message::{Command, PlantState, Reason, Rung, Truth};

/// Longest time that the world runs without asking the gate: the grain of the braking ramp \[ns\].
pub const SLICE_NANOS: u64 = 2_000_000;

/// World and gate of one plant epoch. All times are nanoseconds since its start.
pub struct Robot {
    world: World,
    gate: Gate,
    geometry: Geometry,
    decision: Decision,
    /// Rung and reason of the past period.
    past: (Rung, Reason),
    /// How far the world has run.
    at: u64,
    period_nanos: u64,
    witnessed: Witnessed,
    /// Who acted in the last slice.
    acting: Acting,
    /// Controller that acted last, of whatever did since; none before the first.
    acted_last: Option<(u64, u64)>,
}

/// What the wheels got in the past period, for the truth.
#[derive(Debug, Clone, Copy, Default)]
struct Witnessed {
    wheel_peak: [f64; 4],
    acting_age_nanos: u64,
    takeovers: u32,
    takeovers_back: u32,
}

impl Robot {
    /// A robot at the scenario's start.
    pub fn new(settings: &Settings, epoch: u64) -> Self {
        let bounds = Bounds::new(&settings.robot, settings.run.period_nanos, settings.link_delay_millis * 1_000_000);
        let mut gate = Gate::new(bounds, epoch);
        let decision = gate.decide(0);
        Self {
            world: World::new(&settings.truth, settings.start, settings.seed),
            gate,
            geometry: settings.robot.geometry,
            decision,
            past: (Rung::Waiting, Reason::NoCommandYet),
            at: 0,
            period_nanos: settings.run.period_nanos,
            witnessed: Witnessed::default(),
            acting: Acting::default(),
            acted_last: None,
        }
    }

    /// Measures, and begins the period of `tick` at `now`.
    pub fn begin_period(&mut self, tick: u64, now: u64) -> (PlantState, Truth) {
        self.gate.begin_period(tick, now);
        (self.measure(tick), self.tell_truth(tick))
    }

    /// Offers a command that came at `now` to the gate.
    pub fn offer(&mut self, command: &Command, now: u64) -> Result<(), Reason> {
        self.advance(now);
        let verdict = self.gate.offer(command, now);
        self.decision = self.gate.decide(now);
        verdict
    }

    /// Counts messages that were not even commands.
    pub fn refuse_malformed(&mut self) {
        self.gate.refuse(Reason::Malformed);
    }

    /// Lets the world run until `now`, the gate deciding anew every [`SLICE_NANOS`].
    pub fn advance(&mut self, now: u64) {
        while self.at < now {
            let slice = SLICE_NANOS.min(now - self.at);
            self.decision = self.gate.decide(self.at);
            self.world.advance(slice, self.decision.input);
            self.witness();
            self.at += slice;
        }
    }

    /// Notes what acts in the slice that begins at `self.at`.
    fn witness(&mut self) {
        let witnessed = &mut self.witnessed;
        for (peak, wheel) in witnessed.wheel_peak.iter_mut().zip(kinematics::wheels_from_body(&self.geometry, self.world.input_applied())) {
            // Written so that NaN stays.
            *peak = if wheel.is_finite() && wheel.abs() <= *peak { *peak } else { wheel.abs() + 0.0 * *peak };
        }
        let before = std::mem::replace(&mut self.acting, self.decision.acting);
        let Acting { epoch, writer, tick } = self.acting;
        if epoch == 0 {
            return;
        }
        witnessed.acting_age_nanos = witnessed.acting_age_nanos.max(self.at.saturating_sub(tick * self.period_nanos));
        if let Some(last) = self.acted_last.replace((epoch, writer)).filter(|&last| last != (epoch, writer)) {
            // Who drives after a brake takes over from nobody.
            witnessed.takeovers += u32::from(before.epoch > 0);
            witnessed.takeovers_back += u32::from(epoch < last.0);
        }
    }

    /// Lets the world run until the end of the period at `now`, and says on which rung it was.
    pub fn end_period(&mut self, now: u64) -> Rung {
        self.advance(now);
        self.past = self.gate.end_period(now);
        self.past.0
    }

    fn measure(&mut self, tick: u64) -> PlantState {
        let measured = self.world.measure();
        if measured.pose.iter().chain(&measured.velocity).any(|value| !value.is_finite()) {
            self.gate.latch(); // a robot that does not know where it is stands until a person looks after it
        }
        let mut state: PlantState = bytemuck::Zeroable::zeroed();
        state.stamp.tick = tick;
        state.pose = measured.pose;
        state.velocity = measured.velocity;
        state.wheel_speed = measured.wheel_speed;
        state.current = measured.current;
        state.input = self.world.take_mean_input();
        state.controller_epoch = self.gate.controller_epoch();
        (state.accepted_epoch, state.accepted_tick) = self.gate.accepted().unwrap_or_default();
        state.refused = self.gate.refused();
        state.rung = self.past.0.code();
        state.reason = self.past.1.code();
        state
    }

    fn tell_truth(&mut self, tick: u64) -> Truth {
        let witnessed = std::mem::take(&mut self.witnessed);
        let now = self.world.state();
        let Acting { epoch, writer, tick: acting_tick } = self.acting;
        let mut truth: Truth = bytemuck::Zeroable::zeroed();
        truth.stamp.tick = tick;
        truth.pose = now.pose;
        truth.velocity = now.velocity;
        truth.force = now.force;
        truth.wheel_command = kinematics::wheels_from_body(&self.geometry, self.world.input_applied());
        (truth.acting_epoch, truth.acting_writer, truth.acting_tick) = (epoch, writer, acting_tick);
        truth.wheel_peak = witnessed.wheel_peak;
        truth.acting_age_nanos = witnessed.acting_age_nanos;
        (truth.takeovers, truth.takeovers_back) = (witnessed.takeovers, witnessed.takeovers_back);
        truth.rung = self.past.0.code();
        truth.reason = self.past.1.code();
        truth
    }
}
