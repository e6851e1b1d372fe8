//! Log → periods: what acted in each, what followed, and the residual, with the controller's own
//! code.
//!
//! The controller identifies the dead time while it drives, and here while it reads. So the first
//! seconds of a log have the dead time of the robot file.

use controller::Settings;
use controller::knowledge::{self, Knowledge};
use identify::log::{Log, Stretch};
use model::main_model::MainModel;
use model::{State, Velocity};
use protocol::message::ResidualSample;

/// One period of a log.
#[derive(Debug, Clone, Copy)]
pub struct Period {
    /// The robot at its start.
    pub state: State,
    /// Input that acted in it \[m/s, m/s, rad/s\].
    pub acted: Velocity,
    /// Measured velocity at its end \[m/s, m/s, rad/s\].
    pub after: Velocity,
    /// Dead time in whole periods.
    pub under_way: usize,
    /// The sample for the learner.
    pub sample: ResidualSample,
}

/// Periods without a gap.
pub type Passage = Vec<Period>;

/// The passages of `log`, for the robot and the period of `settings`.
pub fn passages(log: &Log, settings: &Settings) -> Vec<Passage> {
    let main = MainModel::new(&settings.robot, settings.run.period_nanos as f64 * 1e-9);
    let mut knowledge = Knowledge::new(settings, main, None);
    log.stretches.iter().map(|stretch| passage(stretch, &mut knowledge)).collect()
}

fn passage(stretch: &Stretch, knowledge: &mut Knowledge) -> Passage {
    let mut passage = Vec::with_capacity(stretch.len());
    let mut before: Option<State> = None;
    for (sample, tick) in stretch.iter().zip(0..) {
        let after = knowledge.measured(sample.pose, sample.velocity, sample.wheel_speed.as_ref());
        match before {
            None => knowledge.resume(&after, sample.input),
            Some(before) => {
                let given = sample.input;
                knowledge.observe(&knowledge::Period { tick, before, given, after });
                passage.push(period(&before, tick, knowledge));
            }
        }
        knowledge.settle_delay();
        before = Some(knowledge.state());
    }
    passage
}

/// The period that `knowledge` has just processed.
fn period(before: &State, tick: u64, knowledge: &Knowledge) -> Period {
    let mut sample: ResidualSample = bytemuck::Zeroable::zeroed();
    sample.stamp.tick = tick;
    sample.usable = 1;
    knowledge.write_sample(before, &mut sample);
    let State { velocity: after, acted, .. } = knowledge.state();
    Period { state: *before, acted, after, under_way: knowledge.delay().whole(), sample }
}
