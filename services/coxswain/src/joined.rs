//! A launch that runs on this machine, as its operator sees it: its messages, over shared memory.

use crate::set::{SetError, launch};
use process::Run;
use protocol::message::Participant;
use protocol::topic::OnTopic;
use runs::registry::GraphEntry;
use serde::Deserialize;
use std::fs;
use std::path::{Path, PathBuf};
use supervisor::fleet::settings_file;
use transport::{Identity, OpenError, Ports, ReceiveError, Source};

/// A launch cannot be joined.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// There is none, or more than one.
    #[error(transparent)]
    Launch(#[from] SetError),
    /// The settings of its processes cannot be read.
    #[error("{}: {reason}", file.display())]
    Settings {
        /// The file.
        file: PathBuf,
        /// The cause.
        reason: String,
    },
    /// Its links cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// Its messages cannot be received.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// It has ended.
    #[error("the launch has ended")]
    Ended,
}

impl JoinError {
    /// 2 if an argument is invalid, else 1.
    pub fn exit_code(&self) -> u8 {
        if let Self::Launch(error) = self { error.exit_code() } else { 1 }
    }
}

/// The part of the settings of a process that all of them have.
#[derive(Deserialize)]
struct Common {
    run: Run,
}

/// A running launch.
pub(crate) struct Joined {
    entry: GraphEntry,
    ports: Ports,
    /// Length of a control period \[s\].
    pub(crate) period_s: f64,
    /// Its run directory.
    pub(crate) folder: PathBuf,
}

impl Joined {
    /// Joins the launch in the run directory `run`, or the only one that runs, with the graphs of
    /// this machine in `base`.
    ///
    /// # Errors
    /// [`JoinError`].
    pub(crate) fn new(run: Option<&Path>, base: &Path) -> Result<Self, JoinError> {
        let (entry, folder) = launch(run, base)?;
        let roles = [Participant::Controller, Participant::Plant, Participant::Gateway];
        let file = roles
            .map(|role| settings_file(&folder, role))
            .into_iter()
            .find(|file| file.exists())
            .unwrap_or_else(|| settings_file(&folder, Participant::Controller));
        let unreadable = |reason: String| JoinError::Settings { file: file.clone(), reason };
        let text = fs::read_to_string(&file).map_err(|error| unreadable(error.to_string()))?;
        let Common { run } =
            toml::from_str(&text).map_err(|error| unreadable(error.to_string()))?;
        let ports = Ports::open(&run.links, Identity::new(0))?;
        Ok(Self { entry, ports, period_s: run.period_nanos as f64 * 1e-9, folder })
    }

    /// A reader that no writer waits for.
    pub(crate) fn watcher<T: OnTopic>(&self) -> Result<Source<T>, JoinError> {
        Ok(self.ports.watcher()?)
    }

    /// # Errors
    /// [`JoinError::Ended`] if the launch has ended.
    pub(crate) fn check(&self) -> Result<(), JoinError> {
        if self.entry.is_living() { Ok(()) } else { Err(JoinError::Ended) }
    }
}
