//! The topics that each role may publish and read on the network, and the certificates that
//! authenticate a role.
//!
//! | role           | publishes                       | reads                                     |
//! |----------------|---------------------------------|-------------------------------------------|
//! | `robot`        | state, truth, health            | command, credit                           |
//! | `controller`   | command, residual, plan, health | state, snapshot                           |
//! | `learner`      | snapshot, health                | residual                                  |
//! | `recorder`     | credit, health                  | all but credit                            |
//! | `gateway`      | health                          | all but command and credit                |
//! | `watcher`      | –                               | – (the gateway's telemetry alone)         |
//! | `robot-host`   | state, truth, credit, health    | command, residual, snapshot, plan, health |
//! | `control-host` | all but state and truth         | all but command and credit                |
//!
//! A role that publishes a topic is its writer, and may do all that `WIRE.md` lets a writer do. A
//! role that reads a topic is its reader. Everything else is refused where it arrives. The two
//! hosts are the routers of launches, one on the robot's machine and one on the controller's.
//! Traffic between two machines passes under the names of the hosts. So the host of the controller
//! never publishes a state, and that of the robot never a command. A certificate names role and
//! robot in its subject, as `controller.mecanum`. Only hosts and gateways have a certificate to
//! which other processes may connect.

mod certificate;
mod credentials;
mod endpoint;
mod role;
mod rules;
mod writers;

pub use certificate::{Certificate, valid_until};
pub use credentials::{AUTHORITY_FILE, AccessError, CERTIFICATE_FILE, Credentials, KEY_FILE};
pub use endpoint::{from_here, host_in, is_any};
pub use role::Role;
pub use writers::{Changeable, changeable, replaceable};

pub use rules::{TESTER, gaps, of_client, of_links, of_telemetry, of_watcher, qualities};
