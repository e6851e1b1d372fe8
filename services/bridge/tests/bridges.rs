//! Real bridges on the loopback. Each is a process of its own, and each host has its own shared
//! memory.

#[path = "bridges/certificates.rs"]
mod certificates;
#[path = "bridges/delivery.rs"]
mod delivery;
#[path = "bridges/hosts.rs"]
mod hosts;
#[path = "bridges/messages.rs"]
mod messages;
#[path = "bridges/peers.rs"]
mod peers;
#[path = "bridges/relay.rs"]
mod relay;
