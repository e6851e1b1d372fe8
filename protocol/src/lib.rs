//! The messages between the processes of Coxswain, and their topics.
//!
//! | module      | what it holds                                                        |
//! |-------------|----------------------------------------------------------------------|
//! | [`message`] | one file per message: plain data, units, layout                      |
//! | [`frame`]   | bytes ↔ message in memory: version, kind, checksum, then the values  |
//! | [`wire`]    | the same on the network, where numbers are little-endian and packed  |
//! | [`topic`]   | the one table of topics and their quality of service                 |
//! | [`view`]    | each message as JSON, with its JSON Schema                           |
//! | [`clock`]   | the monotonic clock that stamps carry                                |
//!
//! There is no mathematics here.

pub mod clock;
pub mod frame;
pub mod message;
pub mod topic;
pub mod view;
pub mod wire;

/// Version of all messages. Peers of another version are refused.
pub const VERSION: u16 = 11;
