//! gateway → anyone: the robot's state over zenoh, read-only.
//!
//! | key                             | value                                                     |
//! |---------------------------------|-----------------------------------------------------------|
//! | `coxswain/<robot>/<topic>`      | the message, in the encoding of `WIRE.md`                 |
//! | `coxswain/<robot>/<topic>/json` | the same as one JSON object, see [`view`](protocol::view) |
//!
//! Each value has an attachment of 8 bytes: the control period \[ns\], little-endian. Discovery is
//! off: a watcher names an endpoint to connect to. The publishing session receives no data: a value
//! that a peer puts on any key is dropped where it arrives.
//!
//! ```
//! use protocol::message::{Message, PlantState};
//! use network::telemetry::{Publisher, TelemetryMessage, TelemetrySettings, Watcher};
//! use std::time::Duration;
//!
//! let settings = TelemetrySettings {
//!     listen: vec!["tcp/127.0.0.1:0".into()],
//!     robot: "mecanum".into(),
//!     credentials: None,
//! };
//! let mut publisher = Publisher::open(&settings, 100_000_000)?;
//! let mut watcher = Watcher::open(&publisher.endpoints()[0], Some("mecanum"))?;
//!
//! let mut state: PlantState = bytemuck::Zeroable::zeroed();
//! (state.stamp.version, state.stamp.kind) = (protocol::VERSION, PlantState::KIND);
//! let received = loop {
//!     publisher.publish(&state)?;
//!     if let Some(telemetry) = watcher.next(Duration::from_millis(50))? {
//!         break telemetry;
//!     }
//! };
//! assert_eq!((received.robot.as_str(), received.period_nanos), ("mecanum", 100_000_000));
//! let TelemetryMessage::State(state) = received.message else { panic!("a state was sent") };
//! assert_eq!(state.stamp.kind, PlantState::KIND);
//! # Ok::<(), network::telemetry::TelemetryError>(())
//! ```

mod publisher;
mod self_test;
mod session;
mod watcher;

pub use publisher::Publisher;
pub use watcher::{Telemetry, TelemetryMessage, Watcher};

use access::Credentials;
use protocol::frame::DecodeError;
use protocol::message::Message;
use protocol::wire;
use serde::{Deserialize, Serialize};

/// Endpoint of a gateway without other settings.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7448";

/// Longest name of a robot \[bytes\].
pub const ROBOT_NAME_MAX: usize = 32;

/// Settings of a robot's telemetry.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TelemetrySettings {
    /// Endpoints to listen on, as `tcp/127.0.0.1:7448`. Port 0 is any free one.
    pub listen: Vec<String>,
    /// Name of the robot in the keys: 1 to 32 of `a`–`z`, `0`–`9`, `_` and `-`.
    pub robot: String,
    /// Certificate of the gateway. With it, only watchers with a certificate of the same robot and
    /// authority receive anything. The launcher sets it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub credentials: Option<Credentials>,
}

impl Default for TelemetrySettings {
    fn default() -> Self {
        Self {
            listen: vec![DEFAULT_ENDPOINT.to_owned()],
            robot: "robot".to_owned(),
            credentials: None,
        }
    }
}

impl TelemetrySettings {
    /// Fails unless robot and endpoints are well-formed. Touches nothing.
    ///
    /// # Errors
    /// [`TelemetryError::Robot`] or [`TelemetryError::Endpoint`].
    pub fn check(&self) -> Result<(), TelemetryError> {
        check_robot(&self.robot)?;
        if self.listen.is_empty() {
            return Err(TelemetryError::Endpoint {
                endpoint: String::new(),
                reason: "there must be at least one".to_owned(),
            });
        }
        self.listen.iter().try_for_each(|endpoint| session::check_endpoint(endpoint))
    }
}

/// An error of the telemetry: on the gateway's side or on a watcher's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TelemetryError {
    /// The name cannot be a part of a key.
    #[error(
        "robot name {robot:?} must be 1 to {ROBOT_NAME_MAX} characters out of a-z, 0-9, _ and -"
    )]
    Robot {
        /// The name.
        robot: String,
    },
    /// The text is not an endpoint.
    #[error("endpoint {endpoint:?} is none, expected one like {DEFAULT_ENDPOINT}: {reason}")]
    Endpoint {
        /// The text.
        endpoint: String,
        /// The reason.
        reason: String,
    },
    /// Another process may listen there.
    #[error("{endpoints} cannot be listened on: {reason}")]
    Listen {
        /// The endpoints.
        endpoints: String,
        /// Error of zenoh or of the system.
        reason: String,
    },
    /// The certificate cannot be used.
    #[error("{reason}")]
    Credentials {
        /// The reason.
        reason: String,
    },
    /// No gateway answers.
    #[error("nothing to watch at {endpoint}: {reason}")]
    Connect {
        /// The endpoint.
        endpoint: String,
        /// Error of zenoh.
        reason: String,
    },
    /// The session has failed.
    #[error("the telemetry session has failed: {reason}")]
    Session {
        /// Error of zenoh.
        reason: String,
    },
}

/// Encodes the message for watchers.
fn encoded<T: Message>(message: &T, bytes: &mut Vec<u8>) {
    wire::encode(message, bytes);
}

/// Decodes the message that a watcher received.
fn decoded<T: Message>(bytes: &[u8]) -> Result<T, DecodeError> {
    wire::decode(bytes)
}

fn check_robot(robot: &str) -> Result<(), TelemetryError> {
    let allowed = |byte: u8| {
        byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_' || byte == b'-'
    };
    if (1..=ROBOT_NAME_MAX).contains(&robot.len()) && robot.bytes().all(allowed) {
        Ok(())
    } else {
        Err(TelemetryError::Robot { robot: robot.to_owned() })
    }
}
