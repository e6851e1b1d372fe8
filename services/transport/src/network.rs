//! The carrier between machines, over zenoh.
//!
//! Every `Ports` is a zenoh client of the graph's router. No thread of the caller ever enters zenoh
//! after a port is open: a writer's messages go through a bounded queue to a thread of its own, a
//! reader's come through one from zenoh's threads. Keys, presence and room reports are described in
//! `WIRE.md`.

mod bell;
mod config;
mod guard;
mod inlet;
mod keys;
mod line;
mod outlet;
mod pieces;
mod presence;
mod rates;
mod readers;
mod router;
mod self_test;

pub use router::Router;
pub use self_test::self_test;

use super::carrier::{Inlet, Outlet};
use super::watched::Audience;
use super::{Links, OpenError, Reservation};
use access::Role;
use guard::Guard;
use inlet::NetworkInlet;
use line::Line;
use network::first_line;
use outlet::NetworkOutlet;
use protocol::topic::{Quality, Topic};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

/// How long the others may take to answer when a port is opened.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// This thread's membership in one graph.
pub(super) struct Network {
    line: Arc<Line>,
    graph: String,
    /// Of whom the certificate is, if there is one.
    role: Option<Role>,
    lock_step: bool,
    patience: Duration,
    /// Keys of the presences of this line.
    own: Rc<RefCell<BTreeSet<String>>>,
}

impl Network {
    pub(super) fn open(links: &Links) -> Result<Self, OpenError> {
        let failed = |reason: String| OpenError::Join { graph: links.graph.clone(), reason };
        if links.connect.is_empty() {
            return Err(failed(
                "a topic runs over the network, and `connect` names no endpoint of a router"
                    .to_owned(),
            ));
        }
        let guard = links
            .credentials
            .as_ref()
            .map(|credentials| Guard::new(credentials, links.network_graph()));
        let guard = guard.transpose().map_err(|error| failed(error.to_string()))?;
        let role = guard.as_ref().map(|guard| guard.role);
        let line = Line::open(&links.connect, guard);
        let line = line.map_err(|error| {
            failed(format!(
                "no router answers at {}: {}",
                links.connect.join(", "),
                first_line(&error)
            ))
        })?;
        Ok(Self {
            line,
            graph: links.network_graph().to_owned(),
            role,
            lock_step: links.lock_step,
            patience: links.patience(),
            own: Rc::default(),
        })
    }

    pub(super) fn outlet(
        &self,
        topic: Topic,
        reservation: Reservation,
    ) -> Result<Box<dyn Outlet>, OpenError> {
        Ok(Box::new(NetworkOutlet::open(self, topic, reservation)?))
    }

    pub(super) fn inlet(
        &self,
        topic: Topic,
        audience: Audience,
    ) -> Result<Box<dyn Inlet>, OpenError> {
        Ok(Box::new(match audience {
            Audience::Watchers if Audience::is_split(topic, self.lock_step) => {
                NetworkInlet::watch(self, topic)?
            }
            Audience::Members | Audience::Watchers => NetworkInlet::open(self, topic)?,
        }))
    }

    fn quality(&self, topic: Topic) -> Quality {
        topic.quality(self.lock_step)
    }
}

/// The carrier's error, about one topic.
fn failed(topic: Topic) -> impl Fn(zenoh::Error) -> OpenError {
    move |error| OpenError::Carrier { topic, reason: first_line(&error) }
}

/// The error of a thread that the system does not give.
fn no_thread(topic: Topic) -> impl Fn(std::io::Error) -> OpenError {
    move |error| OpenError::Carrier { topic, reason: format!("no thread: {error}") }
}
