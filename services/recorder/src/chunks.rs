//! Chunks of an MCAP file, checked before they are read.
//!
//! The reader of mcap 0.26 subtracts with overflow where a record of an uncompressed chunk reaches
//! beyond the chunk.

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::io::Read;

/// Whether the uncompressed chunks of `file` consist of whole records. A file that was cut off is
/// checked as far as it goes.
///
/// # Errors
/// [`McapError`] if the file cannot be read, or is damaged outside of its chunks.
pub fn are_whole(mut file: impl Read, options: LinearReaderOptions) -> Result<bool, McapError> {
    let mut reader = LinearReader::new_with_options(options.with_emit_chunks(true));
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
            }
            Ok(LinearReadEvent::Record { opcode: op::CHUNK, data }) => {
                if let Record::Chunk { header, data } = mcap::parse_record(op::CHUNK, data)?
                    && header.compression.is_empty()
                    && !has_whole_records(&data)
                {
                    return Ok(false);
                }
            }
            Ok(LinearReadEvent::Record { .. }) => {}
            Err(McapError::UnexpectedEof | McapError::UnexpectedEoc) => break,
            Err(error) => return Err(error),
        }
    }
    Ok(true)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reader::{Ending, messages};
    use mcap::WriteOptions;
    use mcap::records::MessageHeader;
    use std::collections::BTreeMap;
    use std::error::Error;
    use std::fs;
    use std::io::Cursor;

    const CONTENT: &[u8] = b"a message that stands out";

    /// A file with one message in an uncompressed chunk.
    fn uncompressed() -> Result<Vec<u8>, McapError> {
        let options = WriteOptions::new().compression(None).calculate_chunk_crcs(false);
        let mut writer = options.create(Cursor::new(Vec::new()))?;
        let channel_id = writer.add_channel(0, "topic", "json", &BTreeMap::new())?;
        let header = MessageHeader { channel_id, sequence: 1, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, CONTENT)?;
        writer.finish()?;
        Ok(writer.into_inner().into_inner())
    }

    #[test]
    fn a_record_that_reaches_beyond_its_chunk_is_not_read() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("record.mcap");
        let mut bytes = uncompressed()?;
        fs::write(&path, &bytes)?;
        let mut read = 0;
        let mut count = |_: &mcap::Message<'_>| {
            read += 1;
            Ok(())
        };
        assert_eq!(messages(&path, &mut count)?, Ending::Whole);

        // The length of the record stands before the header of the message, which has 22 bytes.
        let content = bytes.windows(CONTENT.len()).position(|part| part == CONTENT);
        let length = content.ok_or("no content")? - 22 - 8;
        bytes[length..length + 8].copy_from_slice(&1_000_000_u64.to_le_bytes());
        fs::write(&path, &bytes)?;
        assert_eq!(messages(&path, &mut count)?, Ending::Early);
        assert_eq!(read, 1);
        Ok(())
    }
}
