//! Long messages go in pieces, each of which zenoh sends as it is. A router passes on what has
//! arrived with the thread that writes: it cannot wait for room, and a long message in one go would
//! find too little.

use std::ops::Range;

/// Longest piece \[bytes\]: with all that zenoh adds it is one batch of 64 KiB.
pub(super) const PIECE_BYTES_MAX: usize = 60_000;

/// Pieces that follow one another before the router is asked whether it has passed them on: a
/// quarter of the room in its queue.
pub(super) const PIECES_AT_ONCE: usize = 4;

/// Longest message \[bytes\].
const BYTES_MAX: usize = protocol::wire::BYTES_MAX;

/// What stands beside the bytes of each put, little-endian: the number of the message on its link,
/// and of a piece where it belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Label {
    pub(super) number: u64,
    pub(super) place: Option<Place>,
}

/// Where a piece belongs \[bytes\].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// What of the message comes before it.
    offset: u32,
    /// The whole message.
    length: u32,
}

impl Label {
    pub(super) fn to_bytes(self) -> Vec<u8> {
        let mut bytes = self.number.to_le_bytes().to_vec();
        if let Some(Place { offset, length }) = self.place {
            bytes.extend(offset.to_le_bytes());
            bytes.extend(length.to_le_bytes());
        }
        bytes
    }

    /// None of what is no label.
    pub(super) fn of(bytes: &[u8]) -> Option<Self> {
        let (number, rest) = bytes.split_first_chunk()?;
        let number = u64::from_le_bytes(*number);
        let (offset, rest) = match rest.split_first_chunk() {
            Some((offset, rest)) => (u32::from_le_bytes(*offset), rest),
            None => return rest.is_empty().then_some(Self { number, place: None }),
        };
        let length = u32::from_le_bytes(rest.try_into().ok()?);
        Some(Self { number, place: Some(Place { offset, length }) })
    }
}

/// Ranges of the pieces of a message of `length` bytes, each with its label.
pub(super) fn pieces(number: u64, length: usize) -> impl Iterator<Item = (Range<usize>, Label)> {
    (0..length).step_by(PIECE_BYTES_MAX).map(move |offset| {
        // A message is far shorter than 4 GiB.
        let place = Place {
            offset: u32::try_from(offset).unwrap_or(u32::MAX),
            length: u32::try_from(length).unwrap_or(u32::MAX),
        };
        (offset..length.min(offset + PIECE_BYTES_MAX), Label { number, place: Some(place) })
    })
}

/// A message of which some pieces have come.
#[derive(Default)]
pub(super) struct Unfinished {
    number: u64,
    bytes: Vec<u8>,
}

impl Unfinished {
    /// Takes in one piece. The whole message with its last one; a piece that does not follow what
    /// has come ends that.
    pub(super) fn take<'a>(
        &mut self,
        number: u64,
        place: Place,
        piece: impl Iterator<Item = &'a [u8]>,
    ) -> Option<Vec<u8>> {
        let (offset, length) = (place.offset as usize, place.length as usize);
        if offset == 0 {
            *self = Self { number, bytes: Vec::new() };
        }
        if number != self.number || offset != self.bytes.len() {
            *self = Self::default();
            return None;
        }
        for slice in piece {
            if self.bytes.len() + slice.len() > length.min(BYTES_MAX) {
                *self = Self::default();
                return None;
            }
            self.bytes.extend_from_slice(slice);
        }
        (self.bytes.len() == length).then(|| std::mem::take(&mut self.bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The message with `skipped` of its pieces lost on the way.
    fn arrives(
        unfinished: &mut Unfinished,
        number: u64,
        message: &[u8],
        skipped: Option<usize>,
    ) -> Option<Vec<u8>> {
        let mut whole = None;
        for (index, (range, label)) in pieces(number, message.len()).enumerate() {
            let place = Label::of(&label.to_bytes())?.place?;
            if Some(index) != skipped {
                whole = unfinished.take(label.number, place, [&message[range]].into_iter());
            }
        }
        whole
    }

    fn message(length: usize) -> Vec<u8> {
        (0..length).map(|index| u8::try_from(index % 251).unwrap_or_default()).collect()
    }

    #[test]
    fn a_long_message_is_put_together_again() {
        let mut unfinished = Unfinished::default();
        for length in [PIECE_BYTES_MAX + 1, 2 * PIECE_BYTES_MAX, BYTES_MAX] {
            let sent = message(length);
            assert!(arrives(&mut unfinished, 1, &sent, None) == Some(sent), "{length}");
        }
    }

    #[test]
    fn a_message_that_lost_a_piece_never_comes_and_the_next_one_does() {
        let sent = message(4 * PIECE_BYTES_MAX);
        for skipped in 0..4 {
            let mut unfinished = Unfinished::default();
            assert_eq!(arrives(&mut unfinished, 1, &sent, Some(skipped)), None, "{skipped}");
            assert!(arrives(&mut unfinished, 2, &sent, None).as_ref() == Some(&sent), "{skipped}");
        }
    }

    #[test]
    fn pieces_of_two_messages_never_make_one() {
        let sent = message(2 * PIECE_BYTES_MAX);
        let place =
            |offset: usize| pieces(1, sent.len()).nth(offset).and_then(|(_, label)| label.place);
        let mut unfinished = Unfinished::default();
        let half = || [&sent[..PIECE_BYTES_MAX]].into_iter();
        assert_eq!(place(0).and_then(|place| unfinished.take(1, place, half())), None);
        assert_eq!(place(1).and_then(|place| unfinished.take(2, place, half())), None);
        assert_eq!(
            place(1).and_then(|place| unfinished.take(1, place, half())),
            None,
            "what had come has ended"
        );
    }

    #[test]
    fn no_more_is_kept_than_was_announced_or_can_be() {
        let much = message(PIECE_BYTES_MAX);
        let (short, huge) =
            (Place { offset: 0, length: 10 }, Place { offset: 0, length: u32::MAX });
        let mut unfinished = Unfinished::default();
        assert_eq!(unfinished.take(1, short, [&much[..]].into_iter()), None);
        assert!(unfinished.bytes.is_empty());
        let endless = std::iter::repeat_n(&much[..], BYTES_MAX / PIECE_BYTES_MAX + 1);
        assert_eq!(unfinished.take(1, huge, endless), None);
        assert!(unfinished.bytes.is_empty());
    }

    #[test]
    fn what_is_no_label_is_taken_for_none() {
        let whole = Label { number: 7, place: None };
        assert_eq!(Label::of(&7_u64.to_le_bytes()), Some(whole));
        assert_eq!(whole.to_bytes(), 7_u64.to_le_bytes());
        for length in (0..24).filter(|length| ![8, 16].contains(length)) {
            assert_eq!(Label::of(&vec![1; length]), None, "{length}");
        }
    }
}
