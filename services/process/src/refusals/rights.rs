//! zenoh's words about rights and rates, at its lowest level → who may not what, if somebody wanted it, and who wants it too often.
//!
//! It says "… is authorized to Put (ingress) on key" or "unauthorized" of each message that arrives, "(egress)" of each that leaves; and calls the sender by certificate
//! where it works that out, and by the name of its session alone where it knows already.

use protocol::access::Role;
use protocol::topic::Topic;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What zenoh says before it works out, once for a key, what of each kind of message is allowed there: nobody has sent any of them.
const WORKED_OUT: &str = "ACL (ingress): caching permissions for `";

/// Kinds of message that it then speaks of, one after the other.
const KINDS: u8 = 9;

/// What it says before what it knows already.
const KNOWN: &str = "Using cached result: ";

/// What it says before what comes too soon after another.
const DROPPED: &str = "Message dropped by the downsampling interceptor: ";

/// Sessions whose certificates are remembered: more than a router lets in at a time.
const GUESTS_MAX: usize = 256;

/// Who has a certificate with which there is nothing to do here.
const NO_ROLE: &str = "a certificate of no role here";

/// Name of a session → whose it is.
static GUESTS: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());

thread_local! {
    /// Of which key the next words about rights, and how many of them, are of messages that nobody has sent.
    static UNSENT: RefCell<(String, u8)> = const { RefCell::new((String::new(), 0)) };
}

/// Who may not what, by what zenoh says.
pub(super) fn refused(message: &str) -> Option<String> {
    // The session's name comes first, and has no space; a key, which its author chose, comes last.
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
    Some(format!("{} may not {kind} on {}", who.as_deref().unwrap_or("somebody"), place(key)))
}

/// Who says more than passes, and on what, by what zenoh says.
pub(super) fn too_often(message: &str) -> Option<String> {
    let (what, from) = message.strip_prefix(DROPPED)?.rsplit_once(") from:")?;
    let (_, key) = what.split_once('(')?;
    // Here it calls the session by the first digits of its name.
    let digits = from.rsplit('/').next()?.split(':').next()?;
    let guests = guests();
    let guest =
        guests.range(digits.to_owned()..).next().filter(|(session, _)| session.starts_with(digits));
    let (who, place) = (guest.map_or("somebody", |(_, who)| who), place(key));
    // Rates are looked at before rights.
    let role = who.split('.').next().and_then(Role::named);
    let may = role.is_none_or(|role| role.says().iter().any(|topic| topic.name() == place));
    Some(if may {
        format!("{who} says more on {place} than anybody needs to")
    } else {
        format!("{who} may not Put on {place}")
    })
}

/// Whether the word about `key` is of a message that nobody has sent.
fn is_unsent(key: &str) -> bool {
    UNSENT.with_borrow_mut(|(of, left)| {
        let unsent = *left > 0 && of == key;
        *left = if unsent { *left - 1 } else { 0 };
        unsent
    })
}

/// Notes whose session it is.
fn introduce(session: &str, who: &str) {
    let mut guests = guests();
    if guests.len() == GUESTS_MAX && !guests.contains_key(session) {
        guests.pop_first();
    }
    // A session chooses its name, and may take that of one before.
    guests.insert(session.to_owned(), who.to_owned());
}

fn guests() -> MutexGuard<'static, BTreeMap<String, String>> {
    GUESTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whose certificate it is, of "Interface(lo)+CertCommonName(watcher.pilot)+…".
fn role(subject: &str) -> Option<&str> {
    let is_role =
        |name: &str| Role::ALL.iter().any(|role| name.split('.').next() == Some(role.name()));
    subject.split(['(', ')']).find(|name| name.contains('.') && is_role(name))
}

/// What a key is of, without what its author can choose.
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
    fn who_says_what_he_may_not_is_told_by_his_role_and_nothing_that_he_chose() {
        let put = "7f on lo+CertCommonName(watcher.pilot)+tls+7f is unauthorized to Put (ingress) on coxswain-link/g/command/data/<b>";
        assert_eq!(refused(put).as_deref(), Some("watcher.pilot may not Put on command"));
        let token = "8f on lo+CertCommonName(learner.pilot)+tls+8f is unauthorized to Declare/Undeclare Liveliness Token (ingress) on a/b";
        assert_eq!(
            refused(token).as_deref(),
            Some("learner.pilot may not Declare/Undeclare Liveliness Token on another key")
        );
        assert_eq!(refused(&put.replace("unauthorized", "authorized")), None);
        assert_eq!(refused(&put.replace("ingress", "egress")), None);
        assert_eq!(
            refused("9f did not match any configured ACL subject. Default").as_deref(),
            Some("a certificate of no role here")
        );
        let forged = put.replace("<b>", "x did not match any configured ACL subject");
        assert_eq!(
            refused(&forged).as_deref(),
            Some("watcher.pilot may not Put on command"),
            "whatever the key says"
        );
        let query = "Using cached result: 9f is unauthorized to Query (ingress) on coxswain-link/g/command/join/1";
        assert_eq!(
            refused(query).as_deref(),
            Some("a certificate of no role here may not Query on command")
        );
        assert_eq!(
            refused(&query.replace("9f", "af")).as_deref(),
            Some("somebody may not Query on command")
        );
    }

    #[test]
    fn who_says_too_much_is_told_by_his_role_and_nothing_that_he_chose() {
        let put = "6f01ab on lo+CertCommonName(learner.pilot)+tls+6f01ab is authorized to Put (ingress) on coxswain-link/g/health/data/<b>";
        assert_eq!(refused(put), None);
        let often = |key: &str, session: &str| {
            too_often(&format!(
                "Message dropped by the downsampling interceptor: Push(coxswain-link/g/{key}) from:south:0:client/{session}:3"
            ))
        };
        let told = Some("learner.pilot says more on health than anybody needs to");
        assert_eq!(often("health/data/learner.1", "6f01").as_deref(), told);
        assert_eq!(
            often("health/data/robot.1) from:south:0:client/7f01:3", "6f01").as_deref(),
            told
        );
        assert_eq!(
            often("command/data/x", "6e01").as_deref(),
            Some("somebody says more on command than anybody needs to")
        );
        assert_eq!(
            often("command/data/x", "6f01").as_deref(),
            Some("learner.pilot may not Put on command")
        );
        assert_eq!(too_often("Some message(s) have been dropped"), None);
    }

    #[test]
    fn rights_that_are_only_worked_out_are_refused_to_nobody() {
        let put = "7e on lo+CertCommonName(watcher.pilot)+tls+7e is unauthorized to Put (ingress) on coxswain-link/g/state/data/1";
        assert_eq!(
            refused("ACL (ingress): caching permissions for `coxswain-link/g/state/data/1` ..."),
            None
        );
        assert_eq!((0..KINDS).find_map(|_| refused(put)), None);
        let cached = "Using cached result: 7e is unauthorized to Put (ingress) on coxswain-link/g/state/data/1";
        assert_eq!(refused(cached).as_deref(), Some("watcher.pilot may not Put on state"));
        assert_eq!(refused(put).as_deref(), Some("watcher.pilot may not Put on state"));
        assert_eq!(
            refused("ACL (ingress): caching permissions for `a/b` ..."),
            None,
            "of somebody of no role, nothing is said then"
        );
        assert_eq!(refused(put).as_deref(), Some("watcher.pilot may not Put on state"));
    }
}
