//! A folder of certificates → what each process of a launch shows, checked before anything starts.

use super::{told, unix_s};
use crate::graph::Graph;
use crate::role::START_ORDER;
use protocol::access::{
    AUTHORITY_FILE, AccessError, Certificate, Credentials, Role, host_in, is_any,
};
use protocol::message::Participant;
use protocol::port::Carrier;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Where the certificates are: the table `[certificates]` of a graph file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificatesTable {
    /// Folder with one folder per role, as `deploy/certificates` makes it; relative to the graph file.
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

/// The certificates of a launch cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PresentError {
    /// One of them cannot be used by itself.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// They do not belong together.
    #[error("the certificate of {role} is of {found}, that of {} of {expected}: make all of them together", host.name())]
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
    /// Nobody could connect to it there.
    #[error(
        "the certificate of {role} is for {}, and {key} is {endpoint}: make certificates with --address {host}",
        addresses.join(", ")
    )]
    Address {
        /// Whose certificate.
        role: &'static str,
        /// Where it may be connected to.
        addresses: Vec<String>,
        /// Where the graph file says it, as a dotted path.
        key: &'static str,
        /// Where it is to be connected to.
        endpoint: String,
        /// Name or address in it.
        host: String,
    },
}

impl Certificates {
    /// Checks the certificates in `folder` that a launch of `graph` needs: of itself and of each process that speaks over the network.
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
            // Only what the gateway shows leaves the machine.
            started.filter(|&role| role == Participant::Gateway).map(Role::from).collect()
        };
        let mut certificates =
            Self { folder: folder.to_path_buf(), host, robot: String::new(), until_s: i64::MAX };
        let mut first: Option<(Role, Vec<u8>)> = None;
        for role in needed {
            let credentials = certificates.of(role);
            let said = credentials.check(role, now_s)?;
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
                    certificates.robot.clone_from(&said.robot);
                    first = Some((role, authority));
                }
                Some((host, _)) if said.robot != certificates.robot => {
                    return Err(mixed(
                        *host,
                        &format!("robot {}", said.robot),
                        &format!("robot {}", certificates.robot),
                    ));
                }
                Some((host, other)) if *other != authority => {
                    return Err(mixed(*host, "one authority", "another"));
                }
                Some(_) => {}
            }
            certificates.until_s = certificates.until_s.min(said.until_s);
            if role == host {
                covers(&said, "network.listen", &graph.network.listen)?;
            } else if role == Role::Gateway {
                covers(&said, "telemetry.listen", &graph.telemetry.listen)?;
            }
        }
        Ok(certificates)
    }

    /// What `role` shows.
    pub fn of(&self, role: Role) -> Credentials {
        Credentials::in_folder(self.folder.join(role.name()))
    }

    /// What the launch itself shows.
    pub fn of_host(&self) -> Credentials {
        self.of(self.host)
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Until when the first of them is valid: Unix time \[s\].
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

/// As whom the launch joins others: with the robot, or without it.
fn host_of(graph: &Graph) -> Role {
    if graph.processes.plant.enabled { Role::RobotHost } else { Role::ControlHost }
}

/// Fails unless whoever shows the certificate may be connected to at each of `endpoints`.
fn covers(
    certificate: &Certificate,
    key: &'static str,
    endpoints: &[String],
) -> Result<(), PresentError> {
    for endpoint in endpoints {
        let host = host_in(endpoint);
        // Whoever connects there has another name for it, which is not known here.
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
