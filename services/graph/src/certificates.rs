//! A directory of certificates → credentials of this host, checked before any process starts.

use crate::file::Graph;
use crate::hosts::ONLY_HOST;
use access::{AccessError, Certificate, Credentials, Role, host_in, is_any};
use bridge::settings::Meeting;
use runs::utc::{unix_s, utc_of_unix_s};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Place of the certificates: the table `[certificates]` of a graph file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificatesTable {
    /// Directory with one directory per role, as `deploy/certificates` creates it; relative to the
    /// graph file.
    pub folder: PathBuf,
}

/// The certificate of this host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Certificates {
    folder: PathBuf,
    host: Role,
    robot: String,
    until_s: i64,
}

/// Why the certificate of a host cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PresentError {
    /// It is not usable by itself.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// It is not valid for the address of an endpoint.
    #[error(
        "the certificate of {} is for {}, and {key} is {endpoint}: make certificates with --host \
         NAME={}",
        certificate.role,
        certificate.addresses.join(", "),
        host_in(endpoint)
    )]
    Address {
        /// The certificate.
        certificate: Box<Certificate>,
        /// Key of the endpoint in the graph file.
        key: &'static str,
        /// The endpoint.
        endpoint: String,
    },
}

impl Certificates {
    /// Checks the certificate in `folder` of `host`, which its bridge and its gateway present.
    ///
    /// # Errors
    /// [`PresentError`].
    pub fn check(folder: &Path, graph: &Graph, host: Option<&str>) -> Result<Self, PresentError> {
        let name = host.unwrap_or(ONLY_HOST);
        let role = Role::Host(name.to_owned());
        let credentials = Credentials::in_folder(folder.join(role.to_string()));
        let certificate = credentials.check(&role, unix_s(SystemTime::now()))?;
        for remote in graph.deployment().remotes(name) {
            if let Meeting::Listen(endpoint) = &remote.meeting {
                covers(&certificate, "connections.listen", endpoint)?;
            }
        }
        if let Some(address) = graph.requests.get(name) {
            covers(&certificate, "requests", &format!("tls/{address}"))?;
        }
        if graph.processes.gateway.enabled {
            for endpoint in &graph.telemetry.listen {
                covers(&certificate, "telemetry.listen", endpoint)?;
            }
        }
        let Certificate { robot, until_s, .. } = certificate;
        Ok(Self { folder: folder.to_path_buf(), host: role, robot, until_s })
    }

    /// Credentials of this host.
    pub fn credentials(&self) -> Credentials {
        Credentials::in_folder(self.folder.join(self.host.to_string()))
    }

    /// The directory.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// End of the validity of the certificate: Unix time \[s\].
    pub fn until_s(&self) -> i64 {
        self.until_s
    }
}

impl std::fmt::Display for Certificates {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { folder, host, robot, until_s } = self;
        write!(
            f,
            "certificate {} in {}, valid until {}",
            host.subject(robot),
            folder.display(),
            utc_of_unix_s(*until_s)
        )
    }
}

/// Fails unless the certificate is valid for the address of `endpoint`.
fn covers(
    certificate: &Certificate,
    key: &'static str,
    endpoint: &str,
) -> Result<(), PresentError> {
    let host = host_in(endpoint);
    // Peers connect to another address than a wildcard, and it is not known here.
    if is_any(host) || certificate.covers(host) {
        return Ok(());
    }
    let certificate = Box::new(certificate.clone());
    Err(PresentError::Address { certificate, key, endpoint: endpoint.to_owned() })
}
