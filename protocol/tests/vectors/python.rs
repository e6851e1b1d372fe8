//! Definitions of the messages → the classes of the Python client.

use protocol::VERSION;
use protocol::message::field::{Allowed, Wire};
use protocol::topic::{OnTopic, Visit, visit_all};
use std::fmt::Write;

const HEAD: &str = r#""""The messages of WIRE.md, except ModelSnapshot.

Written from the definitions in protocol/src/message by
`cargo test --workspace --test vectors -- --ignored`.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from .encoding import REAL, U32, U64, numbers, one_of, record, sequence, several, text, varint

"#;

const STAMP: &str = r#"

@dataclass(frozen=True)
class Stamp:
    """The writer and time of a message."""

    writer: Annotated[int, U64]
    epoch: Annotated[int, U64]
    sequence: Annotated[int, U64]
    tick: Annotated[int, U64]
    sent_nanos: Annotated[int, U64]


STAMP = record(Stamp)
"#;

/// The file `messages.py`.
pub(crate) fn messages() -> String {
    let mut classes = Classes(format!("{HEAD}VERSION = {VERSION}\n{STAMP}"), Vec::new());
    visit_all(&mut classes);
    let Classes(text, names) = classes;
    format!("{text}\n\nALL = ({})\n", names.join(", "))
}

struct Classes(String, Vec<&'static str>);

impl Visit for Classes {
    fn visit<T: OnTopic>(&mut self) {
        if T::NAME == "ModelSnapshot" {
            return;
        }
        let Self(text, names) = self;
        names.push(T::NAME);
        // Writing to a string does not fail.
        let _ = write!(text, "\n\n@dataclass(frozen=True)\nclass {}:\n", T::NAME);
        let _ = write!(text, "    \"\"\"The message on the topic {}.\"\"\"\n\n", T::TOPIC.name());
        let _ = writeln!(text, "    KIND: ClassVar[int] = {}", T::KIND);
        let _ = writeln!(text, "    stamp: Annotated[Stamp, STAMP]");
        for field in T::fields() {
            if let Some((kind, codec)) = codec(field.wire, field.allowed) {
                let _ = writeln!(text, "    {}: Annotated[{kind}, {codec}]", field.name);
            }
        }
    }
}

/// Type and codec of a field that is sent.
fn codec(wire: Wire, allowed: Allowed) -> Option<(&'static str, String)> {
    Some(match wire {
        Wire::Nothing => return None,
        Wire::U32 => {
            let codec = match allowed {
                Allowed::Any => "U32".to_owned(),
                Allowed::UpTo(limit) => format!("varint({})", limit + 1),
                Allowed::OneOf(codes) => format!("one_of({codes:?})"),
            };
            ("int", codec)
        }
        Wire::U64 => ("int", "U64".to_owned()),
        Wire::Counts(count) => ("tuple[int, ...]", format!("several(U64, {count})")),
        Wire::Real => ("float", "REAL".to_owned()),
        Wire::Reals(count) => ("tuple[float, ...]", format!("numbers({count})")),
        Wire::Grid(rows, count) => {
            ("tuple[tuple[float, ...], ...]", format!("several(numbers({count}), {rows})"))
        }
        Wire::Rows(most, count) => {
            ("tuple[tuple[float, ...], ...]", format!("sequence(numbers({count}), {most})"))
        }
        Wire::Text(most) => ("str", format!("text({most})")),
    })
}
