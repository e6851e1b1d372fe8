//! The carrier between the processes of one machine, over iceoryx2.
//!
//! Each topic is two services. One is a publish-subscribe service, whose payload is a slice of
//! words, so that messages of fixed and of variable size use the same path. The other is an event
//! service, which wakes the readers. Services carry the name of their message and the protocol
//! version. So programs of two versions refuse each other when they open a port, instead of
//! misreading messages while the robot drives.

mod alarm;
mod closed;
mod half_made;
mod receiver;
mod room;
mod sender;
mod service;
mod sweep;

pub use half_made::HalfMade;
pub use room::claim;
pub use sweep::{SweepReport, sweep};

use super::links::Links;
use super::{Audience, OpenError, Reservation};
use iceoryx2::prelude::{
    Config, FileName, LogLevel, Node, NodeBuilder, Path, SemanticString, SignalHandlingMode,
    ipc_threadsafe, set_log_level,
};
use protocol::topic::{Quality, Topic};
use receiver::SharedMemoryReceiver;
use sender::SharedMemorySender;
use service::{Announcement, Events, Messages};
use std::os::unix::ffi::OsStrExt;
use std::sync::Arc;
use std::time::Duration;

/// Longest path of a socket: the system's limit without its closing zero \[bytes\].
const SOCKET_PATH_MAX: usize = 107;

/// Length of a socket's path behind root and prefix: a separator, 39 digits and `.event` \[bytes\].
const SOCKET_NAME_MAX: usize = 1 + 39 + 6;

/// How long a port waits for another thread or process that already removes the dead members.
const CLEANUP_TIMEOUT: Duration = Duration::from_millis(100);

/// Membership in one graph.
pub(super) struct SharedMemory {
    node: Arc<Node<ipc_threadsafe::Service>>,
    graph: String,
    lock_step: bool,
    patience: Duration,
}

/// The open services of a topic.
pub(super) struct Held {
    _messages: Messages,
    _events: Events,
}

impl SharedMemory {
    pub(super) fn open(links: &Links) -> Result<Self, OpenError> {
        set_log_level(LogLevel::Fatal);
        let config = config(links)?;
        Self::check_room()?;
        HalfMade::new(links).clear();
        std::fs::create_dir_all(&links.root).map_err(|error| OpenError::Root {
            root: links.root.clone(),
            reason: error.to_string(),
        })?;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create()
            .map_err(|error| OpenError::Join {
                graph: links.graph.clone(),
                reason: error.to_string(),
            })?;
        closed::close(links);
        Ok(Self {
            node: Arc::new(node),
            graph: links.graph.clone(),
            lock_step: links.lock_step,
            patience: links.patience(),
        })
    }

    pub(super) fn sender(
        &self,
        topic: Topic,
        audience: Audience,
        reservation: Reservation,
    ) -> Result<SharedMemorySender, OpenError> {
        SharedMemorySender::open(self, topic, audience, reservation)
    }

    pub(super) fn receiver(
        &self,
        topic: Topic,
        audience: Audience,
    ) -> Result<SharedMemoryReceiver, OpenError> {
        SharedMemoryReceiver::open(self, topic, audience)
    }

    /// Opens or makes the services of `topic`, without a port.
    pub(super) fn hold(&self, topic: Topic, audience: Audience) -> Result<Held, OpenError> {
        self.services(topic, audience, &Announcement::of(topic))
            .map(|(messages, events)| Held { _messages: messages, _events: events })
    }

    fn quality(&self, topic: Topic, audience: Audience) -> Quality {
        audience.quality(topic, self.lock_step)
    }
}

/// Common prefix of all files of a graph in `/dev/shm`. The dots keep graph `a` apart from graph
/// `a_b`.
fn prefix(links: &Links) -> String {
    format!("cx.{}.", links.graph)
}

/// iceoryx2's configuration for one graph: its defaults, never a file of the user.
fn config(links: &Links) -> Result<Config, OpenError> {
    links.check()?;
    let prefix = prefix(links);
    let root = links.root.as_os_str().as_bytes();
    let limit = SOCKET_PATH_MAX - SOCKET_NAME_MAX - prefix.len();
    if root.len() > limit {
        return Err(OpenError::RootTooLong {
            root: links.root.clone(),
            graph: links.graph.clone(),
            length: root.len(),
            limit,
        });
    }
    let unusable = |what: &str| OpenError::Root {
        root: links.root.clone(),
        reason: format!("not a usable {what}"),
    };
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix.as_bytes()).map_err(|_| unusable("prefix"))?;
    config.global.set_root_path(&Path::new(root).map_err(|_| unusable("path"))?);
    Ok(config)
}
