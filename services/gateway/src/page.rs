//! messages → browsers: the live page, served at one address, and what it draws as it happens.
//!
//! | module    | what it holds                                                                  |
//! |-----------|--------------------------------------------------------------------------------|
//! | `feed`    | what an open page is told: how things stand, then what is new                    |
//! | `rows`    | one row per period, and the last minute of them                                 |
//! | `horizon` | the predicted path, and how far it may err                                      |
//! | `logbook` | one line for everything that goes wrong or is well again                        |
//! | `viewers` | a short queue for each open page                                                |
//! | `server`  | the threads that listen and write                                               |
//! | `request` | what a browser asks for, or why it gets nothing                                 |
//! | `answer`  | what goes back: the page (`index.html`, `style.css`, the scripts), events, refusals |
//!
//! A page can only be read: it has no way to send anything but the request for itself and for its events. The gateway waits for no viewer:
//! it puts each event into their queues, and who falls behind is told anew how things stand.

mod answer;
mod feed;
mod horizon;
mod logbook;
mod request;
mod rows;
mod server;
#[cfg(test)]
mod tests;
mod viewers;

pub(crate) use feed::Feed;

use crate::comparison;
use crate::settings::Settings;
use server::Server;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

/// Pages hear something this often at most.
const INTERVAL: Duration = Duration::from_millis(40);

/// The page cannot be served.
#[derive(Debug, thiserror::Error)]
#[error("the live page cannot be served at {address}: {source}")]
pub struct PageError {
    /// Where it was to be.
    address: SocketAddr,
    /// What the system said.
    source: io::Error,
}

/// What a browser asks for that sends `bytes` to a page at the address `listening`: `"document"` or `"events"`.
///
/// # Errors
/// Status line of the refusal.
pub fn asked(mut bytes: &[u8], listening: IpAddr) -> Result<&'static str, &'static str> {
    match request::read(&mut bytes, listening) {
        Ok(request::Asked::Document) => Ok("document"),
        Ok(request::Asked::Events) => Ok("events"),
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
    /// Serves the page at `before`, if that is possible, else where `settings` say; nothing if there shall be none.
    pub(crate) fn open(
        settings: &Settings,
        before: Option<SocketAddr>,
    ) -> Result<Option<Self>, PageError> {
        let Ok(Some(address)) = settings.page.address() else { return Ok(None) };
        let again = before.and_then(|before| Server::open(before).ok());
        let server = again
            .map_or_else(|| Server::open(address), Ok)
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

    /// Where it is served, with the true port.
    pub(crate) fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Whom to tell what was heard.
    pub(crate) fn feed(&mut self) -> &mut Feed {
        &mut self.feed
    }

    /// Tells all open pages what is new, if it is time. Waits for nobody.
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

/// Tenths of a millimetre and below are not drawn: 10 µm.
fn round(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}
