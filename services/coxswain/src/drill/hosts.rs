//! Two hosts and a cable: network namespaces where the system permits them, else a relay on the loopback that falls silent.
//!
//! The namespaces have no name. Each lives as long as somebody is in it: at first a process that waits for the end of its input, which comes when
//! whoever made it ends, however that happens.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Port of the router on the first host, in its own namespace.
const PORT: u16 = 7447;
/// How often a relay looks whether its cable is in.
const LOOK: Duration = Duration::from_millis(10);
/// Far longer than it takes to make a namespace.
const MADE_WITHIN: Duration = Duration::from_secs(10);

/// Two hosts that a cable connects.
#[derive(Debug)]
pub struct Hosts {
    place: Place,
}

/// A network of its own, and the process that is there first. It ends with this value.
#[derive(Debug)]
struct Namespace(Child);

#[derive(Debug)]
enum Place {
    /// Two namespaces.
    Namespaces([Namespace; 2]),
    /// Ports of the first host and of the relay before it.
    Loopback { port: u16, relay: u16, silent: Arc<AtomicBool>, closed: Arc<AtomicBool> },
}

impl Hosts {
    /// Two hosts of their own.
    ///
    /// # Errors
    /// If not even the loopback has free ports.
    pub fn new() -> io::Result<Self> {
        let place = match Namespace::connected() {
            Some(both) => Place::Namespaces(both),
            None => relay()?,
        };
        Ok(Self { place })
    }

    /// What they are, in a person's words.
    pub fn kind(&self) -> &'static str {
        match &self.place {
            Place::Namespaces(_) => "two network namespaces and a cable between them",
            Place::Loopback { .. } => "a relay on the loopback, which falls silent: network namespaces are not permitted",
        }
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
        let Place::Namespaces(both) = &self.place else { return command };
        let Some(namespace) = both.get(host) else { return command };
        let mut there = namespace.enter();
        there.arg(command.get_program()).args(command.get_args());
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
                far.ip(&["link", "set", "cable", state]).ok_or_else(|| io::Error::other("the cable does not move"))?;
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
    /// Two of them, with a cable; none if the system does not permit it.
    fn connected() -> Option<[Self; 2]> {
        let (near, far) = (Self::new()?, Self::new()?);
        let there = far.0.id().to_string();
        near.ip(&["link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", &there])?;
        for (host, address) in [(&near, "10.99.0.1/24"), (&far, "10.99.0.2/24")] {
            host.ip(&["address", "add", address, "dev", "cable"])?;
            host.ip(&["link", "set", "cable", "up"])?;
            host.ip(&["link", "set", "lo", "up"])?;
        }
        Some([near, far])
    }

    fn new() -> Option<Self> {
        let network = |process: &str| fs::read_link(format!("/proc/{process}/ns/net")).ok();
        let ours = network("self")?;
        let mut first = Command::new("unshare");
        first.args(["--net", "cat"]).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
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

    /// What begins a command there.
    fn enter(&self) -> Command {
        let mut there = Command::new("nsenter");
        there.arg(format!("--net=/proc/{}/ns/net", self.0.id()));
        there
    }

    fn ip(&self, arguments: &[&str]) -> Option<()> {
        let mut there = self.enter();
        there.arg("ip").args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        there.status().ok()?.success().then_some(())
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
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
