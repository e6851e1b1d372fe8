//! Ports of this machine for processes that do not run yet.

use std::io;
use std::net::TcpListener;
use std::sync::atomic::{AtomicU16, Ordering};

/// A port that is free until its process takes it. It is none of those that the system gives to
/// outgoing connections, so no other program takes it in the meantime.
///
/// # Errors
/// No port is free.
pub fn free() -> io::Result<u16> {
    static TRIED: AtomicU16 = AtomicU16::new(0);
    let first = (std::process::id() % 6_000) as u16 + 20_000;
    let ports = std::iter::repeat_with(|| first + TRIED.fetch_add(1, Ordering::Relaxed));
    let is_free = |port: &u16| TcpListener::bind(("127.0.0.1", *port)).is_ok();
    ports.take(1_000).find(is_free).ok_or_else(|| io::Error::other("no port is free"))
}
