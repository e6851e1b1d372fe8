//! Self-test of a gateway: whether it refuses every peer that is no watcher, before it is used.

use super::Publisher;
use super::session::connect;
use crate::reason::first_line;
use crate::{Breach, keeps_strangers_out};
use access::{Credentials, from_here};
use protocol::message::Health;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};
use zenoh::Wait;

/// How often a test value is published to a peer that must not receive it. The peer listens so long
/// each time. A permitted peer receives the first of them.
const TIMES: usize = 10;
const LISTENS_FOR: Duration = Duration::from_millis(100);
/// How long the test tries to connect.
const CONNECTS_WITHIN: Duration = Duration::from_secs(10);
/// Pause between two attempts.
const TRIES_AGAIN_AFTER: Duration = Duration::from_millis(50);

impl Publisher {
    /// Tries to watch at every endpoint of the gateway: over TCP, without a certificate, and in the
    /// role of `credentials`, which is no watcher's. Meanwhile `health` is published.
    ///
    /// # Errors
    /// The first [`Breach`].
    pub fn self_test(&mut self, credentials: &Credentials, health: &Health) -> Result<(), Breach> {
        for endpoint in self.endpoints().to_vec() {
            self.is_silent_at(from_here(&endpoint), credentials, health)?;
        }
        Ok(())
    }

    fn is_silent_at(
        &mut self,
        endpoint: String,
        credentials: &Credentials,
        health: &Health,
    ) -> Result<(), Breach> {
        let unknown = |reason: String| Breach::Unknown { endpoint: endpoint.clone(), reason };
        keeps_strangers_out(&endpoint, credentials)?;
        let role = credentials.read().map_err(|error| unknown(error.to_string()))?.role;
        let deadline = Instant::now() + CONNECTS_WITHIN;
        let session = loop {
            match connect(&endpoint, Some(credentials)) {
                Ok(session) => break session,
                // After each refused peer, the gateway accepts no connection for a tenth of a
                // second.
                Err(_) if Instant::now() < deadline => thread::sleep(TRIES_AGAIN_AFTER),
                Err(error) => return Err(unknown(error.to_string())),
            }
        };
        let (tell, received) = channel();
        // The subscription ends after the first value.
        let subscriber = session
            .declare_subscriber("coxswain/**")
            .callback(move |_| tell.send(()).unwrap_or_default());
        let _subscriber = subscriber.wait().map_err(|error| unknown(first_line(&error)))?;
        for _ in 0..TIMES {
            self.publish(health).map_err(|error| unknown(error.to_string()))?;
            match received.recv_timeout(LISTENS_FOR) {
                Ok(()) => return Err(Breach::NoWatcher { endpoint, role: role.to_string() }),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(unknown("the session has ended".to_owned()));
                }
            }
        }
        Ok(())
    }
}
