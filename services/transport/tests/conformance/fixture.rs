//! One carrier under test, in a graph of its own, which removes its files when it is dropped.

use bytemuck::Zeroable;
use protocol::frame;
use protocol::message::{Command, Credit, Health, Message, ModelSnapshot, SnapshotHead};
use protocol::topic::OnTopic;
use std::error::Error;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;
use tempfile::TempDir;
use transport::{Exchange, Identity, Links, Ports, Since, Sink, Source, sweep};

pub(crate) type Failure = Box<dyn Error + Send + Sync>;

pub(crate) type Outcome = Result<(), Failure>;

/// Longer than any test machine needs. A wait that is expected to time out uses [`BRIEF`].
pub(crate) const LONG: Duration = Duration::from_mins(1);

/// Longer than a reader with room needs to report it, on any test machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(1);

/// Long enough to notice that an event does not happen.
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
        let links = Links::on_this_machine(
            graph,
            folder.path().join("r"),
            lock_step,
            u64::try_from(patience.as_millis())?,
        );
        Ok(Self { links, _folder: folder })
    }

    fn ports(&self, epoch: u64) -> Result<Ports, Failure> {
        Ok(Ports::open(&self.links, Identity::new(epoch))?)
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // A failed test must leave no remains beside its message.
        let _ = sweep(&self.links);
    }
}

/// The next message; the message is already on its way.
pub(crate) fn receive<T: OnTopic>(source: &mut Source<T>) -> Result<T, Failure> {
    loop {
        if !source.wait(LONG)? {
            return Err(format!("no {} comes", T::NAME).into());
        }
        if let Some(message) = source.next()? {
            return Ok(message);
        }
    }
}

/// The newest message, once all messages up to `tick` have arrived.
pub(crate) fn receive_until<T: OnTopic>(
    source: &mut Source<T>,
    tick: impl Fn(&T) -> bool,
) -> Result<T, Failure> {
    loop {
        if !source.wait(LONG)? {
            return Err(format!("no {} comes any more", T::NAME).into());
        }
        if let Some(message) = source.latest()?
            && tick(&message)
        {
            return Ok(message);
        }
    }
}

/// Reads until the counters have the expected values.
pub(crate) fn count_until<T: OnTopic>(
    source: &mut Source<T>,
    reached: impl Fn(&Source<T>) -> bool,
) -> Outcome {
    loop {
        while source.next()?.is_some() {}
        if reached(source) {
            return Ok(());
        }
        if !source.wait(LONG)? {
            return Err(format!("after {:?} no {} comes any more", source.tally(), T::NAME).into());
        }
    }
}

/// Reports when all messages from one place have arrived at another, without reading them.
pub(crate) struct Fence {
    sink: Sink<Health>,
    source: Source<Health>,
}

impl Fence {
    /// Between the writers of `from` and the readers of `to`, which must be other ports.
    pub(crate) fn between(from: &Ports, to: &Ports) -> Result<Self, Failure> {
        Ok(Self { source: to.source(Since::First)?, sink: from.sink()? })
    }

    /// Returns when all messages of `written` have arrived: a sink closes after its last message
    /// has left, and the fence follows it.
    pub(crate) fn pass<T: OnTopic>(&mut self, written: Sink<T>) -> Outcome {
        drop(written);
        self.cross()
    }

    /// Returns when all messages received by a reader on the same ports have also arrived at all
    /// other readers.
    pub(crate) fn cross(&mut self) -> Outcome {
        // Other fences may cross to the same place.
        static CROSSINGS: AtomicU64 = AtomicU64::new(0);
        let own = CROSSINGS.fetch_add(1, Ordering::Relaxed);
        self.sink.send(&mut Health { heartbeat: own, ..Health::zeroed() })?;
        while receive(&mut self.source)?.heartbeat != own {}
        Ok(())
    }
}

/// The bytes of `message` in shared memory.
pub(crate) fn bytes<T: Message>(message: &T) -> Vec<u8> {
    let mut bytes = vec![0; message.byte_len()];
    frame::encode(message, &mut bytes);
    bytes
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
    let mut snapshot =
        ModelSnapshot::new(SnapshotHead { version, inputs: 6, ..SnapshotHead::zeroed() });
    for point in 0..points {
        let value = f64::from(point);
        snapshot.push(&[value; 6], [value, 0.5, -value], [1.0, 2.0, value])?;
    }
    Ok(snapshot)
}
