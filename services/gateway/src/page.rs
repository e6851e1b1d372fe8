//! messages → browsers: the live page, served at one address, and its events.
//!
//! | module    | what it holds                                                               |
//! |-----------|-----------------------------------------------------------------------------|
//! | `feed`    | events for an open page: first the present state, then the news             |
//! | `rows`    | one row per period, and the last minute of them                             |
//! | `horizon` | the predicted path, and its uncertainty                                     |
//! | `logbook` | events as lines                                                             |
//! | `viewers` | a short queue for each open page                                            |
//! | `server`  | the threads that listen and write                                           |
//! | `request` | the request of a browser, or the reason for its refusal                     |
//! | `answer`  | the answer: the page (`index.html`, `style.css`, scripts), events, refusals |
//! | `stop`    | the stop button, the only part of a page that acts                          |
//!
//! A page can send the requests for itself and for its events. On the robot's own machine it can
//! also request a stop. Everything else is refused. The gateway waits for no viewer: it puts each
//! event into their queues. A viewer that falls behind receives the present state again.

mod answer;
mod feed;
mod horizon;
mod logbook;
mod request;
mod rows;
mod server;
mod stop;
#[cfg(test)]
mod tests;
mod viewers;

pub(crate) use feed::Feed;

use crate::comparison;
use crate::settings::Settings;
use process::Pace;
use server::Server;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

/// Shortest time between two events.
const INTERVAL: Duration = Duration::from_millis(40);

/// The page cannot be served.
#[derive(Debug, thiserror::Error)]
#[error("the live page cannot be served at {address}: {source}")]
pub struct PageError {
    /// The requested address.
    address: SocketAddr,
    /// Error of the system.
    source: io::Error,
}

/// Parses the request `bytes` of a browser to a page at the address `listening`. Returns
/// `"document"`, `"events"` or `"stop"`.
///
/// # Errors
/// Status line of the refusal.
pub fn asked(mut bytes: &[u8], listening: IpAddr) -> Result<&'static str, &'static str> {
    match request::read(&mut bytes, listening) {
        Ok(request::Asked::Document) => Ok("document"),
        Ok(request::Asked::Events) => Ok("events"),
        Ok(request::Asked::Stop { .. }) => Ok("stop"),
        Err(refusal) => Err(refusal.status()),
    }
}

/// The live page.
#[derive(Debug)]
pub(crate) struct Page {
    feed: Feed,
    server: Server,
    next: Instant,
}

impl Page {
    /// Serves the page at `before` if possible, else at the address in `settings`. Returns `None`
    /// if the settings turn the page off.
    pub(crate) fn open(
        settings: &Settings,
        before: Option<SocketAddr>,
    ) -> Result<Option<Self>, PageError> {
        let Ok(Some(address)) = settings.page.address() else { return Ok(None) };
        let run = &settings.run;
        // In lock step the gate takes no orders.
        let takes_orders = settings.has_plant && run.pace == Pace::RealTime;
        let stops = takes_orders.then_some(run.folder.as_path());
        let again = before.and_then(|before| Server::open(before, stops).ok());
        let server = again
            .map_or_else(|| Server::open(address, stops), Ok)
            .map_err(|source| PageError { address, source })?;
        let without = settings
            .about
            .without_learning
            .as_deref()
            .map(comparison::read)
            .transpose()
            .unwrap_or_else(|error| {
                tracing::warn!(%error, "the run without learning cannot be shown");
                None
            });
        Ok(Some(Self {
            feed: Feed::new(settings, without.unwrap_or_default()),
            server,
            next: Instant::now(),
        }))
    }

    /// The served address, with the actual port.
    pub(crate) fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// The feed, which receives the messages.
    pub(crate) fn feed(&mut self) -> &mut Feed {
        &mut self.feed
    }

    /// Sends the news to all open pages, if it is time. Never waits.
    pub(crate) fn turn(&mut self, now: Instant) {
        if now < self.next {
            return;
        }
        self.next = now + INTERVAL;
        self.feed.look_around(now);
        let viewers = self.server.viewers();
        if viewers.is_empty() {
            self.feed.forget_news();
            return;
        }
        let news = self.feed.news(now);
        viewers.tell(news.as_ref(), || self.feed.greeting(now));
    }
}

/// Rounds to 10 µm: smaller differences are not drawn.
fn round(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}
