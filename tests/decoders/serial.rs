//! Bytes of a serial port → lines of a base.

use super::{Fate, Verdict, promise, refused};
use serial_base::line::{LINE_MAX, Refusal, SensorLine, VelocityLine};
use serial_base::port::Lines;

/// A line that is accepted has the same content when it is sent again.
pub(super) fn line(bytes: &[u8]) -> Verdict {
    let mut verdict = refused("no line");
    let end = b"\n".as_slice();
    Lines::default().take(&[bytes, end].concat(), |line| {
        verdict = verdict.clone().and_then(|fate| match used(line)? {
            Fate::Used => Ok(Fate::Used),
            Fate::Refused => Ok(fate),
        });
    });
    verdict
}

fn used(line: &[u8]) -> Verdict {
    promise(line.len() <= LINE_MAX, || format!("a line of {} bytes", line.len()))?;
    let refusal = match (SensorLine::decode(line), VelocityLine::decode(line)) {
        (Ok(sensed), Err(Refusal::Foreign)) => {
            let again = sent(|text| sensed.encode(text));
            return same(SensorLine::decode(&again) == Ok(sensed));
        }
        (Err(Refusal::Foreign), Ok(velocity)) => {
            let again = sent(|text| velocity.encode(text));
            return same(VelocityLine::decode(&again) == Ok(velocity));
        }
        (Err(refusal), Err(_)) => refusal,
        both => return Err(format!("a line of two kinds: {both:?}")),
    };
    refused(&refusal.to_string())
}

fn sent(encode: impl FnOnce(&mut String)) -> Vec<u8> {
    let mut text = String::new();
    encode(&mut text);
    text.trim_end().as_bytes().to_vec()
}

fn same(is_same: bool) -> Verdict {
    promise(is_same, || "a line that is sent again has other content".into())?;
    Ok(Fate::Used)
}
