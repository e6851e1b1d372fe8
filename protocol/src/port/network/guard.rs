//! What a process that has a certificate knows: who it is, and whom it believes on the network.

use crate::access::{AccessError, Credentials};

/// Certificate, robot and graph of one session.
#[derive(Debug, Clone)]
pub(super) struct Guard {
    pub(super) credentials: Credentials,
    /// The robot that the certificate names: whoever is of another is believed nothing.
    pub(super) robot: String,
    /// Name of the graph on the network.
    pub(super) graph: String,
}

impl Guard {
    /// Reads the certificate.
    pub(super) fn new(credentials: &Credentials, graph: &str) -> Result<Self, AccessError> {
        let robot = credentials.read()?.robot;
        Ok(Self { credentials: credentials.clone(), robot, graph: graph.to_owned() })
    }
}
