//! The messages between the processes of Coxswain, and the carriers that move them.
//!
//! | module      | what it holds                                                        |
//! |-------------|----------------------------------------------------------------------|
//! | [`message`] | one file per message: plain data, units, layout                      |
//! | [`frame`]   | bytes ↔ message in memory: version, kind, checksum, then the values  |
//! | [`wire`]    | the same on the network, where numbers are little-endian and packed  |
//! | [`topic`]   | the one table of topics and their quality of service                 |
//! | [`port`]    | [`Source`](port::Source) and [`Sink`](port::Sink) over every carrier |
//! | [`view`]    | each message as JSON, with its JSON Schema                           |
//! | [`telemetry`] | what anyone may watch, over zenoh                                   |
//! | [`access`]  | who may say and hear what on the network, and by which certificate   |
//! | [`clock`]   | the monotonic clock that stamps carry                                |
//! | [`threads`] | the threads with which zenoh reads and writes its links              |
//!
//! There is no mathematics here.

pub mod access;
pub mod clock;
pub mod frame;
pub mod message;
pub mod port;
mod reason;
pub mod telemetry;
pub mod threads;
pub mod topic;
pub mod view;
pub mod wire;

/// Version of all messages. Peers of another version are refused.
pub const VERSION: u16 = 5;
