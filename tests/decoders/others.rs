//! What browsers ask of the live page, and the file that says who launched a graph.

use super::{Fate, Verdict, promise, refused};
use coxswain::berth;
use std::fs;
use std::net::{IpAddr, Ipv4Addr};

/// A request gets the page or its events, or a status that says why not: never one of success. Another site gets neither.
pub(super) fn request(bytes: &[u8]) -> Verdict {
    let listening = IpAddr::V4(Ipv4Addr::LOCALHOST);
    match gateway::page::asked(bytes, listening) {
        Ok(what) => {
            // Empty lines before a request are allowed.
            let method = bytes.trim_ascii_start().starts_with(b"GET /");
            promise(method, || format!("{what} for what?"))?;
            Ok(Fate::Used)
        }
        Err(status) => {
            promise(status.starts_with(['4', '5']), || format!("refused with {status}"))?;
            refused(status)
        }
    }
}

/// A file that says who launched a graph is one of a launcher that lives, whose graph is left alone, or of one that does not, and the graph is
/// swept. What is no such file is left alone.
pub(super) fn launcher(bytes: &[u8]) -> Verdict {
    let failed = |error| format!("no folder: {error}");
    let base = tempfile::tempdir().map_err(failed)?;
    let file = base.path().join("00000000.toml");
    fs::write(&file, bytes).map_err(failed)?;
    let living = berth::living(base.path()).len();
    let (swept, complaints) = berth::sweep_stale(base.path());
    promise(complaints.is_empty(), || complaints.join("; "))?;
    promise(living + swept <= 1, || format!("one file, {living} living and {swept} dead launchers"))?;
    promise(file.exists() == (swept == 0), || "a graph was swept by halves, or for no reason".into())?;
    Ok(if living + swept > 0 { Fate::Used } else { Fate::Refused })
}
