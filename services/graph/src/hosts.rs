//! The hosts of a graph file: which process runs where, and where two hosts meet.

use crate::role::START_ORDER;
use bridge::settings::{Meeting, Remote, crossing};
use protocol::message::Participant;
use protocol::topic::Topic;
use serde::Deserialize;
use settings::Impossible;
use std::collections::BTreeMap;
use std::path::PathBuf;
use transport::is_graph_name;

/// Name of the host of a graph that has no hosts.
pub const ONLY_HOST: &str = "robot";

/// One host: the table `[hosts.NAME]`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Host {
    /// The processes that run there.
    pub processes: Vec<Participant>,
    /// Whether it is a robot's driver that is no process of ours. It takes the place of the plant,
    /// and is not launched.
    pub driver: bool,
    /// Socket where such a driver takes lists of planners, on the machine of the bridge that it
    /// connects to: an absolute path. Planners on other machines reach it through `requests`.
    pub lists: Option<PathBuf>,
}

/// Where two hosts meet: one row `[[connections]]`. One of `address` and `router` is given.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Connection {
    /// The two hosts. The first one accepts the connection.
    pub hosts: [String; 2],
    /// Host and port at which the second one reaches the first.
    #[serde(default)]
    pub address: Option<String>,
    /// Host and port at which the first one listens; by default `address`.
    #[serde(default)]
    pub listen: Option<String>,
    /// Host and port of a zenoh router to which both connect.
    #[serde(default)]
    pub router: Option<String>,
}

/// Hosts and connections of a graph.
#[derive(Debug, Clone, Copy)]
pub struct Deployment<'a> {
    /// The hosts by name.
    pub hosts: &'a BTreeMap<String, Host>,
    /// Where they meet.
    pub connections: &'a [Connection],
}

impl Host {
    /// The processes there, those of a driver included.
    pub fn participants(&self) -> Vec<Participant> {
        if self.driver {
            vec![Participant::Plant]
        } else {
            self.processes.iter().copied().chain([Participant::Bridge]).collect()
        }
    }
}

/// Whether `text` consists of a host and a port, and nothing else. Further text could switch off
/// the check of certificates.
pub fn is_address(text: &str) -> bool {
    let is_host = |host: &str| !host.is_empty() && !host.contains(['?', '#', '/', ';']);
    text.rsplit_once(':').is_some_and(|(host, port)| is_host(host) && port.parse::<u16>().is_ok())
}

impl Connection {
    /// The endpoint where `host` meets the other one; none if it is not one of the two.
    pub fn meeting(&self, host: &str) -> Option<Meeting> {
        let [first, second] = &self.hosts;
        let endpoint = |address: &String| format!("tcp/{address}");
        if let Some(router) = self.router.as_ref().filter(|_| host == first || host == second) {
            return Some(Meeting::Router(endpoint(router)));
        }
        let address = self.address.as_ref()?;
        if host == first {
            Some(Meeting::Listen(endpoint(self.listen.as_ref().unwrap_or(address))))
        } else {
            (host == second).then(|| Meeting::Connect(endpoint(address)))
        }
    }

    /// The host at the other end of the connection of `host`.
    pub fn other(&self, host: &str) -> Option<&str> {
        let [first, second] = &self.hosts;
        if host == first { Some(second) } else { (host == second).then_some(first.as_str()) }
    }
}

impl Deployment<'_> {
    /// The other hosts with which `host` exchanges messages.
    pub fn remotes(&self, host: &str) -> Vec<Remote> {
        let remote = |connection: &Connection| {
            let name = connection.other(host)?;
            let there = self.hosts.get(name)?;
            Some(Remote {
                host: name.to_owned(),
                processes: there.participants(),
                driver: there.driver,
                lists: there.lists.clone(),
                meeting: connection.meeting(host)?,
            })
        };
        self.connections.iter().filter_map(remote).collect()
    }

    /// The first contradiction.
    ///
    /// # Errors
    /// Its key, and what was expected.
    pub fn check(&self) -> Result<(), Impossible> {
        if self.hosts.is_empty() && self.connections.is_empty() {
            return Ok(());
        }
        for name in self.hosts.keys() {
            if !is_graph_name(name) {
                let expected = "a name of 1 to 32 characters out of a-z, 0-9, _ and -";
                return Err(Impossible::new(format!("hosts.{name}"), expected));
            }
        }
        self.check_processes()?;
        for (index, connection) in self.connections.iter().enumerate() {
            self.check_connection(connection)
                .map_err(|impossible| impossible.under(&format!("connections.{index}")))?;
        }
        self.check_links()
    }

    /// Each process runs on one host, and the plant on exactly one.
    fn check_processes(&self) -> Result<(), Impossible> {
        for (name, host) in self.hosts {
            let key = format!("hosts.{name}.processes");
            if host.driver != host.processes.is_empty() {
                let expected = if host.driver {
                    "none: a driver is the plant, and runs outside the graph"
                } else {
                    "at least one process, or driver = true"
                };
                return Err(Impossible::new(key, expected));
            }
            if host.lists.as_ref().is_some_and(|socket| !host.driver || !socket.is_absolute()) {
                let expected = "the absolute path of a socket, beside driver = true";
                return Err(Impossible::new(format!("hosts.{name}.lists"), expected));
            }
            if host.processes.contains(&Participant::Bridge) {
                return Err(Impossible::new(key, "no bridge: each host has one"));
            }
        }
        for role in START_ORDER.into_iter().filter(|role| *role != Participant::Bridge) {
            let runs_on = |host: &&Host| host.participants().contains(&role);
            let count = self.hosts.values().filter(runs_on).count();
            let is_required = matches!(role, Participant::Plant | Participant::Controller);
            if count > 1 || count == 0 && is_required {
                let expected = format!("{role} on one host, found it on {count}");
                return Err(Impossible::new("hosts", expected));
            }
        }
        Ok(())
    }

    fn check_connection(&self, connection: &Connection) -> Result<(), Impossible> {
        let [first, second] = &connection.hosts;
        for (index, name) in connection.hosts.iter().enumerate() {
            if !self.hosts.contains_key(name) {
                let names: Vec<&str> = self.hosts.keys().map(String::as_str).collect();
                let expected = format!("one of the hosts {}", names.join(", "));
                return Err(Impossible::new(format!("hosts.{index}"), expected));
            }
        }
        let is_driver = |name: &String| self.hosts.get(name).is_some_and(|host| host.driver);
        if first == second || is_driver(first) {
            let expected = "two different hosts, of which the first is no driver";
            return Err(Impossible::new("hosts", expected));
        }
        if connection.address.is_some() == connection.router.is_some() {
            let expected = "either the address of the first host, or a router";
            return Err(Impossible::new("address", expected));
        }
        let addresses = [
            ("address", &connection.address),
            ("listen", &connection.listen),
            ("router", &connection.router),
        ];
        for (key, address) in addresses {
            if address.as_ref().is_some_and(|address| !is_address(address)) {
                return Err(Impossible::new(key, "a host and a port such as 10.0.0.1:7447"));
            }
        }
        Ok(())
    }

    /// Two hosts between which a topic crosses are connected. Heartbeats alone need no connection.
    fn check_links(&self) -> Result<(), Impossible> {
        for (from, here) in self.hosts {
            for (to, there) in self.hosts.iter().filter(|(to, _)| *to != from) {
                let topics = crossing(&here.participants(), &there.participants(), false);
                let Some(topic) = topics.iter().find(|topic| **topic != Topic::Health) else {
                    continue;
                };
                let is_connected =
                    self.connections.iter().any(|one| one.other(from) == Some(to.as_str()));
                if !is_connected {
                    let expected = format!(
                        "a connection between {from} and {to}, for the topic {}",
                        topic.name()
                    );
                    return Err(Impossible::new("connections", expected));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::Graph;
    use std::path::Path;

    const GRAPH: &str = "name = \"g\"\nrobot = \"r.toml\"\nscenario = \"s.toml\"\n\
                         pace = \"real-time\"\n";
    const ROBOT: &str = "[hosts.robot]\nprocesses = [\"plant\", \"recorder\"]\n";
    const CONTROL: &str = "[hosts.control]\nprocesses = [\"controller\", \"learner\"]\n";
    const MEET: &str = "[[connections]]\nhosts = [\"robot\", \"control\"]\n\
                        address = \"10.0.0.1:7447\"\n";

    fn graph(tables: &[&str]) -> Result<Graph, String> {
        let text = GRAPH.to_owned() + &tables.concat();
        settings::parse(&text, Path::new("g.toml")).map_err(|error| error.to_string())
    }

    fn refusal(tables: &[&str]) -> String {
        graph(tables).err().unwrap_or_default()
    }

    #[test]
    fn the_second_host_connects_to_where_the_first_one_listens() -> Result<(), String> {
        let graph = graph(&[ROBOT, CONTROL, MEET, "listen = \"0.0.0.0:7447\"\n"])?;
        let meetings = ["robot", "control"].map(|host| {
            graph.deployment().remotes(host).into_iter().map(|remote| remote.meeting).next()
        });
        assert_eq!(
            meetings,
            [
                Some(Meeting::Listen("tcp/0.0.0.0:7447".to_owned())),
                Some(Meeting::Connect("tcp/10.0.0.1:7447".to_owned())),
            ]
        );
        Ok(())
    }

    #[test]
    fn a_driver_is_the_plant_of_its_host() -> Result<(), String> {
        let driver = "[hosts.base]\ndriver = true\n";
        let control = "[hosts.control]\nprocesses = [\"controller\"]\n";
        let meet = MEET.replace("robot", "control").replacen("\"control\"]", "\"base\"]", 1);
        let graph = graph(&[driver, control, &meet])?;
        let remotes = graph.deployment().remotes("control");
        assert_eq!(remotes.len(), 1);
        assert!(remotes.iter().all(|remote| {
            remote.driver && remote.processes == [Participant::Plant] && remote.host == "base"
        }));
        Ok(())
    }

    #[test]
    fn hosts_that_contradict_each_other_are_rejected_with_key_and_expectation() {
        for (tables, key) in [
            (vec![ROBOT, CONTROL], "connections"),
            (vec![ROBOT, MEET], "hosts"),
            (vec![ROBOT, &ROBOT.replace("robot", "other"), CONTROL, MEET], "hosts"),
            (vec![ROBOT, CONTROL, MEET, "router = \"10.0.0.9:1\"\n"], "connections.0.address"),
            (vec![ROBOT, CONTROL, &MEET.replace(":7447", "")], "connections.0.address"),
            (vec![ROBOT, CONTROL, &MEET.replace("\"control\"", "\"desk\"")], "connections.0.hosts"),
            (
                vec![ROBOT, CONTROL, &MEET.replace("\"control\"", "\"robot\"")],
                "connections.0.hosts",
            ),
            (vec![ROBOT, "[hosts.control]\n", MEET], "hosts.control.processes"),
            (vec![ROBOT, "lists = \"/run/lists\"\n", CONTROL, MEET], "hosts.robot.lists"),
            (
                vec!["[hosts.base]\ndriver = true\nlists = \"lists\"\n", CONTROL, MEET],
                "hosts.base.lists",
            ),
            (
                vec![
                    &ROBOT
                        .replace("robot", "Robot 1")
                        .replace("[hosts.Robot 1]", "[hosts.\"R 1\"]"),
                ],
                "hosts",
            ),
        ] {
            let text = refusal(&tables);
            assert!(text.contains(key), "{tables:?}: {text}");
        }
    }

    #[test]
    fn an_address_is_a_host_and_a_port() {
        for (text, expected) in [
            ("10.0.0.1:7447", true),
            ("[::1]:0", true),
            ("robot.example:1", true),
            ("7447", false),
            (":7447", false),
            ("10.0.0.1:70000", false),
            ("tcp/10.0.0.1:7447", false),
            ("10.0.0.1:7447?verify=false", false),
        ] {
            assert_eq!(is_address(text), expected, "{text}");
        }
    }
}
