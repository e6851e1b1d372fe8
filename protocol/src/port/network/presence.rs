//! Who is on a topic: one liveliness token per port, which zenoh takes back when its process ends or its link is cut.

use super::keys::Keys;
use super::{ANSWER_TIMEOUT, Network, failed};
use crate::VERSION;
use crate::port::OpenError;
use crate::topic::{Delivery, Topic};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::hash::{BuildHasher, RandomState};
use std::rc::Rc;
use std::thread::sleep;
use std::time::Duration;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;

/// A topic without a free place is looked at again so often, so long apart: somebody who is just gone may still be listed.
const LOOKS: u32 = 10;
const LOOK_PAUSE: Duration = Duration::from_millis(30);

/// Which end of a link a port is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Writer,
    Reader,
}

impl Role {
    fn name(self) -> &'static str {
        match self {
            Self::Writer => "writer",
            Self::Reader => "reader",
        }
    }

    fn places(self) -> &'static str {
        match self {
            Self::Writer => "writers",
            Self::Reader => "readers",
        }
    }
}

/// What a token says of its port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Presence<'a> {
    pub(super) role: &'a str,
    pub(super) version: &'a str,
    /// `newest-wins`, `lossless`, or, of a reader of which no room reports are to be expected, `unpaced`.
    pub(super) delivery: &'a str,
    pub(super) id: &'a str,
}

impl<'a> Presence<'a> {
    pub(super) fn of(key: &'a str) -> Option<Self> {
        let mut parts = key.rsplit('/');
        let (id, delivery, version, role) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
        [Role::Writer.name(), Role::Reader.name()].contains(&role).then_some(Self { role, version, delivery, id })
    }

    pub(super) fn is_reader(&self) -> bool {
        self.role == Role::Reader.name()
    }

    pub(super) fn is_paced(&self) -> bool {
        self.delivery == delivery_name(Delivery::Lossless)
    }
}

fn delivery_name(delivery: Delivery) -> &'static str {
    match delivery {
        Delivery::NewestWins => "newest-wins",
        Delivery::Lossless => "lossless",
    }
}

const UNPACED: &str = "unpaced";

/// A name that no other port has.
pub(super) fn draw_id() -> String {
    let seed = RandomState::new();
    format!("{:016x}", seed.hash_one((std::process::id(), crate::clock::monotonic_nanos())))
}

/// A port is there as long as this lives.
pub(super) struct Announced {
    key: String,
    own: Rc<RefCell<BTreeSet<String>>>,
    _token: LivelinessToken,
}

impl Drop for Announced {
    fn drop(&mut self) {
        self.own.borrow_mut().remove(&self.key);
    }
}

/// Says that port `id` is there.
pub(super) fn announce(network: &Network, topic: Topic, role: Role, id: &str) -> Result<Announced, OpenError> {
    let delivery = delivery_name(network.quality(topic).delivery);
    let key = Keys::of(network, topic).presence(role.name(), &VERSION.to_string(), delivery, id);
    let token = network.session.liveliness().declare_token(&key).wait().map_err(failed(topic))?;
    network.own.borrow_mut().insert(key.clone());
    Ok(Announced { key, own: Rc::clone(&network.own), _token: token })
}

/// The keys of all ports on `topic`.
///
/// zenoh names those of other sessions reliably, and those of this one twice, or under load not at all.
pub(super) fn list(network: &Network, topic: Topic) -> Result<BTreeSet<String>, OpenError> {
    let (keys, failed) = (Keys::of(network, topic), failed(topic));
    let replies = network.session.liveliness().get(keys.presences()).timeout(ANSWER_TIMEOUT).wait().map_err(&failed)?;
    let mut found: BTreeSet<String> = network.own.borrow().iter().filter(|key| keys.include(key)).cloned().collect();
    while let Ok(reply) = replies.recv() {
        let said = |error| failed(format!("the router does not say who is there: {error}").into());
        found.insert(reply.into_result().map_err(said)?.key_expr().as_str().to_owned());
    }
    Ok(found)
}

/// Fails unless there is a place for one more port in `role`, and all others speak the same way.
pub(super) fn check(network: &Network, topic: Topic, role: Role) -> Result<(), OpenError> {
    let quality = network.quality(topic);
    let limit = match role {
        Role::Writer => quality.writers,
        Role::Reader => quality.readers,
    };
    for _ in 0..LOOKS {
        if look(network, topic, role)? < limit {
            return Ok(());
        }
        sleep(LOOK_PAUSE);
    }
    Err(OpenError::Full { topic, role: role.places(), limit })
}

/// Counts those in `role`.
fn look(network: &Network, topic: Topic, role: Role) -> Result<usize, OpenError> {
    let delivery = network.quality(topic).delivery;
    let mut count = 0;
    for key in list(network, topic)? {
        let Some(presence) = Presence::of(&key) else { continue };
        if presence.version != VERSION.to_string() {
            return Err(OpenError::Incompatible {
                topic,
                message: topic.message().to_owned(),
                version: VERSION.to_string(),
                found_message: topic.message().to_owned(),
                found_version: presence.version.to_owned(),
            });
        }
        if presence.delivery != delivery_name(delivery) && presence.delivery != UNPACED {
            return Err(OpenError::Delivery { topic, delivery });
        }
        count += usize::from(presence.role == role.name());
    }
    Ok(count)
}
