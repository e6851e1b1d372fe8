//! The gateway's end: one pair of keys per topic.

use super::session::listen;
use super::{TelemetryError, TelemetrySettings, encoded};
use crate::reason::first_line;
use protocol::topic::{OnTopic, Topic};
use protocol::view::View;
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Session, Wait};

type ZenohPublisher = zenoh::pubsub::Publisher<'static>;

/// Publishes what a robot does to every connected watcher. Receives no data.
pub struct Publisher {
    /// Two for each topic: bytes, JSON.
    publishers: Vec<(ZenohPublisher, ZenohPublisher)>,
    endpoints: Vec<String>,
    period: [u8; size_of::<u64>()],
    bytes: Vec<u8>,
    session: Session,
}

impl Publisher {
    /// Listens for watchers of the robot, whose control period is `period_nanos` \[ns\].
    ///
    /// # Errors
    /// [`TelemetryError`] if the settings are not well-formed or an endpoint is not available.
    pub fn open(settings: &TelemetrySettings, period_nanos: u64) -> Result<Self, TelemetryError> {
        settings.check()?;
        let (session, endpoints) = listen(settings)?;
        let publisher = |key: String, encoding| {
            let declared = session.declare_publisher(key).encoding(encoding);
            let declared =
                declared.congestion_control(CongestionControl::Drop).priority(Priority::DataLow);
            declared.wait().map_err(|error| TelemetryError::Session { reason: first_line(&error) })
        };
        let publishers = |topic: Topic| {
            let key = format!("coxswain/{}/{}", settings.robot, topic.name());
            Ok((
                publisher(key.clone(), Encoding::APPLICATION_OCTET_STREAM)?,
                publisher(key + "/json", Encoding::APPLICATION_JSON)?,
            ))
        };
        let publishers = Topic::ALL.into_iter().map(publishers).collect::<Result<_, _>>()?;
        Ok(Self {
            publishers,
            endpoints,
            period: period_nanos.to_le_bytes(),
            bytes: Vec::new(),
            session,
        })
    }

    /// The endpoints where it listens, with the actual ports.
    pub fn endpoints(&self) -> &[String] {
        &self.endpoints
    }

    /// Publishes one message to the watchers of its topic. A watcher without room misses it. A
    /// topic without watchers costs no encoding.
    ///
    /// # Errors
    /// [`TelemetryError::Session`].
    pub fn publish<T: OnTopic>(&mut self, message: &T) -> Result<(), TelemetryError> {
        let failed = |error: zenoh::Error| TelemetryError::Session { reason: first_line(&error) };
        let Some((binary, json)) = self.publishers.get(T::TOPIC.index()) else { return Ok(()) };
        if is_watched(binary)? {
            encoded(message, &mut self.bytes);
            binary.put(self.bytes.as_slice()).attachment(self.period).wait().map_err(failed)?;
        }
        if is_watched(json)? {
            self.bytes.clear();
            let written = serde_json::to_writer(&mut self.bytes, &View(message));
            written.map_err(|error| TelemetryError::Session { reason: error.to_string() })?;
            json.put(self.bytes.as_slice()).attachment(self.period).wait().map_err(failed)?;
        }
        Ok(())
    }

    /// Closes the session, which ends the sessions of all watchers.
    ///
    /// # Errors
    /// [`TelemetryError::Session`].
    pub fn close(self) -> Result<(), TelemetryError> {
        self.session
            .close()
            .wait()
            .map_err(|error| TelemetryError::Session { reason: first_line(&error) })
    }
}

fn is_watched(publisher: &ZenohPublisher) -> Result<bool, TelemetryError> {
    let status = publisher.matching_status().wait();
    status
        .map(|status| status.matching())
        .map_err(|error| TelemetryError::Session { reason: first_line(&error) })
}
