//! Deliberate faults in a trial's messages: wrong samples for the learner, and faulty sensors.

use protocol::message::Participant;
use protocol::topic::Topic;
use serde::Serialize;
use transport::{End, Fault, Faults, Kind};

/// Begin and end of a fault with a window \[s\].
const FROM_S: f64 = 10.0;
const UNTIL_S: f64 = 15.0;

/// Largest error of a poisoned residual. It is of the order of the largest that physics allows, so
/// that the size of the residual does not reveal it \[m/s, m/s, rad/s\].
const RESIDUAL_OFF: f64 = 0.5;
/// Largest error of a faulty sensor's velocity \[m/s, m/s, rad/s\].
const VELOCITY_OFF: f64 = 2.0;
/// Index of the sideways axis among the three.
const SIDEWAYS: usize = 1;
/// Share of the messages that a fault without a window affects.
const SELDOM: f64 = 0.1;

/// A deliberate fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Poison {
    /// One in ten samples for the learner has a wrong residual.
    #[value(name = "outliers-10")]
    #[serde(rename = "outliers-10")]
    Outliers10,
    /// Three in ten samples for the learner have a wrong residual.
    #[value(name = "outliers-30")]
    #[serde(rename = "outliers-30")]
    Outliers30,
    /// For 5 s the residuals have the wrong sign.
    SignFlips,
    /// All the time the sideways residuals have the wrong sign, and no others.
    SidewaysFlips,
    /// For 5 s the learner gets the same numbers again and again.
    Stuck,
    /// One in ten samples has a residual that is not a number.
    Nan,
    /// One in ten states for the controller has a wrong velocity.
    SensorOutliers,
    /// For 5 s the controller gets the same pose, velocity and input again and again.
    SensorStuck,
    /// One in ten states for the controller has a velocity that is not a number.
    SensorNan,
}

impl Poison {
    /// The poison as faults on the links, for this seed and control period \[s\].
    pub fn faults(self, seed: u64, period: f64) -> Faults {
        let sensor = matches!(self, Self::SensorOutliers | Self::SensorStuck | Self::SensorNan);
        let (topic, reader, field, off) = if sensor {
            (Topic::State, Participant::Controller, "velocity", VELOCITY_OFF)
        } else {
            (Topic::Residual, Participant::Learner, "residual", RESIDUAL_OFF)
        };
        let (kind, probability) = match self {
            Self::Outliers10 | Self::SensorOutliers => (Kind::Outlier, SELDOM),
            Self::Outliers30 => (Kind::Outlier, 3.0 * SELDOM),
            Self::SignFlips | Self::SidewaysFlips => (Kind::Flip, 1.0),
            Self::Stuck | Self::SensorStuck => (Kind::Freeze, 1.0),
            Self::Nan | Self::SensorNan => (Kind::Nan, SELDOM),
        };
        let for_a_while = matches!(kind, Kind::Flip | Kind::Freeze) && self != Self::SidewaysFlips;
        let tick = |seconds: f64| (seconds / period).round() as u64;
        let fault = Fault {
            topic,
            at: End::Reader,
            participant: Some(reader),
            kind,
            from_tick: if for_a_while { tick(FROM_S) } else { 0 },
            until_tick: for_a_while.then(|| tick(UNTIL_S)),
            probability,
            millis: None,
            messages: None,
            field: (kind != Kind::Freeze).then(|| field.to_owned()),
            number: (self == Self::SidewaysFlips).then_some(SIDEWAYS),
            amount: (kind == Kind::Outlier).then_some(off),
        };
        Faults { seed, process: None, fault: vec![fault] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;
    use transport::ImpossibleFault;

    #[test]
    fn every_poison_is_possible_in_lock_step() -> Result<(), ImpossibleFault> {
        for poison in Poison::value_variants() {
            let faults = poison.faults(1, 0.1);
            faults.check()?;
            faults.check_lock_step()?;
        }
        Ok(())
    }
}
