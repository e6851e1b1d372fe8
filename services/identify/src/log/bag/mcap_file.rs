//! An MCAP file → topics and messages. Its chunks may be compressed with LZ4 or Zstandard.

use super::BagError;
use super::files::{BYTES_MAX, Recorded, Take, Topic};
use crate::log::LogError;
use mcap::io::MessageReader;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, Message};
use recorder::reader::SourceError;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader, Read};
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
    check_chunks(file)?;
    for message in MessageReader::new_with_options(open(file)?, options()) {
        match message {
            Ok(message) => take(&message)?,
            Err(source @ McapError::UnsupportedCompression(_)) => return Err(failed(file, source)),
            Err(_) => return Ok(true),
        }
    }
    Ok(false)
}

/// Fails if a record of an uncompressed chunk reaches beyond it. The reader of mcap 0.26 would
/// subtract with overflow there.
fn check_chunks(file: &Path) -> Result<(), LogError> {
    let mut bytes = open(file)?;
    let mut reader = LinearReader::new_with_options(options().with_emit_chunks(true));
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let read = bytes.read(reader.insert(need));
                reader.notify_read(read.map_err(|source| unreadable(file, source))?);
            }
            Ok(LinearReadEvent::Record { opcode: op::CHUNK, data }) => {
                let chunk = mcap::parse_record(op::CHUNK, data);
                if let Record::Chunk { header, data } =
                    chunk.map_err(|error| failed(file, error))?
                    && header.compression.is_empty()
                    && !has_whole_records(&data)
                {
                    return Err(failed(file, McapError::UnexpectedEoc));
                }
            }
            Ok(LinearReadEvent::Record { .. }) => {}
            // Cut off: read as far as it goes.
            Err(McapError::UnexpectedEof | McapError::UnexpectedEoc) => return Ok(()),
            Err(source) => return Err(failed(file, source)),
        }
    }
    Ok(())
}

/// Whether `records`, each an opcode, a length of 8 bytes and as many bytes, end with a whole one.
fn has_whole_records(mut records: &[u8]) -> bool {
    while let Some((head, rest)) = records.split_first_chunk::<9>() {
        let [_, length @ ..] = *head;
        let length = usize::try_from(u64::from_le_bytes(length)).unwrap_or(usize::MAX);
        let Some(rest) = rest.get(length..) else { return false };
        records = rest;
    }
    records.is_empty()
}

fn options() -> LinearReaderOptions {
    LinearReaderOptions::default().with_record_length_limit(BYTES_MAX)
}

fn open(file: &Path) -> Result<BufReader<File>, LogError> {
    File::open(file).map(BufReader::new).map_err(|source| unreadable(file, source))
}

fn unreadable(file: &Path, source: io::Error) -> LogError {
    SourceError::Read { path: file.to_owned(), source }.into()
}

fn failed(file: &Path, source: McapError) -> LogError {
    BagError::Mcap { path: file.to_owned(), source }.into()
}
