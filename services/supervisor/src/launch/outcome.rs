//! How a launch ends.

use crate::child::Ending;
use crate::fleet::FleetError;
use runs::folder::FolderError;
use runs::registry::RegistryError;
use settings::SettingsError;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;
use transport::OpenError;

/// Why a graph was not launched, or its run did not end correctly.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// A file contains an invalid value.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The run directory cannot be used.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// Some binaries are not built.
    #[error(
        "{} not found in {}: build with `cargo build --release --workspace --bins`",
        programs.join(", "),
        folder.display()
    )]
    MissingPrograms {
        /// The missing binaries.
        programs: Vec<String>,
        /// Directory where they are expected.
        folder: PathBuf,
    },
    /// The graph cannot be registered on this machine.
    #[error(transparent)]
    Registry(#[from] RegistryError),
    /// The launcher cannot open its own ports.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A host of the graph, on this machine, did not end correctly.
    #[error("host {host} ended with {ending}")]
    Host {
        /// The host.
        host: String,
        /// How its launch ended.
        ending: Ending,
    },
    /// A process failed.
    #[error(transparent)]
    Fleet(#[from] FleetError),
    /// The run was not recorded correctly, or did not end correctly.
    #[error("{}", complaints.join("\n"))]
    Ending {
        /// One sentence per error.
        complaints: Vec<String>,
    },
    /// Error of the operating system.
    #[error("{what}: {source}")]
    System {
        /// The operation that failed.
        what: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The plant has finished.
    Finished,
    /// This signal requested the end.
    Signal(i32),
}

impl Outcome {
    /// 0, or 128 plus the signal's number, as in shells.
    pub fn exit_code(self) -> ExitCode {
        match self {
            Self::Finished => ExitCode::SUCCESS,
            Self::Signal(signal) => {
                ExitCode::from(128_u8.saturating_add(u8::try_from(signal).unwrap_or(0)))
            }
        }
    }
}

impl LaunchError {
    /// 2 if nothing was started because of an invalid setting, else 1.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Self::Settings(_)
            | Self::Folder(FolderError::NotEmpty { .. } | FolderError::NotPrivate(_)) => {
                ExitCode::from(2)
            }
            _ => ExitCode::FAILURE,
        }
    }
}
