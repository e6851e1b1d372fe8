//! Who may connect from another machine, and the certificates that authenticate it.
//!
//! A certificate names role and robot in its subject, as `control-host.mecanum`:
//!
//! | role        | held by                              | may                                 |
//! |-------------|--------------------------------------|-------------------------------------|
//! | `NAME-host` | the machine `NAME` of the graph file | publish the topics of its processes |
//! | `driver`    | a robot's driver outside the graph   | publish the topics of the plant     |
//! | `watcher`   | a machine that reads telemetry       | subscribe to the gateway            |
//! | `operator`  | a person's machine                   | give goals; stop, resume and arm    |
//! | `planner`   | a program on any machine             | give goals                          |
//!
//! What the processes of a machine publish follows from the graph file; the receiving bridge checks
//! each message against it. Only hosts have a certificate to which other processes may connect.

mod certificate;
mod credentials;
mod endpoint;
mod role;
mod rules;
mod writers;

pub use certificate::{Certificate, valid_until};
pub use credentials::{AUTHORITY_FILE, AccessError, CERTIFICATE_FILE, Credentials, KEY_FILE};
pub use endpoint::{from_here, host_in, is_any};
pub use role::{CLIENTS, Role};
pub use writers::{Changeable, changeable, replaceable};

pub use rules::{of_bridge, of_meeting_point, of_open_telemetry, of_requests, of_telemetry};
