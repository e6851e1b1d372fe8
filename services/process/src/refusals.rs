//! Rejected peers and messages → one line in the log per reason, then a line with their number at
//! most every 10 s.
//!
//! zenoh logs one line for each unauthenticated peer and for each message without permission. Their
//! number, and that of commands, is up to the sender.

mod rights;

use std::collections::BTreeMap;
use std::fmt::{Debug, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Metadata};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::{FilterExt, ParseError};
use tracing_subscriber::layer::{Context, Filter};

/// Shortest time between two lines of the same reason.
const PAUSE: Duration = Duration::from_secs(10);

/// Largest number of distinct reasons in the words of others.
const OTHERS_MAX: usize = 32;

/// Target of zenoh's log for the permission of each message.
const ACCESS: &str = "zenoh::net::routing::interceptor::access_control";
/// Target for peers that it has no session for.
const DOOR: &str = "zenoh_transport::unicast::manager";
/// Target for messages that are too long, among much else.
const ARRIVALS: &str = "zenoh_transport::unicast::universal::rx";
/// Its text for a message that is too long.
const TOO_LONG: &str = "Defragmentation buffer full";
/// Target for messages above their rate limit.
const RATES: &str = "zenoh::net::routing::interceptor::downsampling";

/// Parts of zenoh's text after a reason: other causes, positions in its source code, validity times
/// of a certificate.
const ASIDES: [&str; 3] = [". Hint:", " at /", ": verification time"];

/// Texts of zenoh that precede data of an unauthenticated peer, of unlimited length.
const BY_STRANGERS: [&str; 5] = [
    "received fatal alert",
    "received corrupt message",
    "received unexpected message",
    "peer misbehaved",
    "peer is incompatible",
];

static BOOK: Mutex<Book<Reason>> = Mutex::new(Book::new());
/// Whether this process itself acts as the unauthenticated peer.
static PLAYED: AtomicBool = AtomicBool::new(false);

/// Filter of a log for `directives`. It removes zenoh's texts about rejected peers, which [`tell`]
/// summarises. If this process accepts connections, zenoh reports more of them, at its lowest
/// level.
///
/// # Errors
///
/// If `directives` are invalid.
pub fn log_filter<S>(
    directives: &str,
    serves: bool,
) -> Result<impl Filter<S> + use<S>, ParseError> {
    let more = if serves {
        format!(",{ACCESS}=trace,{DOOR}=trace,{ARRIVALS}=trace,{RATES}=trace")
    } else {
        String::new()
    };
    Ok(EnvFilter::try_new(directives.to_owned() + &more)?.and(Refusals))
}

/// Why a peer or message is rejected.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Reason {
    /// In our words: at most one per role, kind of message and topic.
    Ours(String),
    /// In zenoh's words, which depend on the data of the peer.
    Others(String),
}

/// Reason → number of rejections, and the time of its last line.
#[derive(Debug, Default)]
pub struct Book<R>(BTreeMap<R, Refused>);

#[derive(Debug, Default)]
struct Refused {
    /// Number since its last line.
    untold: u64,
    told: Option<Instant>,
}

/// Removes zenoh's texts about rejected peers from a log; [`tell`] logs them.
#[derive(Debug, Clone, Copy)]
struct Refusals;

impl<S> Filter<S> for Refusals {
    fn enabled(&self, _metadata: &Metadata<'_>, _context: &Context<'_, S>) -> bool {
        true
    }

    fn event_enabled(&self, event: &Event<'_>, _context: &Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if PLAYED.load(Ordering::Relaxed) && metadata.target().starts_with("zenoh") {
            return false;
        }
        let judge: fn(&str) -> Option<Reason> = match metadata.target() {
            ACCESS if *metadata.level() >= Level::INFO => {
                |message| rights::refused(message).map(Reason::Ours)
            }
            DOOR if *metadata.level() >= Level::INFO => {
                |message| no_room(message).map(Reason::Ours)
            }
            ARRIVALS if *metadata.level() >= Level::DEBUG => {
                |message| too_long(message).map(Reason::Ours)
            }
            RATES if *metadata.level() >= Level::INFO => {
                |message| rights::too_often(message).map(Reason::Ours)
            }
            _ if is_refusal(metadata) => |message| Some(Reason::Others(without_asides(message))),
            _ => return true,
        };
        let only = if metadata.target() == ARRIVALS { TOO_LONG } else { "" };
        let mut message = Message { only, text: String::new() };
        event.record(&mut message);
        if let Some(reason) = judge(&message.text) {
            book().note_words(reason);
        }
        false
    }
}

/// Logs the rejections since the last line: each reason at once, and then at most every ten
/// seconds. The process calls it periodically.
pub fn tell(now: Instant) {
    let due = book().due(now);
    log(&due);
}

/// Logs the rejections without a line, at the end.
pub fn tell_rest() {
    let rest = book().rest();
    log(&rest);
}

fn log(reasons: &[(Reason, u64)]) {
    for (Reason::Ours(reason) | Reason::Others(reason), count) in reasons {
        tracing::warn!(count, "rejected at the network: {reason}");
    }
}

/// Runs `play` as an unauthenticated peer, without logging its rejections.
pub fn unlogged<T>(play: impl FnOnce() -> T) -> T {
    PLAYED.store(true, Ordering::Relaxed);
    let played = play();
    PLAYED.store(false, Ordering::Relaxed);
    played
}

fn book() -> MutexGuard<'static, Book<Reason>> {
    BOOK.lock().unwrap_or_else(PoisonError::into_inner)
}

fn is_refusal(metadata: &Metadata<'_>) -> bool {
    let target = metadata.target();
    match *metadata.level() {
        Level::WARN => target.starts_with("zenoh_link_tls"),
        Level::ERROR => target.starts_with("zenoh_transport::unicast::establishment::accept"),
        _ => false,
    }
}

/// The reason if zenoh has no session for a peer.
fn no_room(message: &str) -> Option<String> {
    let full = message.starts_with("Max transports reached").then_some("no session is free");
    full.or_else(|| {
        message.starts_with("Closing link for preventing").then_some("too many pending connections")
    })
    .map(str::to_owned)
}

/// The reason if a message was too long.
fn too_long(message: &str) -> Option<String> {
    message.starts_with(TOO_LONG).then(|| "a message exceeds the size limit".to_owned())
}

/// The part of the text that is the same for all peers with this reason.
fn without_asides(message: &str) -> String {
    let short = ASIDES
        .iter()
        .fold(message, |message, aside| message.split(aside).next().unwrap_or(message));
    let short = BY_STRANGERS.iter().find(|words| short.starts_with(**words)).unwrap_or(&short);
    short.chars().take(200).collect()
}

impl<R: Ord + Clone> Book<R> {
    /// An empty book.
    pub const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// Counts one rejection.
    pub fn note(&mut self, reason: R) {
        self.0.entry(reason).or_default().untold += 1;
    }

    /// The reasons whose line is due, each with its number since the last line: at once, and then
    /// at most every ten seconds.
    pub fn due(&mut self, now: Instant) -> Vec<(R, u64)> {
        self.take(now, |refused| {
            refused.told.is_none_or(|told| now.saturating_duration_since(told) >= PAUSE)
        })
    }

    /// All reasons without a line, independent of the time of the last one: for the end.
    pub fn rest(&mut self) -> Vec<(R, u64)> {
        self.take(Instant::now(), |_| true)
    }

    fn take(&mut self, now: Instant, is_time: impl Fn(&Refused) -> bool) -> Vec<(R, u64)> {
        let is_due = |refused: &Refused| refused.untold > 0 && is_time(refused);
        let due = self.0.iter_mut().filter(|(_, refused)| is_due(refused));
        due.map(|(reason, refused)| {
            refused.told = Some(now);
            (reason.clone(), std::mem::take(&mut refused.untold))
        })
        .collect()
    }
}

impl Book<Reason> {
    /// Counts one rejection. Beyond the limit, reasons in the words of others are counted as one.
    fn note_words(&mut self, reason: Reason) {
        let others = || self.0.keys().filter(|known| matches!(known, Reason::Others(_))).count();
        let is_known = matches!(reason, Reason::Ours(_)) || self.0.contains_key(&reason);
        self.note(if is_known || others() < OTHERS_MAX {
            reason
        } else {
            Reason::Ours("other reasons".to_owned())
        });
    }
}

/// Text of an event. If only its beginning is compared, no more is stored than the comparison
/// needs: zenoh logs a text for each message.
struct Message {
    only: &'static str,
    text: String,
}

impl Write for Message {
    fn write_str(&mut self, more: &str) -> std::fmt::Result {
        self.text.push_str(more);
        let goes_on = self.only.is_empty()
            || self.only.len() > self.text.len() && self.only.starts_with(&self.text);
        if goes_on { Ok(()) } else { Err(std::fmt::Error) }
    }
}

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            // It ends early when the comparison is decided.
            let _ = write!(self, "{value:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::topic::Topic;

    #[test]
    fn a_flood_of_rejected_peers_is_one_line_every_ten_seconds() {
        let (mut book, begin) = (Book::new(), Instant::now());
        let mut lines = Vec::new();
        for hundredth in 0..2_500 {
            book.note("no certificate".to_owned());
            lines.extend(book.due(begin + Duration::from_millis(10 * hundredth)));
        }
        let counts: Vec<u64> = lines.iter().map(|(_, count)| *count).collect();
        assert_eq!(counts, [1, 1000, 1000]);
        assert_eq!(book.due(begin + Duration::from_mins(1)), [("no certificate".to_owned(), 499)]);
        assert_eq!(book.due(begin + Duration::from_secs(90)), []);
        book.note("no certificate".to_owned());
        assert_eq!(
            (book.due(begin + Duration::from_secs(61)), book.rest().len(), book.rest().len()),
            (Vec::new(), 1, 0)
        );
    }

    #[test]
    fn rejected_peers_cannot_exhaust_the_memory_of_the_log() {
        let mut book = Book::new();
        (0..1000).for_each(|number| book.note_words(Reason::Others(format!("reason {number}"))));
        assert_eq!(book.0.len(), OTHERS_MAX + 1);
    }

    #[test]
    fn every_rejected_role_is_named_after_any_number_of_other_reasons() {
        let mut book = Book::new();
        (0..1000).for_each(|number| book.note_words(Reason::Others(format!("reason {number}"))));
        let mut named = Vec::new();
        for kind in [
            "Put",
            "Delete",
            "Query",
            "Reply",
            "Declare Queryable",
            "Liveliness Token",
            "Liveliness Query",
            "Declare Subscriber",
        ] {
            for topic in Topic::ALL {
                let key = format!("coxswain-link/g/{}/data/x", topic.name());
                let text = format!(
                    "7d on lo+CertCommonName(watcher.pilot)+tls+7d is unauthorized \
                     to {kind} (ingress) on {key}"
                );
                if let Some(reason) = rights::refused(&text) {
                    book.note_words(Reason::Ours(reason));
                }
                named.push(Reason::Ours(format!(
                    "watcher.pilot may not {kind} on {}",
                    topic.name()
                )));
            }
        }
        let lines = book.due(Instant::now());
        assert!(named.iter().all(|reason| lines.contains(&(reason.clone(), 1))), "{lines:?}");
    }

    #[test]
    fn a_reason_is_logged_without_guesses_and_source_positions() {
        assert_eq!(
            without_asides("peer sent no certificates. Hint: increase it."),
            "peer sent no certificates"
        );
        assert_eq!(without_asides("received fatal alert: Unknown(0x2a)"), "received fatal alert");
        assert_eq!(
            without_asides("invalid peer certificate: Expired"),
            "invalid peer certificate: Expired"
        );
        assert_eq!(
            without_asides("Received invalid message at /home/x.rs:1."),
            "Received invalid message"
        );
        assert_eq!(
            without_asides(
                "certificate expired: verification time 9 (UNIX), \
                 but certificate is not valid after 8"
            ),
            "certificate expired"
        );
        assert_eq!(
            no_room("Max transports reached (128). Denying new transport with peer: 7f").as_deref(),
            Some("no session is free")
        );
        assert_eq!(no_room("Accepting link... tls/127.0.0.1:1"), None);
    }

    #[test]
    fn of_an_uninteresting_message_only_the_beginning_is_stored() {
        let read = |text: &dyn Debug| {
            let mut message = Message { only: TOO_LONG, text: String::new() };
            let _ = write!(message, "{text:?}");
            message.text
        };
        let full = "Defragmentation buffer full: 65537 bytes. Capacity: 65536.";
        assert_eq!(
            too_long(&read(&format_args!("{full}"))).as_deref(),
            Some("a message exceeds the size limit")
        );
        let frame = read(&format_args!("Received: {:?}", [0_u8; 1000]));
        assert_eq!((frame.as_str(), too_long(&frame)), ("Received: ", None));
    }
}
