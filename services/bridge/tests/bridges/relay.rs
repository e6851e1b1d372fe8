//! A cable between two bridges that can be cut.

use crate::hosts::Failure;
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// A relay in front of a port of the loopback.
pub(crate) struct Relay {
    pub(crate) port: u16,
    cable: Arc<Mutex<Cable>>,
}

#[derive(Default)]
struct Cable {
    is_pulled: bool,
    is_gone: bool,
    /// 0 if there is no limit.
    bytes_per_s: u64,
    open: Vec<TcpStream>,
}

impl Cable {
    fn cut(&mut self) {
        for stream in self.open.drain(..) {
            // The other end may have closed it.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

impl Relay {
    /// Relays to `port`.
    pub(crate) fn to(port: u16) -> Result<Self, Failure> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let relay = Self { port: listener.local_addr()?.port(), cable: Arc::default() };
        let cable = Arc::clone(&relay.cable);
        thread::spawn(move || {
            while let Ok((from, _)) = listener.accept() {
                let mut cable = cable.lock().unwrap_or_else(PoisonError::into_inner);
                if cable.is_gone {
                    return;
                }
                if !cable.is_pulled {
                    // The bridge behind it may not listen yet.
                    let _ = join(&mut cable, from, port);
                }
            }
        });
        Ok(relay)
    }

    /// Ends all connections. New ones are accepted at once.
    pub(crate) fn cut(&self) {
        self.cable.lock().unwrap_or_else(PoisonError::into_inner).cut();
    }

    /// Ends all connections. There are no new ones until the cable is plugged in.
    pub(crate) fn pull(&self) {
        let mut cable = self.cable.lock().unwrap_or_else(PoisonError::into_inner);
        cable.is_pulled = true;
        cable.cut();
    }

    /// Lets so many bytes per second pass in each direction, on all later connections.
    pub(crate) fn limit(&self, bytes_per_s: u64) {
        self.cable.lock().unwrap_or_else(PoisonError::into_inner).bytes_per_s = bytes_per_s;
    }

    pub(crate) fn plug(&self) {
        self.cable.lock().unwrap_or_else(PoisonError::into_inner).is_pulled = false;
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        let mut cable = self.cable.lock().unwrap_or_else(PoisonError::into_inner);
        cable.is_gone = true;
        cable.cut();
        // Wakes the thread that accepts.
        let _ = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port));
    }
}

/// Copies both ways until one end closes.
fn join(cable: &mut Cable, from: TcpStream, port: u16) -> io::Result<()> {
    let to = TcpStream::connect((Ipv4Addr::LOCALHOST, port))?;
    for stream in [&from, &to] {
        stream.set_nodelay(true)?;
        cable.open.push(stream.try_clone()?);
    }
    let bytes_per_s = cable.bytes_per_s;
    for (mut from, mut to) in [(from.try_clone()?, to.try_clone()?), (to, from)] {
        thread::spawn(move || {
            // A cut ends it, as an error or as an end.
            let _ = if bytes_per_s == 0 {
                io::copy(&mut from, &mut to).map(drop)
            } else {
                pass(&mut from, &mut to, bytes_per_s)
            };
            let _ = [from, to].map(|stream| stream.shutdown(Shutdown::Both));
        });
    }
    Ok(())
}

/// Copies at most so many bytes per second.
fn pass(from: &mut TcpStream, to: &mut TcpStream, bytes_per_s: u64) -> io::Result<()> {
    // A few packets: what comes behind waits in the sender.
    let mut buffer = [0; 4096];
    let mut free = Instant::now();
    loop {
        let length = from.read(&mut buffer)?;
        let Some(bytes) = buffer.get(..length).filter(|bytes| !bytes.is_empty()) else {
            return Ok(());
        };
        let now = Instant::now();
        free = free.max(now) + Duration::from_nanos(length as u64 * 1_000_000_000 / bytes_per_s);
        // The last byte leaves the link at that time.
        thread::sleep(free - now);
        to.write_all(bytes)?;
    }
}
