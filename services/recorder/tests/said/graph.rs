//! A plant, a controller and a learner that only publish: every recorded topic, on one thread.

use bytemuck::Zeroable;
use protocol::message::{
    Command, FallbackLevel, Health, ModelSnapshot, Participant, Plan, PlantState, ResidualSample,
    SnapshotHead, SolverStatus, Stamp, Truth,
};
use transport::{OpenError, Ports, SendError, Sink};

/// Number of ticks between two snapshots.
pub(crate) const SNAPSHOT_TICKS: u64 = 25;

/// Horizon of the plans \[periods\].
pub(crate) const HORIZON: u32 = 5;

/// Writers of all topics.
pub(crate) struct Graph {
    states: Sink<PlantState>,
    truths: Sink<Truth>,
    commands: Sink<Command>,
    plans: Sink<Plan>,
    residuals: Sink<ResidualSample>,
    snapshots: Sink<ModelSnapshot>,
    healths: Sink<Health>,
}

impl Graph {
    /// Opens the writers.
    pub(crate) fn open(ports: &Ports) -> Result<Self, OpenError> {
        Ok(Self {
            states: ports.sink()?,
            truths: ports.sink()?,
            commands: ports.sink()?,
            plans: ports.sink()?,
            residuals: ports.sink()?,
            snapshots: ports.sink()?,
            healths: ports.sink()?,
        })
    }

    /// Publishes the messages of one tick. The robot is 0.5 m off up to tick 20, and exactly on the
    /// reference from then on.
    pub(crate) fn tick(&mut self, tick: u64) -> Result<(), SendError> {
        self.states.send(&mut state(tick))?;
        self.truths.send(&mut truth(tick))?;
        self.commands.send(&mut command(tick))?;
        self.plans.send(&mut plan(tick))?;
        self.residuals.send(&mut ResidualSample {
            stamp: at(tick),
            plant_epoch: 1,
            usable: 1,
            ..Zeroable::zeroed()
        })?;
        if tick.is_multiple_of(SNAPSHOT_TICKS) {
            self.snapshots.send(&mut snapshot(tick))?;
        }
        if tick.is_multiple_of(10) {
            self.healths.send(&mut health(tick))?;
        }
        Ok(())
    }
}

fn at(tick: u64) -> Stamp {
    Stamp { tick, ..Stamp::default() }
}

/// State of the plant.
pub(crate) fn state(tick: u64) -> PlantState {
    let (accepted_epoch, fallback_level) =
        if tick == 0 { (0, FallbackLevel::Waiting) } else { (1, FallbackLevel::FreshPlan) };
    PlantState {
        stamp: at(tick),
        pose: [tick as f64 * 0.27, 0.1, 0.2],
        accepted_epoch,
        fallback_level: fallback_level.code(),
        ..Zeroable::zeroed()
    }
}

/// True state.
pub(crate) fn truth(tick: u64) -> Truth {
    let error = if tick < 20 { 0.5 } else { 0.0 };
    let pose = [tick as f64 * 0.27, error, 0.0];
    Truth {
        stamp: at(tick),
        pose,
        velocity: [2.7, 0.0, 0.0],
        fallback_level: FallbackLevel::FreshPlan.code(),
        ..Zeroable::zeroed()
    }
}

/// Command of the controller.
pub(crate) fn command(tick: u64) -> Command {
    Command {
        stamp: at(tick),
        plant_epoch: 1,
        tail_len: 2,
        fallback_level: FallbackLevel::FreshPlan.code(),
        ..Zeroable::zeroed()
    }
}

/// Plan of the controller.
pub(crate) fn plan(tick: u64) -> Plan {
    let mut plan: Plan = Zeroable::zeroed();
    plan.stamp = at(tick);
    plan.plant_epoch = 1;
    plan.horizon = HORIZON;
    plan.status = SolverStatus::Solved.code();
    plan.fallback_level = FallbackLevel::FreshPlan.code();
    plan.tick_nanos = 150_000;
    for (row, reference) in plan.reference.iter_mut().enumerate() {
        *reference = [(tick + row as u64) as f64 * 0.27, 0.0, 0.0, 2.7, 0.0, 0.0];
    }
    for (row, predicted) in plan.predicted.iter_mut().enumerate() {
        *predicted = [row as f64 / 3.0, 1.0 / 7.0, 0.0, 2.7 / 1.1, 0.0, -1e-9];
    }
    plan
}

/// Snapshot of the learner: two inputs, three data points.
pub(crate) fn snapshot(tick: u64) -> ModelSnapshot {
    let mut snapshot = ModelSnapshot::new(SnapshotHead {
        stamp: at(tick),
        version: tick / SNAPSHOT_TICKS + 1,
        inputs: 2,
        ..Zeroable::zeroed()
    });
    for point in 0..3 {
        let added = snapshot.push(&[f64::from(point), 0.5], [0.1, 0.2, 0.3], [1.0, 2.0, 3.0]);
        assert!(added.is_ok());
    }
    snapshot
}

/// Health of the controller: it has lost one state for each ten ticks.
pub(crate) fn health(tick: u64) -> Health {
    let mut health: Health = Zeroable::zeroed();
    health.stamp = at(tick);
    health.participant = Participant::Controller.code();
    health.snapshots = tick / SNAPSHOT_TICKS + 1;
    let [received, ..] = &mut health.received;
    *received = tick;
    let [lost, ..] = &mut health.lost;
    *lost = tick / 10;
    health.set_last_error("a state was late");
    health
}
