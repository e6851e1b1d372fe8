//! What a process that has a certificate knows: who it is, and whom it believes on the network.

use access::{AccessError, Credentials, Role};

/// Certificate, role, robot and graph of one session.
#[derive(Debug, Clone)]
pub(super) struct Guard {
    pub(super) credentials: Credentials,
    /// Who it is.
    pub(super) role: Role,
    /// The robot that the certificate names: whoever is of another is believed nothing.
    pub(super) robot: String,
    /// Name of the graph on the network.
    pub(super) graph: String,
    /// Of a router: whether messages may be lost, and so their rates be limited.
    pub(super) real_time: bool,
}

impl Guard {
    /// Reads the certificate.
    pub(super) fn new(credentials: &Credentials, graph: &str) -> Result<Self, AccessError> {
        let identity = credentials.read()?;
        Ok(Self {
            credentials: credentials.clone(),
            role: identity.role,
            robot: identity.robot,
            graph: graph.to_owned(),
            real_time: false,
        })
    }
}
