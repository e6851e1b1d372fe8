//! gateway → anyone: what the robot does, over zenoh, to be looked at and not touched.
//!
//! | key                              | value                                                        |
//! |----------------------------------|--------------------------------------------------------------|
//! | `coxswain/<robot>/<topic>`       | the message, in the encoding of `WIRE.md`                    |
//! | `coxswain/<robot>/<topic>/json`  | the same as one JSON object, see [`view`](crate::view)       |
//!
//! Each value has an attachment of 8 bytes: the control period \[ns\], little-endian. Discovery is off: whoever wants to watch names an
//! endpoint. The publishing session takes nothing in: what a stranger puts on any key is dropped where it arrives.
//!
//! ```
//! use protocol::message::{Message, PlantState};
//! use protocol::telemetry::{Heard, Publisher, TelemetrySettings, Watcher};
//! use std::time::Duration;
//!
//! let settings = TelemetrySettings { listen: vec!["tcp/127.0.0.1:0".into()], robot: "mecanum".into(), credentials: None };
//! let mut publisher = Publisher::open(&settings, 100_000_000)?;
//! let mut watcher = Watcher::open(&publisher.endpoints()[0], Some("mecanum"))?;
//!
//! let mut state: PlantState = bytemuck::Zeroable::zeroed();
//! (state.stamp.version, state.stamp.kind) = (protocol::VERSION, PlantState::KIND);
//! let heard = loop {
//!     publisher.publish(&state)?;
//!     if let Some(word) = watcher.next(Duration::from_millis(50))? {
//!         break word;
//!     }
//! };
//! assert_eq!((heard.robot.as_str(), heard.period_nanos), ("mecanum", 100_000_000));
//! assert!(matches!(heard.said, Heard::State(state) if state.stamp.kind == PlantState::KIND));
//! # Ok::<(), protocol::telemetry::TelemetryError>(())
//! ```

mod publisher;
mod self_test;
mod session;
mod watcher;

pub use publisher::Publisher;
pub use watcher::{Heard, Watcher, Word};

use crate::access::Credentials;
use crate::frame::DecodeError;
use crate::message::Message;
use crate::wire;
use serde::{Deserialize, Serialize};

/// Where a gateway listens if nobody says otherwise.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7448";

/// Longest name of a robot \[bytes\].
pub const ROBOT_NAME_MAX: usize = 32;

/// How a robot can be watched.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TelemetrySettings {
    /// Endpoints to listen on, as `tcp/127.0.0.1:7448`. Port 0 is any free one.
    pub listen: Vec<String>,
    /// Name of the robot in the keys: 1 to 32 of `a`–`z`, `0`–`9`, `_` and `-`.
    pub robot: String,
    /// Certificate of the gateway: with it only watchers with one of the same robot and authority hear anything. The launcher says it.
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

/// A robot cannot be watched, or not be shown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TelemetryError {
    /// It would not do as a part of a key.
    #[error(
        "robot name {robot:?} must be 1 to {ROBOT_NAME_MAX} characters out of a-z, 0-9, _ and -"
    )]
    Robot {
        /// The name.
        robot: String,
    },
    /// Not an endpoint at all.
    #[error("endpoint {endpoint:?} is none, expected one like {DEFAULT_ENDPOINT}: {reason}")]
    Endpoint {
        /// What was said.
        endpoint: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Another process may listen there.
    #[error("{endpoints} cannot be listened on: {reason}")]
    Listen {
        /// The endpoints.
        endpoints: String,
        /// What zenoh or the system said.
        reason: String,
    },
    /// The certificate is of no use.
    #[error("{reason}")]
    Credentials {
        /// What is wrong with it.
        reason: String,
    },
    /// Nobody answers.
    #[error("nothing to watch at {endpoint}: {reason}")]
    Connect {
        /// The endpoint.
        endpoint: String,
        /// What zenoh said.
        reason: String,
    },
    /// The session has failed.
    #[error("the telemetry session has failed: {reason}")]
    Session {
        /// What zenoh said.
        reason: String,
    },
}

/// The message as it travels to watchers.
fn encoded<T: Message>(message: &T, bytes: &mut Vec<u8>) {
    wire::encode(message, bytes);
}

/// The message that a watcher was sent.
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
