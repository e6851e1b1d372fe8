//! A carrier to be tested, alone with itself, that cleans up when it goes.

use bytemuck::Zeroable;
use protocol::message::{Command, Credit, ModelSnapshot, SnapshotHead};
use protocol::port::{Exchange, Identity, Links, Ports, sweep};
use std::error::Error;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use tempfile::TempDir;

pub(crate) type Failure = Box<dyn Error + Send + Sync>;

pub(crate) type Outcome = Result<(), Failure>;

/// Longer than any test machine needs; a wait that is not to be successful uses [`BRIEF`].
pub(crate) const LONG: Duration = Duration::from_mins(1);

/// Long enough to notice that something does not happen.
pub(crate) const BRIEF: Duration = Duration::from_millis(40);

/// One graph over one carrier.
pub(crate) trait Fixture: Sync + Sized {
    fn with_patience(lock_step: bool, patience: Duration) -> Result<Self, Failure>;

    /// Ports of a new process instance.
    fn ports(&self, epoch: u64) -> Result<Ports, Failure>;

    fn new(lock_step: bool) -> Result<Self, Failure> {
        Self::with_patience(lock_step, LONG)
    }
}

pub(crate) struct Memory {
    exchange: Exchange,
}

impl Fixture for Memory {
    fn with_patience(lock_step: bool, patience: Duration) -> Result<Self, Failure> {
        Ok(Self { exchange: Exchange::new(lock_step, patience) })
    }

    fn ports(&self, epoch: u64) -> Result<Ports, Failure> {
        Ok(Ports::in_memory(&self.exchange, Identity::new(epoch)))
    }
}

pub(crate) struct Shared {
    pub(crate) links: Links,
    _folder: TempDir,
}

impl Fixture for Shared {
    fn with_patience(lock_step: bool, patience: Duration) -> Result<Self, Failure> {
        static GRAPHS: AtomicU32 = AtomicU32::new(0);
        let folder = tempfile::tempdir()?;
        let graph = format!("t{}-{}", std::process::id(), GRAPHS.fetch_add(1, Ordering::Relaxed));
        let links = Links::on_this_machine(graph, folder.path().join("r"), lock_step, u64::try_from(patience.as_millis())?);
        Ok(Self { links, _folder: folder })
    }

    fn ports(&self, epoch: u64) -> Result<Ports, Failure> {
        Ok(Ports::open(&self.links, Identity::new(epoch))?)
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // A test that fails shall not leave more behind than its message.
        let _ = sweep(&self.links);
    }
}

pub(crate) fn command(tick: u64) -> Command {
    let mut command = Command::zeroed();
    command.stamp.tick = tick;
    command.input = [tick as f64, -1.5, 0.25];
    command
}

pub(crate) fn credit(through_tick: u64) -> Credit {
    Credit { through_tick, ..Credit::zeroed() }
}

/// A snapshot with `points` data points of 6 inputs.
pub(crate) fn snapshot(version: u64, points: u32) -> Result<ModelSnapshot, Failure> {
    let mut snapshot = ModelSnapshot::new(SnapshotHead { version, inputs: 6, ..SnapshotHead::zeroed() });
    for point in 0..points {
        let value = f64::from(point);
        snapshot.push(&[value; 6], [value, 0.5, -value], [1.0, 2.0, value])?;
    }
    Ok(snapshot)
}
