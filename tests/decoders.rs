//! Bytes from outside → what reads them: one function per decoder, for the corpus, the property tests and the fuzzer alike.
//!
//! Each takes any bytes at all, never panics, and says which promise was broken, if one was. The corpus of a decoder, files that it is given
//! in every run of the tests, is in `tests/fuzz/corpus` in the folder of its name.
//!
//! | module     | what it decodes                                                              |
//! |------------|------------------------------------------------------------------------------|
//! | `messages` | messages in memory and on the network, snapshots on disk                     |
//! | `settings` | every TOML file                                                              |
//! | `records`  | points of a reference, records, summaries                                    |
//! | `others`   | what browsers and `coxswain set` ask for, who launched a graph, certificates |

mod messages;
mod others;
mod records;
mod settings;

use rustix::fs::{MemfdFlags, memfd_create};
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// What became of the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// They are what they should be.
    Used,
    /// They are not, and that was said.
    Refused,
}

/// What became of the bytes, or a sentence if a promise was broken.
pub type Verdict = Result<Fate, String>;

/// Gives bytes to a decoder.
pub type Decoder = fn(&[u8]) -> Verdict;

/// Every decoder, by name.
pub const ALL: [(&str, Decoder); 22] = [
    ("frame", messages::frame),
    ("wire", messages::wire),
    ("snapshot_file", messages::snapshot_file),
    ("graph", settings::graph),
    ("robot", settings::robot),
    ("faults", settings::faults),
    ("scenario", settings::scenario),
    ("scenario_change", settings::scenario_change),
    ("epochs", settings::epochs),
    ("plant_settings", settings::plant),
    ("controller_settings", settings::controller),
    ("learner_settings", settings::learner),
    ("recorder_settings", settings::recorder),
    ("gateway_settings", settings::gateway),
    ("points", records::points),
    ("record", records::record),
    ("summary", records::summary),
    ("request", others::request),
    ("launcher", others::launcher),
    ("change", others::change),
    ("set_request", others::set_request),
    ("certificate", others::certificate),
];

/// The decoder that is called `name`.
pub fn named(name: &str) -> Option<Decoder> {
    ALL.into_iter().find(|(known, _)| *known == name).map(|(_, decoder)| decoder)
}

/// The folder of all corpora.
pub fn corpus() -> PathBuf {
    crate::repository().join("tests/fuzz/corpus")
}

/// A promise that is kept if it `holds`.
fn promise(holds: bool, broken: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(broken()) }
}

/// A refusal that says `text`, which has to be something.
fn refused(text: &str) -> Verdict {
    promise(!text.is_empty(), || "a refusal says nothing".into())?;
    Ok(Fate::Refused)
}

/// What became of one of several attempts: used if any was.
fn either(one: Fate, other: Fate) -> Fate {
    if one == Fate::Used { one } else { other }
}

/// Shows `bytes` to `read` as a file, which is only in memory.
fn as_file(bytes: &[u8], read: impl FnOnce(&Path) -> Verdict) -> Verdict {
    let file = in_memory(bytes).map_err(|error| format!("no file in memory: {error}"))?;
    read(Path::new(&format!("/proc/self/fd/{}", file.as_raw_fd())))
}

fn in_memory(bytes: &[u8]) -> io::Result<File> {
    let mut file = File::from(memfd_create("seed", MemfdFlags::CLOEXEC)?);
    file.write_all(bytes)?;
    Ok(file)
}
