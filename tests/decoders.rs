//! Bytes from outside → their reader: one function per decoder, for the corpus, the property tests
//! and the fuzzer alike.
//!
//! Each accepts any bytes, never panics, and names the promise that was broken, if one was. The
//! corpus of a decoder is the folder of its name in `tests/fuzz/corpus`. Every run of the tests
//! passes these files to the decoder.
//!
//! | module     | what it decodes                                                              |
//! |------------|------------------------------------------------------------------------------|
//! | `messages` | messages in memory and on the network, snapshots on disk                     |
//! | `settings` | every TOML file                                                              |
//! | `records`  | points of a reference, records, summaries, bags of ROS 2                     |
//! | `serial`   | lines of a base at a serial port                                             |
//! | `others`   | requests of browsers, `coxswain set` and planners, launchers, certificates   |

mod messages;
mod others;
mod records;
mod serial;
mod settings;

use rustix::fs::{MemfdFlags, memfd_create};
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// Result for the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// They are valid, and were used.
    Used,
    /// They are invalid, and an error reported it.
    Refused,
}

/// Result for the bytes, or a sentence if a promise was broken.
pub type Verdict = Result<Fate, String>;

/// Passes bytes to a decoder.
pub type Decoder = fn(&[u8]) -> Verdict;

/// Every decoder, by name.
pub const ALL: [(&str, Decoder); 26] = [
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
    ("bridge_settings", settings::bridge),
    ("gateway_settings", settings::gateway),
    ("points", records::points),
    ("record", records::record),
    ("summary", records::summary),
    ("bag", records::bag),
    ("request", others::request),
    ("launcher", others::launcher),
    ("change", others::change),
    ("set_request", others::set_request),
    ("planner_list", others::planner_list),
    ("certificate", others::certificate),
    ("serial_line", serial::line),
];

/// The decoder named `name`.
pub fn named(name: &str) -> Option<Decoder> {
    ALL.into_iter().find(|(known, _)| *known == name).map(|(_, decoder)| decoder)
}

/// The folder of all corpora.
pub fn corpus() -> PathBuf {
    crate::repository().join("tests/fuzz/corpus")
}

/// Checks a promise: it is kept if it `holds`.
fn promise(holds: bool, broken: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(broken()) }
}

/// A refusal with the error `text`, which must not be empty.
fn refused(text: &str) -> Verdict {
    promise(!text.is_empty(), || "a refusal says nothing".into())?;
    Ok(Fate::Refused)
}

/// Result of several attempts: used if any was.
fn either(one: Fate, other: Fate) -> Fate {
    if one == Fate::Used { one } else { other }
}

/// Passes `bytes` to `read` as a file that exists only in memory.
fn as_file(bytes: &[u8], read: impl FnOnce(&Path) -> Verdict) -> Verdict {
    let file = in_memory(bytes).map_err(|error| format!("no file in memory: {error}"))?;
    read(Path::new(&format!("/proc/self/fd/{}", file.as_raw_fd())))
}

fn in_memory(bytes: &[u8]) -> io::Result<File> {
    let mut file = File::from(memfd_create("seed", MemfdFlags::CLOEXEC)?);
    file.write_all(bytes)?;
    Ok(file)
}
