//! Where the processes of a graph meet on the network.

use super::config;
use crate::port::OpenError;
use std::net::TcpListener;
use zenoh::{Session, Wait};

/// A free port that somebody else takes first is drawn again so often.
const DRAWS: u32 = 20;

/// A router: the processes of one launch connect to it, and routers of other launches join. It ends when it is dropped.
pub struct Router {
    /// Held until the end.
    _session: Session,
    endpoints: Vec<String>,
}

impl Router {
    /// Listens at `listen`, as `tcp/0.0.0.0:7447`, where port 0 stands for any free one, and joins the routers at `connect`.
    ///
    /// Joining is tried for ever in the background, also after a cut; opening does not wait for it.
    ///
    /// # Errors
    /// [`OpenError::Router`] if it cannot listen, or an endpoint is not one.
    pub fn open(listen: &[String], connect: &[String]) -> Result<Self, OpenError> {
        let draws = listen.iter().any(|endpoint| endpoint.ends_with(":0"));
        let mut attempt = 1;
        loop {
            let endpoints = listen.iter().map(|endpoint| with_port(endpoint)).collect::<Result<Vec<_>, _>>()?;
            let failed = |error: zenoh::Error| OpenError::Router { endpoints: endpoints.join(", "), reason: error.to_string() };
            let config = config::router(&endpoints, connect).map_err(failed)?;
            match zenoh::open(config).wait() {
                Ok(session) => return Ok(Self { _session: session, endpoints }),
                Err(_) if draws && attempt < DRAWS => attempt += 1,
                Err(error) => return Err(failed(error)),
            }
        }
    }

    /// Where it listens, with the ports that were drawn.
    pub fn endpoints(&self) -> &[String] {
        &self.endpoints
    }
}

/// `endpoint` with a free port in place of port 0. zenoh would take one too, but not say which.
fn with_port(endpoint: &str) -> Result<String, OpenError> {
    let Some(host) = endpoint.strip_suffix(":0") else {
        return Ok(endpoint.to_owned());
    };
    let failed = |reason: String| OpenError::Router { endpoints: endpoint.to_owned(), reason };
    let address = host.strip_prefix("tcp/").ok_or_else(|| failed("only tcp has ports to draw from".to_owned()))?;
    let listener = TcpListener::bind(format!("{address}:0")).map_err(|error| failed(error.to_string()))?;
    let port = listener.local_addr().map_err(|error| failed(error.to_string()))?.port();
    Ok(format!("{host}:{port}"))
}
