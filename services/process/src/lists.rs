//! planner → plant: lists of obstacles, over a socket on the robot's machine.
//!
//! | direction       | line of text                                                               |
//! |-----------------|----------------------------------------------------------------------------|
//! | planner → plant | a list as JSON                                                             |
//! | plant → planner | `{"outcome":"accepted"}`, or `{"outcome":"rejected","reason":"…"}`         |
//!
//! The socket is in the directory of the links, which only the user of the launch can open.

use serde::{Deserialize, Serialize};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest line, with its end \[bytes\].
pub const LINE_BYTES_MAX: usize = 1 << 16;
/// Longest wait for a reply. A plant that is restarted closes the connection.
const REPLY_WITHIN: Duration = Duration::from_secs(5);

/// The reply to a list.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "outcome", rename_all = "kebab-case")]
pub enum Verdict {
    /// It acts from the next period on, unless a newer one arrives before.
    Accepted,
    /// No part of it acts.
    Rejected {
        /// Why not.
        reason: String,
    },
}

/// The socket of the graph whose links are in `root`.
pub fn socket(root: &Path) -> PathBuf {
    root.join("lists")
}

/// Sends lists to the plant of one graph. It connects when it needs to, also after a restart of the
/// plant.
#[derive(Debug)]
pub struct Lists {
    socket: PathBuf,
    stream: Option<BufReader<UnixStream>>,
}

impl Lists {
    /// For the graph whose links are in `root`.
    pub fn new(root: &Path) -> Self {
        Self::at(socket(root))
    }

    /// For the plant that listens at `socket`.
    pub fn at(socket: PathBuf) -> Self {
        Self { socket, stream: None }
    }

    /// Sends a list as JSON, and waits for the reply.
    ///
    /// # Errors
    /// Error of the socket: the plant does not run, or not on this machine.
    pub fn send(&mut self, list: &str) -> io::Result<Verdict> {
        // JSON has line ends between its values alone.
        let line = list.replace(['\n', '\r'], " ") + "\n";
        if line.len() > LINE_BYTES_MAX {
            let reason = format!("expected at most {LINE_BYTES_MAX} bytes, not {}", line.len());
            return Ok(Verdict::Rejected { reason });
        }
        // A plant that was restarted has closed the connection.
        if let Some(stream) = self.stream.take()
            && let Ok(verdict) = self.exchange(stream, &line)
        {
            return Ok(verdict);
        }
        let stream = UnixStream::connect(&self.socket)?;
        stream.set_read_timeout(Some(REPLY_WITHIN))?;
        stream.set_write_timeout(Some(REPLY_WITHIN))?;
        self.exchange(BufReader::new(stream), &line)
    }

    /// Sends a line, and keeps the stream for the next one if a reply arrives.
    fn exchange(&mut self, mut stream: BufReader<UnixStream>, line: &str) -> io::Result<Verdict> {
        stream.get_mut().write_all(line.as_bytes())?;
        let mut reply = Vec::new();
        stream.by_ref().take(LINE_BYTES_MAX as u64).read_until(b'\n', &mut reply)?;
        if !reply.ends_with(b"\n") {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.stream = Some(stream);
        serde_json::from_slice(&reply).map_err(io::Error::other)
    }
}
