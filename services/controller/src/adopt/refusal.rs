//! The reasons why a snapshot is refused: one variant per cause, with its numbers.

use super::examine::POINTS_MAX;
use model::gp::posterior::PosteriorError;

/// A snapshot is refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// It was learned for another robot, period or layout.
    #[error(
        "snapshot {version} has fingerprint {got:#018x}, this controller {expected:#018x}: another \
         robot, period or input layout"
    )]
    Fingerprint {
        /// Version of the snapshot.
        version: u64,
        /// Fingerprint of this controller.
        expected: u64,
        /// Fingerprint of the snapshot.
        got: u64,
    },
    /// Another number of inputs.
    #[error("snapshot {version} has {got} inputs, this controller {expected}")]
    Inputs {
        /// Version of the snapshot.
        version: u64,
        /// Number of inputs of this controller.
        expected: usize,
        /// Number of inputs of the snapshot.
        got: u32,
    },
    /// Older than a snapshot that is already prepared.
    #[error(
        "snapshot {version} of learner epoch {epoch} is older than snapshot {newest} of epoch \
         {newest_epoch}, which is in use"
    )]
    Stale {
        /// Version of the snapshot.
        version: u64,
        /// Epoch of its learner.
        epoch: u64,
        /// Version of the newest one.
        newest: u64,
        /// Epoch of the newest one's learner.
        newest_epoch: u64,
    },
    /// Its number of points differs from its head.
    #[error("snapshot {version} declares {promised} points, but has {got}")]
    Size {
        /// Version of the snapshot.
        version: u64,
        /// Number of points in its head.
        promised: u32,
        /// Its number of points.
        got: usize,
    },
    /// A number is NaN or infinite.
    #[error("snapshot {version}: {field} contains a number that is not finite")]
    NotFinite {
        /// Version of the snapshot.
        version: u64,
        /// The field.
        field: &'static str,
    },
    /// A hyperparameter is impossible for any robot's residual.
    #[error(
        "snapshot {version}, axis {axis}: {name} is {value:.3e}, expected {least:.0e} to {most:.0e}"
    )]
    Hyperparameter {
        /// Version of the snapshot.
        version: u64,
        /// 0 forward, 1 left, 2 yaw.
        axis: usize,
        /// Name of the hyperparameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Smallest possible value.
        least: f64,
        /// Largest possible value.
        most: f64,
    },
    /// More points than can be factorised and evaluated in a period.
    #[error("snapshot {version} has {got} points, this controller takes {POINTS_MAX} at most")]
    Points {
        /// Version of the snapshot.
        version: u64,
        /// Its number of points.
        got: u32,
    },
    /// The normalisation has an impossible input scale.
    #[error("snapshot {version} has an impossible normalisation")]
    Normalisation {
        /// Version of the snapshot.
        version: u64,
    },
    /// Its data give no posterior.
    #[error("snapshot {version}: {source}")]
    Posterior {
        /// Version of the snapshot.
        version: u64,
        /// The cause.
        source: PosteriorError,
    },
    /// Its covariance is positive definite only with more on its diagonal than its noise.
    #[error(
        "snapshot {version}, axis {axis}: its covariance is positive definite with {jitter:.1e} \
         more on its diagonal only"
    )]
    Indefinite {
        /// Version of the snapshot.
        version: u64,
        /// 0 forward, 1 left, 2 yaw.
        axis: usize,
        /// The value that had to be added.
        jitter: f64,
    },
    /// Its α does not follow from its data.
    #[error(
        "snapshot {version}: its weights differ from those of its data by {difference:.1e} of the \
         largest"
    )]
    Weights {
        /// Version of the snapshot.
        version: u64,
        /// Largest relative difference.
        difference: f64,
    },
}
