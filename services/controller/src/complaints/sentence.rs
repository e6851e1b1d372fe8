//! A complaint as text, without allocation.

use super::Complaint;
use protocol::message::ERROR_TEXT_MAX;
use std::fmt::{self, Write};

/// A sentence for a Health, without allocation. A sentence that is too long is truncated.
#[derive(Debug)]
pub struct Sentence {
    bytes: [u8; Self::MAX],
    length: usize,
}

impl Sentence {
    const MAX: usize = ERROR_TEXT_MAX;

    /// The sentence of `complaint`.
    pub fn of(complaint: &Complaint) -> Self {
        let mut sentence = Self { bytes: [0; Self::MAX], length: 0 };
        // A full buffer is not an error.
        let _ = write!(sentence, "{complaint}");
        sentence
    }

    /// The sentence as text.
    pub fn text(&self) -> &str {
        let written = self.bytes.get(..self.length).unwrap_or_default();
        std::str::from_utf8(written).unwrap_or_default()
    }
}

impl Write for Sentence {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.bytes.get_mut(self.length..self.length + text.len()).ok_or(fmt::Error)?;
        room.copy_from_slice(text.as_bytes());
        self.length += text.len();
        Ok(())
    }
}
