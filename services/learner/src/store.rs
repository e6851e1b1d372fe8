//! Saves the last snapshot to a file and resumes from it. The file holds the message as it was
//! sent, checksum included.

use crate::fit::FitSettings;
use crate::settings::Settings;
use model::AXES;
use model::gp::dictionary::{Dictionary, Observation};
use model::gp::hyperparameters::Hyperparameters;
use process::atomic_file;
use protocol::frame::{self, DecodeError};
use protocol::message::{Message, ModelSnapshot};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A snapshot file that cannot be written or resumed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file system reported an error.
    #[error("{file}: {source}")]
    File {
        /// The file.
        file: PathBuf,
        /// The error.
        source: io::Error,
    },
    /// The file is damaged, or is not a snapshot.
    #[error("{file}: {source}")]
    Damaged {
        /// The file.
        file: PathBuf,
        /// The error of the decoder.
        source: DecodeError,
    },
    /// It was learnt with another main model.
    #[error(
        "{file}: fingerprint = {got:#018x}: expected {expected:#018x}; \
         the file was learnt for another robot, period or input layout"
    )]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Fingerprint of this run.
        expected: u64,
        /// Fingerprint of the file.
        got: u64,
    },
}

/// File of this run's last snapshot.
pub fn file_of(settings: &Settings) -> PathBuf {
    settings.run.folder.join("snapshot.bin")
}

/// The snapshot to begin with: that of this run after a restart, else the one in the settings.
pub fn to_resume_from(settings: &Settings, fingerprint: u64) -> Option<ModelSnapshot> {
    let own = Some(file_of(settings)).filter(|file| settings.run.restarted && file.exists());
    let file = own.or_else(|| settings.learner.resume.clone())?;
    match load(&file, fingerprint) {
        Ok(snapshot) => {
            tracing::info!(
                file = %file.display(),
                version = snapshot.head.version,
                points = snapshot.head.points,
                "resumed"
            );
            Some(snapshot)
        }
        Err(error) => {
            tracing::warn!("{error}; starting without data");
            None
        }
    }
}

/// Writes `snapshot` to `file` atomically.
///
/// # Errors
/// [`StoreError::File`].
pub fn save(file: &Path, snapshot: &ModelSnapshot) -> Result<(), StoreError> {
    let mut bytes = vec![0; snapshot.byte_len()];
    frame::encode(snapshot, &mut bytes);
    atomic_file::write(file, &bytes)
        .map_err(|source| StoreError::File { file: file.to_owned(), source })
}

/// Reads the snapshot from `file`.
///
/// # Errors
/// [`StoreError`] if it cannot be read, is damaged, or belongs to another main model.
pub fn load(file: &Path, fingerprint: u64) -> Result<ModelSnapshot, StoreError> {
    let bytes =
        fs::read(file).map_err(|source| StoreError::File { file: file.to_owned(), source })?;
    let snapshot: ModelSnapshot = frame::decode(&bytes)
        .map_err(|source| StoreError::Damaged { file: file.to_owned(), source })?;
    if snapshot.head.fingerprint != fingerprint {
        return Err(StoreError::Foreign {
            file: file.to_owned(),
            expected: fingerprint,
            got: snapshot.head.fingerprint,
        });
    }
    Ok(snapshot)
}

/// Puts the data of a snapshot back into `dictionary`, and returns the hyperparameters for the next
/// fit. They are those of the snapshot if it has the kernel and the units of `fit_settings`, and if
/// they are possible.
pub fn resume<const D: usize>(
    snapshot: &ModelSnapshot,
    fit_settings: &FitSettings<D>,
    dictionary: &mut Dictionary<D>,
) -> [Hyperparameters<D>; AXES] {
    let head = &snapshot.head;
    let entry = |values: &[f64], i: usize| values.get(i).copied().unwrap_or(f64::NAN);
    for row in snapshot.rows() {
        let input = std::array::from_fn(|i| {
            entry(&head.input_mean, i) + entry(&head.input_scale, i) * entry(row.input, i)
        });
        dictionary.restore(
            Observation { input, target: std::array::from_fn(|axis| entry(row.target, axis)) },
            row.noise_scale,
        );
    }
    let first = fit_settings.hyperparameters();
    let scale: [f64; D] = std::array::from_fn(|i| entry(&head.input_scale, i));
    if scale.map(f64::to_bits) != fit_settings.input_scale.map(f64::to_bits) {
        return first;
    }
    std::array::from_fn(|axis| {
        let length_scale = std::array::from_fn(|i| entry(&head.length_scale[axis], i));
        let plain = Hyperparameters::new(
            length_scale,
            head.signal_variance[axis],
            head.noise_variance[axis],
        );
        // Whether there is a linear or place part depends on the present settings, not on the
        // earlier ones.
        let of_part = |asked: f64, kept: f64| if asked > 0.0 && kept > 0.0 { kept } else { asked };
        let asked = &first[axis].kernel;
        let kept = plain
            .with_linear(of_part(asked.linear_variance, head.linear_variance[axis]))
            .with_place(of_part(asked.place_variance, head.place_variance[axis]));
        // No fit can begin at hyperparameters that are not positive and finite.
        if kept.check().is_ok() { kept } else { first[axis] }
    })
}
