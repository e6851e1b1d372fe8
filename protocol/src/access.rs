//! Who may say and hear what on the network, and the certificates by which it is known who somebody is.
//!
//! | role           | says                                            | hears                                                 |
//! |----------------|-------------------------------------------------|-------------------------------------------------------|
//! | `robot`        | state, truth, health                            | command, credit                                       |
//! | `controller`   | command, residual, plan, health                 | state, snapshot                                       |
//! | `learner`      | snapshot, health                                | residual                                              |
//! | `recorder`     | credit, health                                  | state, command, residual, snapshot, plan, health, truth |
//! | `gateway`      | health                                          | state, residual, snapshot, plan, health, truth        |
//! | `watcher`      | –                                               | – (the gateway's telemetry alone)                     |
//! | `robot-host`   | state, truth, credit, health                    | command, residual, snapshot, plan, health             |
//! | `control-host` | command, residual, snapshot, plan, credit, health | state, residual, snapshot, plan, health, truth      |
//!
//! Who says a topic is its writer, with all that `WIRE.md` lets a writer do; who hears it, its reader. Everything else is refused where it
//! arrives. The two hosts are the routers of launches, one on the robot's machine and one on the controller's: what passes between two
//! machines passes in their names, so that the one never says a state, and the other never a command. A certificate names role and robot in
//! its subject, as `controller.mecanum`; only hosts and gateways have one that others may connect to.

mod certificate;
mod credentials;
mod endpoint;
mod role;
mod rules;
mod strangers;
mod tls;
mod writers;

pub use certificate::{Certificate, valid_until};
pub use credentials::{AUTHORITY_FILE, AccessError, CERTIFICATE_FILE, Credentials, KEY_FILE};
pub use endpoint::{from_here, host_in, is_any};
pub use role::Role;
pub use rules::of_telemetry;
pub use strangers::Breach;
pub use writers::{Changeable, changeable, replaceable};

pub(crate) use rules::{TESTER, gaps, of_client, of_links, of_watcher, qualities};
pub(crate) use strangers::{ATTEMPT_MILLIS, keeps_strangers_out};
pub(crate) use tls::{guarded, over_tls};
