//! The controllers that are compared. They share weights, limits and horizon, and differ in their
//! model.

use clap::ValueEnum;
use controller::settings::{DelaySetting, Identify, Method, Observers};
use graph::assembly::Assembly;
use learner::settings::KernelChoice;
use model::learned::Layout;
use serde::Serialize;
use std::fmt::{self, Display, Formatter};

/// A controller in a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize)]
pub enum Contender {
    /// The input that holds the reference, and a proportional feedback of the pose.
    #[value(name = "feedforward-p")]
    #[serde(rename = "feedforward-p")]
    FeedforwardP,
    /// The main model alone.
    #[value(name = "mpc")]
    #[serde(rename = "mpc")]
    Mpc,
    /// With a disturbance observer: offset-free.
    #[value(name = "mpc+observer")]
    #[serde(rename = "mpc+observer")]
    MpcObserver,
    /// With Kalman filters of velocity and disturbance, where the disturbance is a ramp.
    /// Offset-free, and faster if the disturbance changes steadily.
    #[value(name = "mpc+kalman")]
    #[serde(rename = "mpc+kalman")]
    MpcKalman,
    /// With the response that recursive least squares identify, and the observer.
    #[value(name = "rls-mpc+observer")]
    #[serde(rename = "rls-mpc+observer")]
    RlsMpcObserver,
    /// With further physical terms (friction, drag and the turning frame) from least squares with
    /// forgetting, and the observer.
    #[value(name = "physics-mpc+observer")]
    #[serde(rename = "physics-mpc+observer")]
    PhysicsMpcObserver,
    /// The paper's controller: with a Gaussian process over (v, u) with a squared-exponential
    /// kernel, which is used independent of its prediction error. No observer, no dead time.
    #[value(name = "gpr-mpc")]
    #[serde(rename = "gpr-mpc")]
    GprMpc,
    /// This project's controller: with the identified response or a Gaussian process, whichever
    /// predicts better, and the observer for the rest.
    #[value(name = "gpr-mpc+observer")]
    #[serde(rename = "gpr-mpc+observer")]
    GprMpcObserver,
    /// The bound: the plant's own dynamics in the present world as model, and the observer for
    /// random disturbances.
    #[value(name = "oracle-mpc")]
    #[serde(rename = "oracle-mpc")]
    OracleMpc,
}

impl Contender {
    /// All of them, the simplest first.
    pub const ALL: [Self; 9] = [
        Self::FeedforwardP,
        Self::Mpc,
        Self::MpcObserver,
        Self::MpcKalman,
        Self::RlsMpcObserver,
        Self::PhysicsMpcObserver,
        Self::GprMpc,
        Self::GprMpcObserver,
        Self::OracleMpc,
    ];

    /// Whether it is a bound, which could not drive a real robot.
    pub fn is_bound(self) -> bool {
        self == Self::OracleMpc
    }

    /// Whether it can start from the results of an earlier run.
    pub fn remembers(self) -> bool {
        self.learns() || self.identifies()
    }

    /// Whether it identifies the response while it drives.
    pub fn identifies(self) -> bool {
        matches!(self, Self::RlsMpcObserver | Self::PhysicsMpcObserver | Self::GprMpcObserver)
    }

    /// Whether it has a learner.
    pub fn learns(self) -> bool {
        matches!(self, Self::GprMpc | Self::GprMpcObserver)
    }

    /// Configures `assembly` for the contender.
    pub fn take_over(self, assembly: &mut Assembly) {
        let mpc = &mut assembly.scenario.mpc;
        mpc.method = match self {
            Self::FeedforwardP => Method::FeedforwardP,
            Self::OracleMpc => Method::Oracle,
            _ => Method::Mpc,
        };
        mpc.observer_gain = match self {
            Self::FeedforwardP | Self::Mpc | Self::GprMpc => 0.0,
            _ => mpc.offset_free_gain(),
        };
        mpc.observers = match self {
            Self::MpcKalman => Observers::Kalman,
            Self::MpcObserver => Observers::Gains,
            _ => mpc.observers,
        };
        mpc.identify = match self {
            Self::RlsMpcObserver | Self::GprMpcObserver => Identify::Response,
            Self::PhysicsMpcObserver => Identify::Physics,
            _ => Identify::Off,
        };
        // All predicting contenders estimate and compensate the same dead time; the oracle knows
        // it.
        mpc.delay = match self {
            Self::OracleMpc => {
                let truth = assembly.scenario.truth.as_ref();
                DelaySetting::KnownS(truth.map_or(0.0, |truth| truth.command_delay_s))
            }
            Self::FeedforwardP | Self::GprMpc => DelaySetting::Ignored,
            _ => DelaySetting::Estimated,
        };
        if self == Self::GprMpc {
            mpc.no_harm = false;
            let learner = &mut assembly.scenario.learner;
            learner.layout = Layout::VelocityInput;
            learner.kernel = KernelChoice::SquaredExponential;
        }
        assembly.graph.processes.learner.enabled = self.learns();
    }
}

impl Display for Contender {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FeedforwardP => "feedforward-p",
            Self::Mpc => "mpc",
            Self::MpcObserver => "mpc+observer",
            Self::MpcKalman => "mpc+kalman",
            Self::RlsMpcObserver => "rls-mpc+observer",
            Self::PhysicsMpcObserver => "physics-mpc+observer",
            Self::GprMpc => "gpr-mpc",
            Self::GprMpcObserver => "gpr-mpc+observer",
            Self::OracleMpc => "oracle-mpc",
        })
    }
}
