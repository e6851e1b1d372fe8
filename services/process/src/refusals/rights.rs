//! zenoh's log texts about permissions and rates → the role, the operation and the topic of a
//! rejected message.
//!
//! At its lowest level, zenoh logs "… is authorized to Put (ingress) on key" or "unauthorized" for
//! each message that arrives, and "(egress)" for each that leaves. It names the certificate of the
//! sender when it evaluates a permission, and only the session when it uses a cached one.

use access::Role;
use protocol::topic::Topic;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Text of zenoh before it evaluates, once per key, the permission for each kind of message. No
/// peer has sent any of these messages.
const WORKED_OUT: &str = "ACL (ingress): caching permissions for `";

/// Number of kinds of messages in that evaluation.
const KINDS: u8 = 9;

/// Text of zenoh before a cached permission.
const KNOWN: &str = "Using cached result: ";

/// Text of zenoh before a message above its rate limit.
const DROPPED: &str = "Message dropped by the downsampling interceptor: ";

/// Largest number of sessions whose certificates are stored: more than a router accepts at a time.
const GUESTS_MAX: usize = 256;

/// Reason for a certificate without a role.
const NO_ROLE: &str = "a certificate without a role in this graph";

/// Name of a session → its certificate.
static GUESTS: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());

thread_local! {
    /// Key and number of the next permission texts that belong to no message.
    static UNSENT: RefCell<(String, u8)> = const { RefCell::new((String::new(), 0)) };
}

/// The rejection that zenoh's text reports, if it is one.
pub(super) fn refused(message: &str) -> Option<String> {
    // The session's name comes first and has no space. The key, which its sender chose, comes last.
    if let Some((session, _)) = message
        .split_once(' ')
        .filter(|(_, rest)| rest.starts_with("did not match any configured ACL subject"))
    {
        introduce(session, NO_ROLE);
        return Some(NO_ROLE.to_owned());
    }
    if let Some(key) = message.strip_prefix(WORKED_OUT) {
        UNSENT.replace((key.split('`').next()?.to_owned(), KINDS));
        return None;
    }
    let (who, what) = message.split_once("authorized to ")?;
    let (kind, key) = what.split_once(" (ingress) on ")?;
    let session = if let Some((session, subject)) = who.split_once(" on ") {
        introduce(session, role(subject)?);
        if is_unsent(key) {
            return None;
        }
        session
    } else {
        who.strip_prefix(KNOWN)?.split(' ').next()?
    };
    let who = who.ends_with("un").then(|| guests().get(session).cloned())?;
    let who = who.as_deref().unwrap_or("an unknown session");
    Some(format!("{who} may not {kind} on {}", place(key)))
}

/// The rejection by a rate limit that zenoh's text reports, if it is one.
pub(super) fn too_often(message: &str) -> Option<String> {
    let (what, from) = message.strip_prefix(DROPPED)?.rsplit_once(") from:")?;
    let (_, key) = what.split_once('(')?;
    // Here zenoh names the session by its first digits.
    let digits = from.rsplit('/').next()?.split(':').next()?;
    let guests = guests();
    let guest =
        guests.range(digits.to_owned()..).next().filter(|(session, _)| session.starts_with(digits));
    let (who, place) = (guest.map_or("an unknown session", |(_, who)| who), place(key));
    // zenoh checks rates before permissions.
    let role = who.split('.').next().and_then(Role::named);
    let may = role.is_none_or(|role| role.says().iter().any(|topic| topic.name() == place));
    Some(if may {
        format!("{who} publishes on {place} above the rate limit")
    } else {
        format!("{who} may not Put on {place}")
    })
}

/// Whether the text about `key` belongs to no message.
fn is_unsent(key: &str) -> bool {
    UNSENT.with_borrow_mut(|(of, left)| {
        let unsent = *left > 0 && of == key;
        *left = if unsent { *left - 1 } else { 0 };
        unsent
    })
}

/// Stores the certificate of a session.
fn introduce(session: &str, who: &str) {
    let mut guests = guests();
    if guests.len() == GUESTS_MAX && !guests.contains_key(session) {
        guests.pop_first();
    }
    // A session chooses its name, and may reuse that of an earlier one.
    guests.insert(session.to_owned(), who.to_owned());
}

fn guests() -> MutexGuard<'static, BTreeMap<String, String>> {
    GUESTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Name of the certificate in "Interface(lo)+CertCommonName(watcher.pilot)+…".
fn role(subject: &str) -> Option<&str> {
    let is_role =
        |name: &str| Role::ALL.iter().any(|role| name.split('.').next() == Some(role.name()));
    subject.split(['(', ')']).find(|name| name.contains('.') && is_role(name))
}

/// Topic of a key, without the parts that its sender can choose.
fn place(key: &str) -> &'static str {
    let names = key.split('/').nth(2);
    Topic::ALL
        .iter()
        .map(|topic| topic.name())
        .find(|name| names == Some(name))
        .unwrap_or("another key")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_forbidden_message_is_logged_by_role_without_text_of_the_sender() {
        let put = "7f on lo+CertCommonName(watcher.pilot)+tls+7f is unauthorized \
                   to Put (ingress) on coxswain-link/g/command/data/<b>";
        assert_eq!(refused(put).as_deref(), Some("watcher.pilot may not Put on command"));
        let token = "8f on lo+CertCommonName(learner.pilot)+tls+8f is unauthorized \
                     to Declare/Undeclare Liveliness Token (ingress) on a/b";
        assert_eq!(
            refused(token).as_deref(),
            Some("learner.pilot may not Declare/Undeclare Liveliness Token on another key")
        );
        assert_eq!(refused(&put.replace("unauthorized", "authorized")), None);
        assert_eq!(refused(&put.replace("ingress", "egress")), None);
        assert_eq!(
            refused("9f did not match any configured ACL subject. Default").as_deref(),
            Some("a certificate without a role in this graph")
        );
        let forged = put.replace("<b>", "x did not match any configured ACL subject");
        assert_eq!(
            refused(&forged).as_deref(),
            Some("watcher.pilot may not Put on command"),
            "for every key"
        );
        let query = "Using cached result: 9f is unauthorized \
                     to Query (ingress) on coxswain-link/g/command/join/1";
        assert_eq!(
            refused(query).as_deref(),
            Some("a certificate without a role in this graph may not Query on command")
        );
        assert_eq!(
            refused(&query.replace("9f", "af")).as_deref(),
            Some("an unknown session may not Query on command")
        );
    }

    #[test]
    fn a_message_above_its_rate_is_logged_by_role_without_text_of_the_sender() {
        let put = "6f01ab on lo+CertCommonName(learner.pilot)+tls+6f01ab is authorized \
                   to Put (ingress) on coxswain-link/g/health/data/<b>";
        assert_eq!(refused(put), None);
        let often = |key: &str, session: &str| {
            too_often(&format!(
                "Message dropped by the downsampling interceptor: \
                 Push(coxswain-link/g/{key}) from:south:0:client/{session}:3"
            ))
        };
        let expected = Some("learner.pilot publishes on health above the rate limit");
        assert_eq!(often("health/data/learner.1", "6f01").as_deref(), expected);
        assert_eq!(
            often("health/data/robot.1) from:south:0:client/7f01:3", "6f01").as_deref(),
            expected
        );
        assert_eq!(
            often("command/data/x", "6e01").as_deref(),
            Some("an unknown session publishes on command above the rate limit")
        );
        assert_eq!(
            often("command/data/x", "6f01").as_deref(),
            Some("learner.pilot may not Put on command")
        );
        assert_eq!(too_often("Some message(s) have been dropped"), None);
    }

    #[test]
    fn a_permission_that_zenoh_only_evaluates_is_no_rejection() {
        let put = "7e on lo+CertCommonName(watcher.pilot)+tls+7e is unauthorized \
                   to Put (ingress) on coxswain-link/g/state/data/1";
        assert_eq!(
            refused("ACL (ingress): caching permissions for `coxswain-link/g/state/data/1` ..."),
            None
        );
        assert_eq!((0..KINDS).find_map(|_| refused(put)), None);
        let cached = "Using cached result: 7e is unauthorized \
                      to Put (ingress) on coxswain-link/g/state/data/1";
        assert_eq!(refused(cached).as_deref(), Some("watcher.pilot may not Put on state"));
        assert_eq!(refused(put).as_deref(), Some("watcher.pilot may not Put on state"));
        assert_eq!(
            refused("ACL (ingress): caching permissions for `a/b` ..."),
            None,
            "for a session without a role, zenoh logs no evaluation"
        );
        assert_eq!(refused(put).as_deref(), Some("watcher.pilot may not Put on state"));
    }
}
