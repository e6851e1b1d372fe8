//! An MCAP file → topics and messages. Its chunks may be compressed with LZ4 or Zstandard.

use super::BagError;
use super::files::{BYTES_MAX, Recorded, Take, Topic};
use crate::log::LogError;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use mcap::{McapError, Message};
use recorder::reader::SourceError;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

pub(super) fn topics(file: &Path) -> Result<BTreeSet<Topic>, LogError> {
    let mut seen = BTreeSet::new();
    let mut topics = BTreeSet::new();
    each(file, |message| {
        if seen.insert(message.channel.id) {
            let schema = message.channel.schema.as_ref();
            topics.insert(Topic {
                name: message.channel.topic.clone(),
                kind: schema.map_or_else(String::new, |schema| schema.name.clone()),
                encoding: message.channel.message_encoding.clone(),
            });
        }
        Ok(())
    })?;
    Ok(topics)
}

pub(super) fn messages(
    file: &Path,
    wanted: &[&str],
    take: &mut Take<'_>,
) -> Result<bool, LogError> {
    each(file, |message| {
        let topic = message.channel.topic.as_str();
        if !wanted.contains(&topic) {
            return Ok(());
        }
        let nanos = i64::try_from(message.log_time).unwrap_or(i64::MAX);
        take(&Recorded { topic, nanos, bytes: &message.data })
    })
}

/// Passes each message to `take`, as far as the file can be read. Returns whether it ends early.
fn each(
    file: &Path,
    mut take: impl FnMut(&Message<'_>) -> Result<(), LogError>,
) -> Result<bool, LogError> {
    let opened =
        File::open(file).map_err(|source| SourceError::Read { path: file.to_owned(), source })?;
    let options = LinearReaderOptions::default().with_record_length_limit(BYTES_MAX);
    for message in MessageReader::new_with_options(BufReader::new(opened), options) {
        match message {
            Ok(message) => take(&message)?,
            Err(McapError::UnsupportedCompression(compression)) => {
                return Err(BagError::Chunks { path: file.to_owned(), compression }.into());
            }
            Err(_) => return Ok(true),
        }
    }
    Ok(false)
}
