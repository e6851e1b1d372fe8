//! Messages ↔ pieces with labels.
//!
//! A long message goes in pieces. zenoh's priorities do nothing for bytes that are already in the
//! kernel's send buffer: a state that comes behind a megabyte waits for all of it.

use protocol::wire;
use std::ops::Range;

/// Longest piece \[bytes\]: a link of 100 Mbit/s takes 1.3 ms for it.
pub(crate) const PIECE_BYTES_MAX: usize = 16 * 1024;

/// Bytes of a label.
const LABEL_BYTES: usize = 24;

/// The label of a piece: it goes beside the bytes, as little-endian numbers in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Label {
    /// The bridge that sends it: drawn at random when it starts.
    pub(crate) instance: u64,
    /// Number of the piece on its topic, from 1.
    pub(crate) number: u64,
    /// Bytes of the message before it.
    pub(crate) offset: u32,
    /// Bytes of the whole message.
    pub(crate) length: u32,
}

impl Label {
    pub(crate) fn to_bytes(self) -> [u8; LABEL_BYTES] {
        let mut bytes = [0; LABEL_BYTES];
        bytes[..8].copy_from_slice(&self.instance.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.number.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.offset.to_le_bytes());
        bytes[20..].copy_from_slice(&self.length.to_le_bytes());
        bytes
    }

    /// None if the bytes are no label.
    pub(crate) fn of(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; LABEL_BYTES] = bytes.try_into().ok()?;
        let (instance, rest) = bytes.split_first_chunk::<8>()?;
        let (number, rest) = rest.split_first_chunk::<8>()?;
        let (offset, length) = rest.split_first_chunk::<4>()?;
        Some(Self {
            instance: u64::from_le_bytes(*instance),
            number: u64::from_le_bytes(*number),
            offset: u32::from_le_bytes(*offset),
            length: u32::from_le_bytes(length.try_into().ok()?),
        })
    }
}

/// Ranges of the pieces of a message of `length` bytes.
pub(crate) fn ranges(length: usize) -> impl Iterator<Item = Range<usize>> {
    (0..length)
        .step_by(PIECE_BYTES_MAX)
        .map(move |offset| offset..length.min(offset + PIECE_BYTES_MAX))
}

/// A message of which some pieces have arrived.
#[derive(Debug, Default)]
pub(crate) struct Assembly {
    /// Label of the last piece.
    last: Option<Label>,
    bytes: Vec<u8>,
}

impl Assembly {
    /// Adds one piece, and returns the whole message with its last one. A piece that does not
    /// follow the piece before it ends the message.
    pub(crate) fn add(&mut self, label: Label, piece: &[u8]) -> Option<&[u8]> {
        let before = self.last.replace(label);
        if label.offset == 0 {
            self.bytes.clear();
        } else {
            let follows = before.is_some_and(|before| {
                (before.instance, before.number.wrapping_add(1)) == (label.instance, label.number)
            });
            if !follows || label.offset as usize != self.bytes.len() {
                self.bytes.clear();
                return None;
            }
        }
        let length = label.length as usize;
        if length > wire::BYTES_MAX || self.bytes.len() + piece.len() > length {
            self.bytes.clear();
            return None;
        }
        self.bytes.extend_from_slice(piece);
        (self.bytes.len() == length).then_some(self.bytes.as_slice())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::BYTES_MAX;

    fn label(number: u64, range: &Range<usize>, length: usize) -> Label {
        let [offset, length] = [range.start, length].map(|bytes| bytes as u32);
        Label { instance: 7, number, offset, length }
    }

    /// The message with one of its pieces lost on the way.
    fn arrives(
        assembly: &mut Assembly,
        message: &[u8],
        first: u64,
        lost: Option<usize>,
    ) -> Option<Vec<u8>> {
        let mut whole = None;
        for (index, range) in ranges(message.len()).enumerate() {
            let label = label(first + index as u64, &range, message.len());
            if Some(index) != lost {
                whole = assembly.add(label, &message[range]).map(<[u8]>::to_vec);
            }
        }
        whole
    }

    fn message(length: usize) -> Vec<u8> {
        (0..length).map(|index| (index % 251) as u8).collect()
    }

    #[test]
    fn a_message_is_assembled_from_its_pieces() {
        let mut assembly = Assembly::default();
        for length in [1, PIECE_BYTES_MAX, PIECE_BYTES_MAX + 1, 2 * PIECE_BYTES_MAX, BYTES_MAX] {
            let sent = message(length);
            assert!(arrives(&mut assembly, &sent, 1, None) == Some(sent), "{length}");
        }
    }

    #[test]
    fn a_message_that_lost_a_piece_never_arrives_and_the_next_one_does() {
        let sent = message(4 * PIECE_BYTES_MAX);
        for lost in 0..4 {
            let mut assembly = Assembly::default();
            assert_eq!(arrives(&mut assembly, &sent, 1, Some(lost)), None, "{lost}");
            assert!(arrives(&mut assembly, &sent, 5, None).as_ref() == Some(&sent), "{lost}");
        }
    }

    #[test]
    fn pieces_of_two_messages_never_make_one() {
        let sent = message(2 * PIECE_BYTES_MAX);
        let mut assembly = Assembly::default();
        let parts: Vec<_> = ranges(sent.len()).collect();
        let half = &sent[..PIECE_BYTES_MAX];
        assert_eq!(assembly.add(label(1, &parts[0], sent.len()), half), None);
        assert_eq!(assembly.add(label(3, &parts[1], sent.len()), half), None);
        let other = Label { instance: 8, ..label(4, &parts[1], sent.len()) };
        assert_eq!(assembly.add(other, half), None);
    }

    #[test]
    fn no_more_is_kept_than_was_announced_or_can_be() {
        let piece = message(PIECE_BYTES_MAX);
        let mut assembly = Assembly::default();
        let label = |number, offset, length| Label { instance: 7, number, offset, length };
        assert_eq!(assembly.add(label(1, 0, 10), &piece), None);
        assert_eq!(assembly.add(label(1, 0, u32::MAX), &piece), None);
        assert!(assembly.bytes.is_empty());
    }

    #[test]
    fn other_bytes_are_no_label() {
        let known = label(5, &(0..3), 3);
        assert_eq!(Label::of(&known.to_bytes()), Some(known));
        for length in (0..64).filter(|length| *length != LABEL_BYTES) {
            assert_eq!(Label::of(&vec![1; length]), None, "{length}");
        }
    }
}
