//! The keys of messages: `coxswain-link/<graph>/<from>/<to>/<what>`, see `WIRE.md`.

use protocol::topic::{TOPIC_COUNT, Topic};
use std::fmt;

/// The keys between this host and one other.
#[derive(Debug, Clone)]
pub(crate) struct Keys {
    graph: String,
    here: String,
    there: String,
}

/// What a key carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum What {
    /// Messages of a topic.
    Data(Topic),
    /// Acknowledgements of the pieces of a topic.
    Acknowledgements(Topic),
    /// What a bridge tells about itself.
    Hello,
}

/// Behind the name of a topic.
const ACKNOWLEDGEMENTS: &str = "-ack";
/// In place of the name of a topic.
const HELLO: &str = "hello";

impl fmt::Display for What {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Data(topic) => f.write_str(topic.name()),
            Self::Acknowledgements(topic) => write!(f, "{}{ACKNOWLEDGEMENTS}", topic.name()),
            Self::Hello => f.write_str(HELLO),
        }
    }
}

impl What {
    /// All that a key can carry, in the order of [`index`](Self::index).
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        let data = Topic::ALL.into_iter().map(Self::Data);
        let acknowledgements = Topic::ALL.into_iter().map(Self::Acknowledgements);
        data.chain(acknowledgements).chain([Self::Hello])
    }

    pub(crate) const fn index(self) -> usize {
        match self {
            Self::Data(topic) => topic.index(),
            Self::Acknowledgements(topic) => TOPIC_COUNT + topic.index(),
            Self::Hello => 2 * TOPIC_COUNT,
        }
    }

    fn named(name: &str) -> Option<Self> {
        let topic = |name| Topic::ALL.into_iter().find(|topic| topic.name() == name);
        match name.strip_suffix(ACKNOWLEDGEMENTS) {
            Some(name) => topic(name).map(Self::Acknowledgements),
            None if name == HELLO => Some(Self::Hello),
            None => topic(name).map(Self::Data),
        }
    }
}

impl Keys {
    pub(crate) fn new(graph: &str, here: &str, there: &str) -> Self {
        let [graph, here, there] = [graph, here, there].map(str::to_owned);
        Self { graph, here, there }
    }

    /// What this host sends to the other.
    pub(crate) fn outgoing(&self, what: What) -> String {
        let Self { graph, here, there } = self;
        format!("coxswain-link/{graph}/{here}/{there}/{what}")
    }

    /// A key of the other host that carries nothing: a test whether this host can use it.
    pub(crate) fn probe(&self) -> String {
        let Self { graph, here, there } = self;
        format!("coxswain-link/{graph}/{there}/{here}/probe")
    }

    /// What any host sends to this one.
    pub(crate) fn incoming(&self) -> String {
        format!("coxswain-link/{}/*/{}/*", self.graph, self.here)
    }

    /// What `key` carries, if the other host may use it.
    pub(crate) fn what(&self, key: &str) -> Option<What> {
        let mut parts = key.split('/');
        let expected = ["coxswain-link", &self.graph, &self.there, &self.here];
        let fits = expected.into_iter().all(|part| parts.next() == Some(part));
        let what = parts.next().filter(|_| fits)?;
        What::named(what).filter(|_| parts.next().is_none())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_key_of_one_end_is_understood_by_the_other() {
        let (here, there) =
            (Keys::new("g", "robot", "control"), Keys::new("g", "control", "robot"));
        for (index, what) in What::all().enumerate() {
            assert_eq!(what.index(), index);
            assert_eq!(there.what(&here.outgoing(what)), Some(what));
            assert_eq!(here.what(&here.outgoing(what)), None, "this host is not the other one");
        }
    }

    #[test]
    fn a_key_of_another_host_or_graph_is_not_understood() {
        let keys = Keys::new("g", "robot", "control");
        for key in [
            "coxswain-link/g/learner/robot/state",
            "coxswain-link/h/control/robot/state",
            "coxswain-link/g/control/robot/speed",
            "coxswain-link/g/control/robot/state/more",
            "coxswain-link/g/control/robot",
            &keys.probe(),
            "",
        ] {
            assert_eq!(keys.what(key), None, "{key}");
        }
    }
}
