//! Addresses of a graph that unauthenticated peers on the network can reach. Without certificates
//! only addresses of this machine are used, unless an option permits others.

use crate::file::Graph;
use protocol::message::Exposure;
use std::fmt;
use std::net::{IpAddr, SocketAddr};

/// An address that other machines can reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exposed {
    /// Its key in the graph file, as a dotted path.
    pub key: String,
    /// The address.
    pub address: String,
}

impl Exposed {
    /// Access that it gives to unauthenticated peers: where two hosts meet, commands are accepted.
    pub fn lets(&self) -> Exposure {
        if self.key.starts_with("connections") { Exposure::Driven } else { Exposure::Watched }
    }
}

impl fmt::Display for Exposed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key, address } = self;
        let what = if self.lets() == Exposure::Driven { "watch and drive" } else { "watch" };
        write!(f, "{key} is {address}, and every peer that reaches it can {what} the robot")
    }
}

/// All addresses that a graph listens at or connects to, that other machines can reach, and that
/// require no certificate. The live page never requires one.
pub fn exposed(graph: &Graph, with_certificates: bool) -> Vec<Exposed> {
    let mut found = Vec::new();
    if !with_certificates {
        for (index, connection) in graph.connections.iter().enumerate() {
            let addresses = [
                ("address", &connection.address),
                ("listen", &connection.listen),
                ("router", &connection.router),
            ];
            for (key, address) in addresses {
                if let Some(address) = address.as_ref().filter(|address| !is_here(address)) {
                    let key = format!("connections.{index}.{key}");
                    found.push(Exposed { key, address: address.clone() });
                }
            }
        }
        for endpoint in &graph.telemetry.listen {
            let address = endpoint.split_once('/').map_or(endpoint.as_str(), |(_, rest)| rest);
            if !is_here(address) {
                let key = "telemetry.listen".to_owned();
                found.push(Exposed { key, address: endpoint.clone() });
            }
        }
    }
    if let Ok(Some(page)) = graph.page.address()
        && !page.ip().is_loopback()
    {
        found.push(Exposed { key: "page.listen".to_owned(), address: page.to_string() });
    }
    found
}

/// Whether an address is one of the loopback. Names are not resolved, because the result may
/// change.
fn is_here(address: &str) -> bool {
    if let Ok(address) = address.parse::<SocketAddr>() {
        return address.ip().is_loopback();
    }
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn of(tables: &str) -> Vec<String> {
        found(tables, false)
    }

    fn found(tables: &str, with_certificates: bool) -> Vec<String> {
        let text = format!(
            "name = \"g\"\nrobot = \"r.toml\"\nscenario = \"s.toml\"\npace = \"real-time\"\
             \n{tables}"
        );
        let graph = settings::parse::<Graph>(&text, Path::new("g.toml"));
        let keys = |graph: Graph| {
            exposed(&graph, with_certificates).into_iter().map(|exposed| exposed.key).collect()
        };
        graph.map_or_else(|error| vec![error.to_string()], keys)
    }

    const HOSTS: &str = "[hosts.robot]\nprocesses = [\"plant\"]\n[hosts.control]\n\
                         processes = [\"controller\"]\n[[connections]]\n\
                         hosts = [\"robot\", \"control\"]\n";

    #[test]
    fn a_graph_with_only_loopback_addresses_is_not_reachable() {
        assert_eq!(of(""), Vec::<String>::new());
        for address in ["127.0.0.1:0", "[::1]:7447", "localhost:1"] {
            let here =
                format!("{HOSTS}address = \"{address}\"\n[page]\nlisten = \"127.9.9.9:80\"\n");
            assert_eq!(of(&here), Vec::<String>::new());
        }
    }

    #[test]
    fn with_certificates_only_the_live_page_accepts_unauthenticated_peers() {
        let tables = format!(
            "{HOSTS}address = \"10.0.0.1:7447\"\n[telemetry]\nlisten = [\"tls/10.0.0.1:1\"]\
         \n[page]\nlisten = \"0.0.0.0:8080\"\n"
        );
        assert_eq!(found(&tables, true), ["page.listen"]);
    }

    #[test]
    fn every_address_that_other_machines_can_reach_is_listed() {
        let hosts = format!("{HOSTS}address = \"10.0.0.1:7447\"\nlisten = \"0.0.0.0:7447\"\n");
        assert_eq!(of(&hosts), ["connections.0.address", "connections.0.listen"]);
        let router = format!("{HOSTS}router = \"10.0.0.9:7447\"\n");
        assert_eq!(of(&router), ["connections.0.router"]);
        assert_eq!(
            of("[telemetry]\nlisten = [\"tcp/[::]:7448\"]\n[page]\nlisten = \"0.0.0.0:8080\"\n"),
            ["telemetry.listen", "page.listen"]
        );
        for name in ["robot.example", "localhost.example"] {
            let tables = format!("[telemetry]\nlisten = [\"tcp/{name}:7448\"]\n");
            assert_eq!(of(&tables), ["telemetry.listen"], "its address is not known");
        }
    }
}
