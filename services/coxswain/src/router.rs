//! `coxswain router`: the configuration of a zenoh router at which hosts meet that cannot reach
//! each other, such as robots behind NAT.
//!
//! The router sees the certificate of each host, and the hosts see only that of the router. So the
//! router must let each host publish below its own keys alone.

use access::{
    AUTHORITY_FILE, AccessError, CERTIFICATE_FILE, Credentials, KEY_FILE, of_meeting_point,
};
use clap::Args;
use graph::file::Graph;
use serde_json::{Value, json};
use settings::SettingsError;
use std::path::PathBuf;

/// A graph whose hosts meet at a router.
#[derive(Debug, Clone, Args)]
pub struct RouterOptions {
    /// Graph file with hosts and at least one connection with a router.
    pub graph: PathBuf,
    /// Folder of the router's own certificate, as `deploy/certificates --host NAME=ADDRESS` makes
    /// it.
    #[arg(long, value_name = "DIR")]
    pub certificate: PathBuf,
}

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum RouterError {
    /// The graph file cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The certificate cannot be used.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// No hosts meet at a router.
    #[error("{}: connections: expected one with a router", graph.display())]
    NoRouter {
        /// The graph file.
        graph: PathBuf,
    },
}

/// The configuration, as a JSON value for `zenohd --config FILE`.
///
/// # Errors
/// [`RouterError`].
pub fn configuration(options: &RouterOptions) -> Result<Value, RouterError> {
    let graph: Graph = settings::read(&options.graph)?;
    let routers: Vec<&String> =
        graph.connections.iter().filter_map(|connection| connection.router.as_ref()).collect();
    if routers.is_empty() {
        return Err(RouterError::NoRouter { graph: options.graph.clone() });
    }
    let mut listen: Vec<String> = routers.iter().map(|address| format!("tls/{address}")).collect();
    listen.dedup();
    let credentials = Credentials::in_folder(&options.certificate);
    let robot = credentials.read()?.robot;
    let hosts: Vec<String> = graph.hosts.keys().cloned().collect();
    let file = |name| credentials.file(name);
    Ok(json!({
        "mode": "router",
        "listen": { "endpoints": listen },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "transport": { "link": {
            "protocols": ["tls"],
            "tls": {
                "root_ca_certificate": file(AUTHORITY_FILE),
                "listen_private_key": file(KEY_FILE),
                "listen_certificate": file(CERTIFICATE_FILE),
                "enable_mtls": true,
                "close_link_on_expiration": true,
            },
        } },
        "access_control": of_meeting_point(&graph.name, &robot, &hosts),
    }))
}
