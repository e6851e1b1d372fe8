//! Example of a robot driver, to be copied: a base that a microcontroller drives, over a serial
//! port.
//!
//! | module       | what it holds                                                            |
//! |--------------|--------------------------------------------------------------------------|
//! | [`mod@line`] | the line protocol: velocity with its watchdog out, measurements in       |
//! | [`port`]     | bytes of the serial port ↔ lines; never waits                            |
//! | [`base`]     | [`SerialBase`]: the [`driver::Base`] behind the port                     |
//!
//! The program `serial-firmware` of this crate is a simulated firmware at a pseudo-terminal.
//! `docs/how-to/serial-base.md` describes the protocol and shows both programs in use.

pub mod base;
pub mod line;
pub mod port;

pub use base::{SerialBase, SerialSettings};
