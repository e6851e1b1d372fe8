//! The controllers that are compared: the same weights, limits and horizon, and what each knows beside them.

use crate::assembly::Assembly;
use clap::ValueEnum;
use controller::settings::{DelaySetting, Identify, Method, Observers};
use learner::settings::KernelChoice;
use model::learned::Layout;
use serde::Serialize;
use std::fmt::{self, Display, Formatter};

/// Largest ℓ of the observer of every contender that has one, where the scenario itself has none.
pub const OBSERVER_GAIN: f64 = 1.0;

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
    /// With Kalman filters of velocity and disturbance, which is a ramp: offset-free, and quicker where
    /// the disturbance changes steadily.
    #[value(name = "mpc+kalman")]
    #[serde(rename = "mpc+kalman")]
    MpcKalman,
    /// With the response that recursive least squares identify, and the observer.
    #[value(name = "rls-mpc+observer")]
    #[serde(rename = "rls-mpc+observer")]
    RlsMpcObserver,
    /// With what physics says beside, friction, drag and the turning frame, found by least squares that
    /// forget, and the observer.
    #[value(name = "physics-mpc+observer")]
    #[serde(rename = "physics-mpc+observer")]
    PhysicsMpcObserver,
    /// The paper's: with a Gaussian process over (v, u), of a squared-exponential kernel, that is
    /// used whatever it foretells. No observer, no dead time.
    #[value(name = "gpr-mpc")]
    #[serde(rename = "gpr-mpc")]
    GprMpc,
    /// Ours: with the identified response and a Gaussian process, whichever foretells better, and the
    /// observer for what remains.
    #[value(name = "gpr-mpc+observer")]
    #[serde(rename = "gpr-mpc+observer")]
    GprMpcObserver,
    /// The bound: the plant's own dynamics as model, in the present world, and the observer for what chance does.
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

    /// Whether it is a bound, and nothing that could drive a robot.
    pub fn is_bound(self) -> bool {
        self == Self::OracleMpc
    }

    /// Whether an earlier run leaves it something to begin with.
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

    /// Makes `assembly` the contender's.
    pub fn take_over(self, assembly: &mut Assembly) {
        let mpc = &mut assembly.scenario.mpc;
        mpc.method = match self {
            Self::FeedforwardP => Method::FeedforwardP,
            Self::OracleMpc => Method::Oracle,
            _ => Method::Mpc,
        };
        mpc.observer_gain = match self {
            Self::FeedforwardP | Self::Mpc | Self::GprMpc => 0.0,
            // The scenario's, the same for all that have an observer.
            _ if mpc.observer_gain > 0.0 => mpc.observer_gain,
            _ => OBSERVER_GAIN,
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
        // The same dead time is found and made up for by all that predict; the oracle knows it.
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
