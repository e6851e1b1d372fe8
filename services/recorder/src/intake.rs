//! All topics → the record.

use crate::grant::Grant;
use crate::run::RecorderError;
use crate::segment::RecordError;
use crate::store::Store;
use crate::visual::Easel;
use process::Pulse;
use protocol::message::{
    Command, Goal, Health, ModelSnapshot, Obstacles, Participant, Phase, Plan, PlantState,
    ResidualSample, Truth,
};
use protocol::topic::{OnTopic, Topic};
use transport::{OpenError, Ports, Since, Source};

/// A reader for each recorded topic.
pub(crate) struct Intake {
    /// The recorder sleeps on this topic: the others are published around each state.
    pub(crate) states: Source<PlantState>,
    truths: Source<Truth>,
    plans: Source<Plan>,
    commands: Source<Command>,
    residuals: Source<ResidualSample>,
    snapshots: Source<ModelSnapshot>,
    healths: Source<Health>,
    goals: Source<Goal>,
    obstacles: Source<Obstacles>,
    easel: Easel,
}

impl Intake {
    /// Opens all readers, for a robot with this control period \[ns\].
    ///
    /// # Errors
    /// [`OpenError`].
    pub(crate) fn open(ports: &Ports, since: Since, period_nanos: u64) -> Result<Self, OpenError> {
        Ok(Self {
            states: ports.source(since)?,
            truths: ports.source(since)?,
            plans: ports.source(since)?,
            commands: ports.source(since)?,
            residuals: ports.source(since)?,
            snapshots: ports.source(since)?,
            healths: ports.source(since)?,
            goals: ports.source(since)?,
            obstacles: ports.source(since)?,
            easel: Easel::new(period_nanos),
        })
    }

    /// Writes the waiting messages, and notes the tick of the plant. Returns the number of messages
    /// written.
    ///
    /// # Errors
    /// [`RecorderError`] if a topic cannot be read or the file cannot be written.
    pub(crate) fn drain(
        &mut self,
        store: &mut Store,
        grant: &mut Grant,
    ) -> Result<usize, RecorderError> {
        let mut written = drain(&mut self.healths, store, |health, _| {
            // A plant that starts has no state yet, but its clock needs credit.
            if health.participant() == Some(Participant::Plant) && health.phase() != Phase::Finished
            {
                grant.note_health(health.stamp.epoch, health.stamp.tick);
            }
            Ok(())
        })?;
        let easel = &mut self.easel;
        written += drain(&mut self.states, store, |state, store| {
            grant.note_state(state.stamp.epoch, state.stamp.tick);
            store.draw(&easel.draw_state(state), state.stamp.sent_nanos)
        })?;
        written += drain(&mut self.truths, store, |_, _| Ok(()))?;
        written += drain(&mut self.commands, store, |_, _| Ok(()))?;
        written += drain(&mut self.plans, store, |plan, store| {
            store.draw(&easel.draw_plan(plan), plan.stamp.sent_nanos)
        })?;
        written += drain(&mut self.residuals, store, |_, _| Ok(()))?;
        written += drain(&mut self.snapshots, store, |_, _| Ok(()))?;
        written += drain(&mut self.goals, store, |_, _| Ok(()))?;
        written += drain(&mut self.obstacles, store, |_, _| Ok(()))?;
        Ok(written)
    }

    /// Reports the counters of each topic.
    pub(crate) fn count(&self, pulse: &mut Pulse) {
        pulse.count_source(Topic::State, self.states.tally());
        pulse.count_source(Topic::Truth, self.truths.tally());
        pulse.count_source(Topic::Plan, self.plans.tally());
        pulse.count_source(Topic::Command, self.commands.tally());
        pulse.count_source(Topic::Residual, self.residuals.tally());
        pulse.count_source(Topic::Snapshot, self.snapshots.tally());
        pulse.count_source(Topic::Health, self.healths.tally());
        pulse.count_source(Topic::Goal, self.goals.tally());
        pulse.count_source(Topic::Obstacles, self.obstacles.tally());
    }
}

/// Writes the waiting messages of one topic, and calls `more` with each. It writes at most as many
/// as a queue holds, so that a busy topic does not starve the others.
fn drain<T: OnTopic>(
    source: &mut Source<T>,
    store: &mut Store,
    mut more: impl FnMut(&T, &mut Store) -> Result<(), RecordError>,
) -> Result<usize, RecorderError> {
    let most = <T as OnTopic>::TOPIC.quality(false).depth;
    for written in 0..most {
        let Some(message) = source.next()? else { return Ok(written) };
        store.write(&message)?;
        more(&message, store)?;
    }
    Ok(most)
}
