//! A message as bytes, and back: `cargo run -p protocol --example frame`.
//!
//! These are the bytes between hosts. A changed byte is detected.

use protocol::message::{Credit, Message};
use protocol::{VERSION, wire};
use std::error::Error;
use std::io::{self, Write};

fn main() -> Result<(), Box<dyn Error>> {
    let mut credit: Credit = bytemuck::Zeroable::zeroed();
    // A sink stamps its messages by itself.
    (credit.stamp.version, credit.stamp.kind) = (VERSION, Credit::KIND);
    (credit.stamp.tick, credit.through_tick) = (42, 50);
    let mut bytes = Vec::new();
    wire::encode(&credit, &mut bytes);
    let back: Credit = wire::decode(&bytes)?;
    let mut damaged = bytes.clone();
    if let Some(last) = damaged.last_mut() {
        *last ^= 1;
    }
    let mut out = io::stdout();
    writeln!(out, "bytes {}", bytes.len())?;
    writeln!(out, "tick {} through_tick {}", back.stamp.tick, back.through_tick)?;
    writeln!(out, "damaged: {:?}", wire::decode::<Credit>(&damaged).map(|_| ()))?;
    Ok(())
}
