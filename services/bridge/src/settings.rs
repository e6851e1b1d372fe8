//! The hosts of a graph, their processes, and where they meet.

use access::{Credentials, Role};
use process::{HasRun, Run};
use protocol::message::Participant;
use protocol::topic::Topic;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::path::PathBuf;
use transport::is_graph_name;

/// Settings of the bridge of one host.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Settings that every process has.
    pub run: Run,
    /// Name of the graph, the same on all hosts.
    pub graph: String,
    /// Name of this host.
    pub host: String,
    /// The processes of this host.
    pub processes: Vec<Participant>,
    /// The other hosts with which this host exchanges messages.
    pub remotes: Vec<Remote>,
    /// Endpoint for requests of operators and planners, such as `tcp/0.0.0.0:7451`; needs a
    /// certificate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub requests: Option<String>,
    /// The certificate of this host. Without it nothing is encrypted, and every peer is trusted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub credentials: Option<Credentials>,
}

/// Another host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Remote {
    /// Its name.
    pub host: String,
    /// Its processes.
    pub processes: Vec<Participant>,
    /// Whether it is a robot's driver without a bridge, see `WIRE.md`.
    #[serde(default)]
    pub driver: bool,
    /// Socket of such a driver for lists of planners, on the machine of this bridge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lists: Option<PathBuf>,
    /// Where the two meet.
    pub meeting: Meeting,
}

/// Where two hosts meet: an endpoint such as `tcp/10.0.0.1:7447`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Meeting {
    /// This host accepts the connection.
    Listen(String),
    /// The other host accepts it.
    Connect(String),
    /// Both connect to a zenoh router.
    Router(String),
}

impl Meeting {
    /// The endpoint.
    pub fn endpoint(&self) -> &str {
        match self {
            Self::Listen(endpoint) | Self::Connect(endpoint) | Self::Router(endpoint) => endpoint,
        }
    }
}

impl Remote {
    /// The role that its certificate names.
    pub fn role(&self) -> Role {
        if self.driver { Role::Driver } else { Role::Host(self.host.clone()) }
    }
}

/// Topics that go from a host with the processes `from` to one with the processes `to`.
/// `has_launcher` is whether the latter has a launcher of ours.
pub fn crossing(from: &[Participant], to: &[Participant], has_launcher: bool) -> Vec<Topic> {
    let meets = |a: &[Participant], b: &[Participant]| a.iter().any(|one| b.contains(one));
    Topic::ALL
        .into_iter()
        .filter(|topic| {
            let is_read =
                meets(topic.readers(), to) || has_launcher && topic.is_read_by_launchers();
            meets(topic.writers(), from) && is_read
        })
        .collect()
}

impl Settings {
    /// Topics that this host sends to `remote`.
    pub fn outgoing(&self, remote: &Remote) -> Vec<Topic> {
        crossing(&self.processes, &remote.processes, !remote.driver)
    }

    /// Topics that this host accepts from `remote`.
    pub fn incoming(&self, remote: &Remote) -> Vec<Topic> {
        crossing(&remote.processes, &self.processes, true)
    }
}

impl HasRun for Settings {
    fn run(&self) -> &Run {
        &self.run
    }
}

impl Check for Settings {
    fn check(&self) -> Result<(), Impossible> {
        let names = [("graph".to_owned(), &self.graph), ("host".to_owned(), &self.host)];
        let remotes = self.remotes.iter().enumerate();
        let remotes =
            remotes.map(|(index, remote)| (format!("remotes.{index}.host"), &remote.host));
        for (key, name) in names.into_iter().chain(remotes) {
            if !is_graph_name(name) {
                return Err(Impossible::new(key, "1 to 32 characters out of a-z, 0-9, _ and -"));
            }
        }
        if self.requests.is_some() && self.credentials.is_none() {
            return Err(Impossible::new("credentials", "a certificate, for the requests"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Participant::{Bridge, Controller, Gateway, Learner, Plant, Recorder};

    #[test]
    fn a_topic_crosses_where_its_ends_are_on_different_hosts() {
        use Topic::{Command, Goal, Health, Obstacles, Plan, Residual, Snapshot, State};
        let (robot, control) = ([Plant, Recorder, Bridge], [Controller, Bridge]);
        assert_eq!(crossing(&robot, &control, true), [State, Health, Obstacles]);
        assert_eq!(crossing(&control, &robot, true), [Command, Residual, Plan, Health, Goal]);
        let learner = [Learner, Bridge];
        assert_eq!(crossing(&control, &learner, true), [Residual, Plan, Health, Goal]);
        assert_eq!(crossing(&learner, &control, true), [Snapshot, Health]);
    }

    #[test]
    fn a_driver_gets_what_the_plant_reads_alone() {
        let control = [Controller, Learner, Recorder, Gateway, Bridge];
        assert_eq!(crossing(&control, &[Plant], false), [Topic::Command, Topic::Credit]);
        let from_plant = [Topic::State, Topic::Health, Topic::Truth, Topic::Obstacles];
        assert_eq!(crossing(&[Plant], &control, true), from_plant);
    }

    #[test]
    fn every_topic_has_readers_other_than_its_writers() {
        for topic in Topic::ALL {
            assert!(!topic.writers().is_empty() && !topic.readers().is_empty(), "{topic:?}");
        }
    }
}
