//! Who is on a topic: one liveliness token per port, which zenoh takes back when its process ends
//! or its link is cut.

use super::keys::Keys;
use super::{ANSWER_TIMEOUT, Network, failed};
use crate::OpenError;
use access;
use protocol::VERSION;
use protocol::topic::{Delivery, Topic};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::hash::{BuildHasher, RandomState};
use std::rc::Rc;
use std::thread::sleep;
use std::time::Duration;
use zenoh::Wait;

/// A topic without a free place is looked at again so often, so long apart: somebody who is just
/// gone may still be listed.
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
    /// Name of the message that it writes or reads.
    pub(super) message: &'a str,
    /// `newest-wins`, `lossless`, or, of a reader of which no room reports are to be expected,
    /// `unpaced`.
    pub(super) delivery: &'a str,
    pub(super) id: &'a str,
}

impl<'a> Presence<'a> {
    pub(super) fn of(key: &'a str) -> Option<Self> {
        let mut parts = key.rsplit('/');
        let (id, delivery, message) = (parts.next()?, parts.next()?, parts.next()?);
        let (version, role) = (parts.next()?, parts.next()?);
        [Role::Writer.name(), Role::Reader.name()].contains(&role).then_some(Self {
            role,
            version,
            message,
            delivery,
            id,
        })
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

/// A name that no other port has. With a certificate it begins with the role, without which routers
/// take in nothing from a writer.
pub(super) fn draw_id(role: Option<access::Role>) -> String {
    let seed = RandomState::new();
    let name =
        format!("{:016x}", seed.hash_one((std::process::id(), protocol::clock::monotonic_nanos())));
    match role {
        Some(role) => format!("{}.{name}", role.name()),
        None => name,
    }
}

/// A port of this process, which counts as there as long as this lives.
pub(super) struct Own {
    key: String,
    own: Rc<RefCell<BTreeSet<String>>>,
}

impl Own {
    pub(super) fn new(network: &Network, key: String) -> Self {
        network.own.borrow_mut().insert(key.clone());
        Self { key, own: Rc::clone(&network.own) }
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        self.own.borrow_mut().remove(&self.key);
    }
}

/// Key of the token of port `id`.
pub(super) fn key(network: &Network, topic: Topic, role: Role, id: &str) -> String {
    let (version, delivery) = (VERSION.to_string(), delivery_name(network.quality(topic).delivery));
    let presence =
        Presence { role: role.name(), version: &version, message: topic.message(), delivery, id };
    Keys::of(network, topic).presence(&presence)
}

/// The keys of all ports on `topic`.
///
/// zenoh names those of other sessions reliably, and those of this one twice, or under load not at
/// all.
pub(super) fn list(network: &Network, topic: Topic) -> Result<BTreeSet<String>, OpenError> {
    let (keys, failed) = (Keys::of(network, topic), failed(topic));
    let replies = network
        .line
        .session()
        .liveliness()
        .get(keys.presences())
        .timeout(ANSWER_TIMEOUT)
        .wait()
        .map_err(&failed)?;
    let mut found: BTreeSet<String> =
        network.own.borrow().iter().filter(|key| keys.include(key)).cloned().collect();
    while let Ok(reply) = replies.recv() {
        let said = |error| failed(format!("the router does not list its peers: {error}").into());
        found.insert(reply.into_result().map_err(said)?.key_expr().as_str().to_owned());
    }
    Ok(found)
}

/// Fails unless there is a place for one more port in `role`, and all others speak the same way.
/// With certificates who speaks another way does not count: else one who is let in could keep
/// everybody else from coming back.
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
    let (mut count, mut strange) = (0, 0_usize);
    for key in list(network, topic)? {
        let Some(presence) = Presence::of(&key) else { continue };
        let is_alike = [delivery_name(delivery), UNPACED].contains(&presence.delivery)
            && (presence.version, presence.message)
                == (VERSION.to_string().as_str(), topic.message());
        if network.role.is_some() && !is_alike {
            strange += 1;
            continue;
        }
        if presence.version != VERSION.to_string() || presence.message != topic.message() {
            return Err(OpenError::Incompatible {
                topic,
                message: topic.message().to_owned(),
                version: VERSION.to_string(),
                found_message: presence.message.to_owned(),
                found_version: presence.version.to_owned(),
            });
        }
        if presence.delivery != delivery_name(delivery) && presence.delivery != UNPACED {
            return Err(OpenError::Delivery { topic, delivery });
        }
        count += usize::from(presence.role == role.name());
    }
    if strange > 0 {
        tracing::warn!(
            topic = topic.name(),
            strange,
            "a peer announces ports of another protocol version; they are ignored"
        );
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Carrier, Carriers, Links, Router};
    use std::error::Error;

    #[test]
    fn a_program_of_another_version_or_message_is_refused_with_both_named_on_the_network()
    -> Result<(), Box<dyn Error>> {
        let router = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[])?;
        let carriers = Carriers::all(Carrier::Network);
        let links = Links {
            carriers,
            connect: router.endpoints().to_vec(),
            ..Links::on_this_machine("t", "", false, 100)
        };
        let (network, other) = (Network::open(&links)?, Network::open(&links)?);
        let version = VERSION.to_string();
        for (topic, said_version, said_message) in
            [(Topic::Command, "7001", "Command"), (Topic::Credit, version.as_str(), "Sonnet")]
        {
            let theirs = Presence {
                role: "writer",
                version: said_version,
                message: said_message,
                delivery: "newest-wins",
                id: "other",
            };
            let key = Keys::of(&other, topic).presence(&theirs);
            let _token = other
                .line
                .session()
                .liveliness()
                .declare_token(key)
                .wait()
                .map_err(|error| error.to_string())?;
            // Until the token has come round.
            let refused = loop {
                match check(&network, topic, Role::Reader) {
                    Ok(()) => sleep(Duration::from_millis(10)),
                    Err(error) => break error.to_string(),
                }
            };
            let (name, message) = (topic.name(), topic.message());
            let found =
                format!("topic {name} carries {said_message} in protocol version {said_version}");
            assert_eq!(
                refused,
                format!("{found}, this program expects {message} in version {version}")
            );
        }
        Ok(())
    }
}
