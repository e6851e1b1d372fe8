//! Two hosts and a cable: network namespaces where the system permits them, else a relay on the loopback that falls silent.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::Duration;

/// Port of the router on the first host, in its own namespace.
const PORT: u16 = 7447;
/// How often a relay looks whether its cable is in.
const LOOK: Duration = Duration::from_millis(10);

/// Two hosts that a cable connects.
#[derive(Debug)]
pub struct Hosts {
    place: Place,
}

#[derive(Debug)]
enum Place {
    /// Names of the two namespaces.
    Namespaces([String; 2]),
    /// Ports of the first host and of the relay before it.
    Loopback { port: u16, relay: u16, silent: Arc<AtomicBool>, closed: Arc<AtomicBool> },
}

impl Hosts {
    /// Two hosts of their own.
    ///
    /// # Errors
    /// If not even the loopback has free ports.
    pub fn new() -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let id = format!("cx{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let names = [format!("{id}a"), format!("{id}b")];
        let hosts = Self { place: Place::Namespaces(names) };
        if hosts.lay_cable().is_some() {
            return Ok(hosts);
        }
        drop(hosts);
        Ok(Self { place: relay()? })
    }

    /// Where the first host listens.
    pub fn endpoint(&self) -> String {
        match &self.place {
            Place::Namespaces(_) => format!("tcp/10.99.0.1:{PORT}"),
            Place::Loopback { port, .. } => format!("tcp/127.0.0.1:{port}"),
        }
    }

    /// The same, as the second host sees it.
    pub fn far_endpoint(&self) -> String {
        match &self.place {
            Place::Namespaces(_) => self.endpoint(),
            Place::Loopback { relay, .. } => format!("tcp/127.0.0.1:{relay}"),
        }
    }

    /// `command`, to be run on host 0 or 1.
    pub fn on(&self, host: usize, command: Command) -> Command {
        let Place::Namespaces(names) = &self.place else { return command };
        let Some(name) = names.get(host) else { return command };
        let mut there = Command::new("ip");
        there.args(["netns", "exec"]).arg(name).arg(command.get_program()).args(command.get_args());
        there
    }

    /// From now on nothing gets through, and nobody is told.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn pull_cable(&self) -> io::Result<()> {
        self.cable("down", true)
    }

    /// It does again.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn plug_cable(&self) -> io::Result<()> {
        self.cable("up", false)
    }

    fn cable(&self, state: &str, is_silent: bool) -> io::Result<()> {
        match &self.place {
            // The far end alone goes down: the near one keeps its address, as a host whose neighbour's cable is pulled does.
            Place::Namespaces([_, far]) => {
                ip(&["-n", far, "link", "set", "cable", state]).ok_or_else(|| io::Error::other("the cable does not move"))?;
            }
            Place::Loopback { silent, .. } => silent.store(is_silent, Ordering::Relaxed),
        }
        Ok(())
    }

    /// None if the system does not permit it.
    fn lay_cable(&self) -> Option<()> {
        let Place::Namespaces([near, far]) = &self.place else { return None };
        ip(&["netns", "add", near])?;
        ip(&["netns", "add", far])?;
        ip(&["-n", near, "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", far])?;
        for (name, address) in [(near, "10.99.0.1/24"), (far, "10.99.0.2/24")] {
            ip(&["-n", name, "address", "add", address, "dev", "cable"])?;
            ip(&["-n", name, "link", "set", "cable", "up"])?;
            ip(&["-n", name, "link", "set", "lo", "up"])?;
        }
        Some(())
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        match &self.place {
            Place::Namespaces(names) => {
                for name in names {
                    let _ = ip(&["netns", "delete", name]);
                }
            }
            Place::Loopback { closed, .. } => closed.store(true, Ordering::Relaxed),
        }
    }
}

fn ip(arguments: &[&str]) -> Option<()> {
    let status = Command::new("ip").args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status().ok()?;
    status.success().then_some(())
}

/// A relay before a free port.
fn relay() -> io::Result<Place> {
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let relay = listener.local_addr()?.port();
    listener.set_nonblocking(true)?;
    let (silent, closed) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    thread::spawn({
        let (silent, closed) = (Arc::clone(&silent), Arc::clone(&closed));
        move || {
            while !closed.load(Ordering::Relaxed) {
                let met = (!silent.load(Ordering::Relaxed)).then(|| listener.accept().ok()).flatten();
                let Some((near, far)) = met.and_then(|(near, _)| Some((near, TcpStream::connect(("127.0.0.1", port)).ok()?))) else {
                    thread::sleep(LOOK);
                    continue;
                };
                for (from, to) in [(near.try_clone(), far.try_clone()), (Ok(far), Ok(near))] {
                    if let (Ok(from), Ok(to)) = (from, to) {
                        let (silent, closed) = (Arc::clone(&silent), Arc::clone(&closed));
                        thread::spawn(move || carry(from, to, &silent, &closed));
                    }
                }
            }
        }
    });
    Ok(Place::Loopback { port, relay, silent, closed })
}

/// Carries bytes until an end closes, but not while the cable is out.
fn carry(mut from: TcpStream, mut to: TcpStream, silent: &AtomicBool, closed: &AtomicBool) {
    let mut bytes = vec![0; 64 * 1024];
    let _ = from.set_nonblocking(false);
    let _ = from.set_read_timeout(Some(LOOK));
    while !closed.load(Ordering::Relaxed) {
        if silent.load(Ordering::Relaxed) {
            thread::sleep(LOOK);
            continue;
        }
        match from.read(&mut bytes) {
            Ok(0) => break,
            Ok(count) => {
                if bytes.get(..count).is_none_or(|bytes| to.write_all(bytes).is_err()) {
                    break;
                }
            }
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
