//! The keys of one topic, see `WIRE.md`.

use super::Network;
use super::presence::Presence;
use protocol::topic::Topic;

/// `coxswain-link/<graph>/<topic>`, in front of every key.
#[derive(Clone)]
pub(super) struct Keys {
    base: String,
}

impl Keys {
    pub(super) fn of(network: &Network, topic: Topic) -> Self {
        Self { base: format!("coxswain-link/{}/{}", network.graph, topic.name()) }
    }

    /// What `outlet` says to everyone; `*` for any.
    pub(super) fn data(&self, outlet: &str) -> String {
        format!("{}/data/{outlet}", self.base)
    }

    /// What `outlet` says again to `inlet`, which has joined late.
    pub(super) fn history(&self, inlet: &str, outlet: &str) -> String {
        format!("{}/history/{inlet}/{outlet}", self.base)
    }

    /// Up to which number `inlet` has made room for `outlet`.
    pub(super) fn room(&self, outlet: &str, inlet: &str) -> String {
        format!("{}/room/{outlet}/{inlet}", self.base)
    }

    /// Where `outlet` answers that everything said to it before has reached it.
    pub(super) fn join(&self, outlet: &str) -> String {
        format!("{}/join/{outlet}", self.base)
    }

    /// Every presence.
    pub(super) fn presences(&self) -> String {
        format!("{}/**", self.base)
    }

    /// Whether `key` is one of this topic.
    pub(super) fn include(&self, key: &str) -> bool {
        key.strip_prefix(&self.base).is_some_and(|rest| rest.starts_with('/'))
    }

    /// The presences of all readers.
    pub(super) fn readers(&self) -> String {
        format!("{}/reader/**", self.base)
    }

    /// One presence.
    pub(super) fn presence(&self, presence: &Presence<'_>) -> String {
        let Presence { role, version, message, delivery, id } = presence;
        format!("{}/{role}/{version}/{message}/{delivery}/{id}", self.base)
    }
}

/// The last part of `key`.
pub(super) fn last(key: &str) -> &str {
    key.rsplit('/').next().unwrap_or(key)
}
