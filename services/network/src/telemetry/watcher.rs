//! A watcher's end.

use super::session::connect;
use super::{TelemetryError, check_robot, decoded};
use crate::reason::first_line;
use crate::threads::Client;
use access::Credentials;
use protocol::frame::DecodeError;
use protocol::message::{Goal, Health, Obstacles, Plan, PlantState};
use protocol::topic::Topic;
use std::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

/// Most values that wait to be read; the oldest are dropped.
const WAITING_MAX: usize = 64;

/// A received message.
#[derive(Debug, Clone, PartialEq)]
pub enum TelemetryMessage {
    /// What the sensors measured, and what the gate did.
    State(Box<PlantState>),
    /// The controller's plan.
    Plan(Box<Plan>),
    /// The condition of one process.
    Health(Box<Health>),
    /// The present goal.
    Goal(Box<Goal>),
    /// The obstacles that one source knows.
    Obstacles(Box<Obstacles>),
}

/// A received message, and its robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Telemetry {
    /// Name of the robot.
    pub robot: String,
    /// Its control period \[ns\]; 0 if it is not known.
    pub period_nanos: u64,
    /// The message.
    pub message: TelemetryMessage,
}

/// Receives states, plans, health, goals and obstacles of the robots at one endpoint.
pub struct Watcher {
    samples: Subscriber<RingChannelHandler<Sample>>,
    session: Client,
    refused: u64,
}

impl Watcher {
    /// Connects to the gateway at `endpoint`. Without a name it watches every robot there.
    ///
    /// # Errors
    /// [`TelemetryError`], within a few seconds, if no gateway answers.
    pub fn open(endpoint: &str, robot: Option<&str>) -> Result<Self, TelemetryError> {
        Self::open_as(endpoint, robot, None)
    }

    /// The same over TLS, if there is a certificate to show: that of a watcher, of the robot and
    /// authority of the gateway.
    ///
    /// # Errors
    /// As for [`open`](Self::open), also if the certificate cannot be read or is not trusted.
    pub fn open_as(
        endpoint: &str,
        robot: Option<&str>,
        credentials: Option<&Credentials>,
    ) -> Result<Self, TelemetryError> {
        robot.map_or(Ok(()), check_robot)?;
        let session = connect(endpoint, credentials)?;
        let samples = session
            .declare_subscriber(format!("coxswain/{}/*", robot.unwrap_or("*")))
            .with(RingChannel::new(WAITING_MAX))
            .wait();
        let samples =
            samples.map_err(|error| TelemetryError::Session { reason: first_line(&error) })?;
        Ok(Self { samples, session, refused: 0 })
    }

    /// The next message, if one arrives within `timeout`. A value that is no valid message is
    /// skipped and counted.
    ///
    /// # Errors
    /// [`TelemetryError::Session`] if the session has ended.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Telemetry>, TelemetryError> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let sample = self.samples.recv_timeout(left);
            let sample =
                sample.map_err(|error| TelemetryError::Session { reason: first_line(&error) })?;
            let Some(sample) = sample else { return Ok(None) };
            match received(&sample) {
                Ok(Some(telemetry)) => return Ok(Some(telemetry)),
                Ok(None) => {}
                Err(_) => self.refused += 1,
            }
        }
    }

    /// Whether the gateway is still connected.
    pub fn is_connected(&self) -> bool {
        self.session.info().routers_zid().wait().next().is_some()
    }

    /// Values that were no valid message.
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

/// The message in a sample; none if its topic is not watched.
fn received(sample: &Sample) -> Result<Option<Telemetry>, DecodeError> {
    let key = sample.key_expr().as_str();
    let Some((robot, topic)) = key.strip_prefix("coxswain/").and_then(|rest| rest.split_once('/'))
    else {
        return Ok(None);
    };
    let bytes = sample.payload().to_bytes();
    let message = match Topic::ALL.into_iter().find(|known| known.name() == topic) {
        Some(Topic::State) => TelemetryMessage::State(Box::new(decoded(&bytes)?)),
        Some(Topic::Plan) => TelemetryMessage::Plan(Box::new(decoded(&bytes)?)),
        Some(Topic::Health) => TelemetryMessage::Health(Box::new(decoded(&bytes)?)),
        Some(Topic::Goal) => TelemetryMessage::Goal(Box::new(decoded(&bytes)?)),
        Some(Topic::Obstacles) => TelemetryMessage::Obstacles(Box::new(decoded(&bytes)?)),
        _ => return Ok(None),
    };
    let period =
        sample.attachment().and_then(|period| <[u8; 8]>::try_from(period.to_bytes().as_ref()).ok());
    Ok(Some(Telemetry {
        robot: robot.to_owned(),
        period_nanos: period.map_or(0, u64::from_le_bytes),
        message,
    }))
}
