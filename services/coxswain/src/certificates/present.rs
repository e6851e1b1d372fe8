//! A directory of certificates → credentials of each process of a launch, checked before any
//! process starts.

use super::{told, unix_s};
use crate::graph::Graph;
use crate::role::START_ORDER;
use access::{AUTHORITY_FILE, AccessError, Certificate, Credentials, Role, host_in, is_any};
use protocol::message::Participant;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use transport::Carrier;

/// Place of the certificates: the table `[certificates]` of a graph file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificatesTable {
    /// Directory with one directory per role, as `deploy/certificates` creates it; relative to the
    /// graph file.
    pub folder: PathBuf,
}

/// The certificates of one launch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Certificates {
    folder: PathBuf,
    host: Role,
    robot: String,
    until_s: i64,
}

/// Why the certificates of a launch cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PresentError {
    /// A certificate is not usable by itself.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// Two certificates do not belong together.
    #[error(
        "the certificate of {role} is of {found}, that of {} of {expected}: \
         make all of them together",
        host.name()
    )]
    Mixed {
        /// One role.
        role: &'static str,
        /// Its robot or authority.
        found: String,
        /// Another role.
        host: Role,
        /// The other robot or authority.
        expected: String,
    },
    /// It is not valid for the address of an endpoint.
    #[error(
        "the certificate of {role} is for {}, and {key} is {endpoint}: \
         make certificates with --address {host}",
        addresses.join(", ")
    )]
    Address {
        /// Role of the certificate.
        role: &'static str,
        /// Addresses for which it is valid.
        addresses: Vec<String>,
        /// Key of the endpoint in the graph file, as a dotted path.
        key: &'static str,
        /// The endpoint.
        endpoint: String,
        /// Name or address in the endpoint.
        host: String,
    },
}

impl Certificates {
    /// Checks the certificates in `folder` that a launch of `graph` needs: its own, and that of
    /// each process with links over the network.
    ///
    /// # Errors
    /// [`PresentError`].
    pub fn check(folder: &Path, graph: &Graph) -> Result<Self, PresentError> {
        let now_s = unix_s(SystemTime::now());
        let host = host_of(graph);
        let networked = graph.links.uses(Carrier::Network);
        let started = START_ORDER.into_iter().filter(|&role| graph.processes.of(role).enabled);
        let needed: Vec<Role> = if networked {
            [host].into_iter().chain(started.map(Role::from)).collect()
        } else {
            // Only the gateway publishes beyond this machine.
            started.filter(|&role| role == Participant::Gateway).map(Role::from).collect()
        };
        let mut certificates =
            Self { folder: folder.to_path_buf(), host, robot: String::new(), until_s: i64::MAX };
        let mut first: Option<(Role, Vec<u8>)> = None;
        for role in needed {
            let credentials = certificates.of(role);
            let certificate = credentials.check(role, now_s)?;
            let file = credentials.file(AUTHORITY_FILE);
            let authority = fs::read(&file).map_err(|source| AccessError::File { file, source })?;
            let mixed = |host, found: &str, expected: &str| PresentError::Mixed {
                role: role.name(),
                found: found.to_owned(),
                host,
                expected: expected.to_owned(),
            };
            match &first {
                None => {
                    certificates.robot.clone_from(&certificate.robot);
                    first = Some((role, authority));
                }
                Some((host, _)) if certificate.robot != certificates.robot => {
                    return Err(mixed(
                        *host,
                        &format!("robot {}", certificate.robot),
                        &format!("robot {}", certificates.robot),
                    ));
                }
                Some((host, other)) if *other != authority => {
                    return Err(mixed(*host, "one authority", "another"));
                }
                Some(_) => {}
            }
            certificates.until_s = certificates.until_s.min(certificate.until_s);
            if role == host {
                covers(&certificate, "network.listen", &graph.network.listen)?;
            } else if role == Role::Gateway {
                covers(&certificate, "telemetry.listen", &graph.telemetry.listen)?;
            }
        }
        Ok(certificates)
    }

    /// Credentials of `role`.
    pub fn of(&self, role: Role) -> Credentials {
        Credentials::in_folder(self.folder.join(role.name()))
    }

    /// Credentials of the launch itself.
    pub fn of_host(&self) -> Credentials {
        self.of(self.host)
    }

    /// The directory.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// End of the validity of the certificate that expires first: Unix time \[s\].
    pub fn until_s(&self) -> i64 {
        self.until_s
    }
}

impl std::fmt::Display for Certificates {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { folder, robot, until_s, .. } = self;
        write!(
            f,
            "certificates of robot {robot} in {}, valid until {}",
            folder.display(),
            told(*until_s)
        )
    }
}

/// Role of the launch on the network: with the robot, or without it.
fn host_of(graph: &Graph) -> Role {
    if graph.processes.plant.enabled { Role::RobotHost } else { Role::ControlHost }
}

/// Fails unless the certificate is valid for the addresses of all `endpoints`.
fn covers(
    certificate: &Certificate,
    key: &'static str,
    endpoints: &[String],
) -> Result<(), PresentError> {
    for endpoint in endpoints {
        let host = host_in(endpoint);
        // Peers connect to another address than a wildcard, and it is not known here.
        if !is_any(host) && !certificate.covers(host) {
            return Err(PresentError::Address {
                role: certificate.role.name(),
                addresses: certificate.addresses.clone(),
                key,
                endpoint: endpoint.clone(),
                host: host.to_owned(),
            });
        }
    }
    Ok(())
}
