//! Hosts and cables between them: network namespaces if the system permits them, else a relay on
//! the loopback that stops relaying.
//!
//! The namespaces have no name. Each lives as long as a process is in it. At first this is a
//! process that waits for the end of its input. Its input ends when the process that made it ends
//! for any reason.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Port of the bridge on the first host, in its own namespace.
const PORT: u16 = 7447;
/// How often a relay checks whether its cable is plugged in.
const LOOK: Duration = Duration::from_millis(10);
/// Far longer than it takes to make a namespace.
const MADE_WITHIN: Duration = Duration::from_secs(10);

/// A first host, and others, each connected to it by a cable.
#[derive(Debug)]
pub struct Hosts {
    place: Place,
}

/// A network namespace, and the first process in it. It ends with this value.
#[derive(Debug)]
struct Namespace(Child);

#[derive(Debug)]
enum Place {
    /// The namespace of the first host, and those of the others.
    Namespaces(Namespace, Vec<Namespace>),
    /// Port of the first host, and of the relay to it.
    Loopback { port: u16, relay: u16, silent: Arc<AtomicBool>, closed: Arc<AtomicBool> },
}

impl Hosts {
    /// Two hosts.
    ///
    /// # Errors
    /// If not even the loopback has free ports.
    pub fn new() -> io::Result<Self> {
        Self::with_others(1)
    }

    /// A first host, and this many others.
    ///
    /// # Errors
    /// If not even the loopback has free ports.
    pub fn with_others(others: u8) -> io::Result<Self> {
        let place = match Namespace::connected(others) {
            Some((near, others)) => Place::Namespaces(near, others),
            None => relay()?,
        };
        Ok(Self { place })
    }

    /// What the hosts are, in words.
    pub fn kind(&self) -> &'static str {
        match &self.place {
            Place::Namespaces(..) => "network namespaces and a cable between each two",
            Place::Loopback { .. } => {
                "a relay on the loopback, which falls silent: network namespaces are not permitted"
            }
        }
    }

    /// Host and port at which the first host listens.
    pub fn address(&self) -> String {
        match &self.place {
            Place::Namespaces(..) => format!("10.99.0.1:{PORT}"),
            Place::Loopback { port, .. } => format!("127.0.0.1:{port}"),
        }
    }

    /// The same, as the second host sees it.
    pub fn far_address(&self) -> String {
        match &self.place {
            Place::Namespaces(..) => self.address(),
            Place::Loopback { relay, .. } => format!("127.0.0.1:{relay}"),
        }
    }

    /// Address of the first host on its cable to another host; `other` counts from 1.
    pub fn address_towards(&self, other: u8) -> String {
        match &self.place {
            Place::Namespaces(..) => format!("10.99.{}.1", other.saturating_sub(1)),
            Place::Loopback { .. } => "127.0.0.1".to_owned(),
        }
    }

    /// `command`, to be run on host 0, the first, or on another one.
    pub fn on(&self, host: usize, command: Command) -> Command {
        let Place::Namespaces(near, others) = &self.place else { return command };
        let Some(namespace) = host.checked_sub(1).map_or(Some(near), |other| others.get(other))
        else {
            return command;
        };
        let mut there = namespace.enter();
        there.arg(command.get_program()).args(command.get_args());
        there
    }

    /// Cuts the connection to host 1, without a notification to either end.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn pull_cable(&self) -> io::Result<()> {
        self.cable("down", true)
    }

    /// Restores the connection to host 1.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn plug_cable(&self) -> io::Result<()> {
        self.cable("up", false)
    }

    fn cable(&self, state: &str, is_silent: bool) -> io::Result<()> {
        match &self.place {
            // Only the far end goes down. The near end keeps its address, as it does when the cable
            // is pulled at the neighbour.
            Place::Namespaces(_, others) => {
                let moved = others.first().and_then(|far| far.ip(&["link", "set", "cable", state]));
                moved.ok_or_else(|| io::Error::other("the cable cannot be switched"))?;
            }
            Place::Loopback { silent, .. } => silent.store(is_silent, Ordering::Relaxed),
        }
        Ok(())
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        if let Place::Loopback { closed, .. } = &self.place {
            closed.store(true, Ordering::Relaxed);
        }
    }
}

impl Namespace {
    /// One host, and this many others with a cable to it; none if the system does not permit it.
    fn connected(others: u8) -> Option<(Self, Vec<Self>)> {
        let near = Self::new()?;
        near.ip(&["link", "set", "lo", "up"])?;
        let connect = |number: u8| {
            let far = Self::new()?;
            far.ip(&["link", "set", "lo", "up"])?;
            let (there, cable) = (far.0.id().to_string(), format!("cable{number}"));
            near.ip(&[
                "link", "add", &cable, "type", "veth", "peer", "name", "cable", "netns", &there,
            ])?;
            for (host, cable, end) in [(&near, cable.as_str(), 1), (&far, "cable", 2)] {
                host.ip(&["address", "add", &format!("10.99.{number}.{end}/24"), "dev", cable])?;
                host.ip(&["link", "set", cable, "up"])?;
            }
            Some(far)
        };
        let others = (0..others).map(connect).collect::<Option<_>>()?;
        Some((near, others))
    }

    fn new() -> Option<Self> {
        let network = |process: &str| fs::read_link(format!("/proc/{process}/ns/net")).ok();
        let ours = network("self")?;
        let mut first = Command::new("unshare");
        first
            .args(["--net", "cat"])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let mut namespace = Self(first.spawn().ok()?);
        let begin = Instant::now();
        while network(&namespace.0.id().to_string())? == ours {
            if begin.elapsed() > MADE_WITHIN || !matches!(namespace.0.try_wait(), Ok(None)) {
                return None;
            }
            thread::sleep(Duration::from_millis(1));
        }
        Some(namespace)
    }

    /// The beginning of a command in the namespace.
    fn enter(&self) -> Command {
        let mut there = Command::new("nsenter");
        there.arg(format!("--net=/proc/{}/ns/net", self.0.id()));
        there
    }

    fn ip(&self, arguments: &[&str]) -> Option<()> {
        let mut there = self.enter();
        there
            .arg("ip")
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        there.status().ok()?.success().then_some(())
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A relay in front of a free port.
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
                let met =
                    (!silent.load(Ordering::Relaxed)).then(|| listener.accept().ok()).flatten();
                let Some((near, far)) = met.and_then(|(near, _)| {
                    Some((near, TcpStream::connect(("127.0.0.1", port)).ok()?))
                }) else {
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

/// Copies bytes until an end closes, but not while the cable is pulled.
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
            Err(error)
                if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
