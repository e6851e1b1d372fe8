//! Why a snapshot is not used: every cause by its own name, with its numbers.

use super::examine::POINTS_MAX;
use model::gp::posterior::PosteriorError;

/// Why a snapshot is not used.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// It was learnt for another robot, period or layout.
    #[error(
        "snapshot {version} has fingerprint {got:#018x}, this controller {expected:#018x}: another robot, period or input layout"
    )]
    Fingerprint {
        /// Of the snapshot.
        version: u64,
        /// Ours.
        expected: u64,
        /// Its own.
        got: u64,
    },
    /// Another number of inputs.
    #[error("snapshot {version} has {got} inputs, this controller {expected}")]
    Inputs {
        /// Of the snapshot.
        version: u64,
        /// How many this controller's have.
        expected: usize,
        /// How many it has.
        got: u32,
    },
    /// Older than one that has been prepared already.
    #[error(
        "snapshot {version} of learner epoch {epoch} is older than snapshot {newest} of epoch {newest_epoch}, which is in use"
    )]
    Stale {
        /// Of the snapshot.
        version: u64,
        /// Of its learner.
        epoch: u64,
        /// Version of the newest one.
        newest: u64,
        /// Epoch of the newest one's learner.
        newest_epoch: u64,
    },
    /// Another number of points than it promises.
    #[error("snapshot {version} promises {promised} points, but has {got}")]
    Size {
        /// Of the snapshot.
        version: u64,
        /// How many its head says.
        promised: u32,
        /// How many it has.
        got: usize,
    },
    /// A number is NaN or infinite.
    #[error("snapshot {version}: {field} holds what is not a finite number")]
    NotFinite {
        /// Of the snapshot.
        version: u64,
        /// Where.
        field: &'static str,
    },
    /// A hyperparameter that no robot's residual can have.
    #[error(
        "snapshot {version}, axis {axis}: {name} is {value:.3e}, expected {least:.0e} to {most:.0e}"
    )]
    Hyperparameter {
        /// Of the snapshot.
        version: u64,
        /// 0 forward, 1 left, 2 yaw.
        axis: usize,
        /// Which one.
        name: &'static str,
        /// What it is.
        value: f64,
        /// Smallest that is possible.
        least: f64,
        /// Largest that is possible.
        most: f64,
    },
    /// More points than can be factorised and asked in a period.
    #[error("snapshot {version} has {got} points, this controller takes {POINTS_MAX} at most")]
    Points {
        /// Of the snapshot.
        version: u64,
        /// How many it has.
        got: u32,
    },
    /// No input is of the size that its normalisation says.
    #[error("snapshot {version} has an impossible normalisation")]
    Normalisation {
        /// Of the snapshot.
        version: u64,
    },
    /// Its data give no posterior.
    #[error("snapshot {version}: {source}")]
    Posterior {
        /// Of the snapshot.
        version: u64,
        /// What is wrong with them.
        source: PosteriorError,
    },
    /// Its covariance is not positive definite but with more on its diagonal than its noise.
    #[error(
        "snapshot {version}, axis {axis}: its covariance is positive definite with {jitter:.1e} more on its diagonal only"
    )]
    Indefinite {
        /// Of the snapshot.
        version: u64,
        /// 0 forward, 1 left, 2 yaw.
        axis: usize,
        /// What had to be added.
        jitter: f64,
    },
    /// Its α is not what its data give.
    #[error(
        "snapshot {version}: its weights differ from those of its data by {difference:.1e} of the largest"
    )]
    Weights {
        /// Of the snapshot.
        version: u64,
        /// Largest relative difference.
        difference: f64,
    },
}
