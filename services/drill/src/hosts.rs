//! Hosts and cables between them: network namespaces if the system permits them, else a relay on
//! the loopback.
//!
//! The namespaces have no name. Each lives as long as a process is in it. At first this is a
//! process that waits for the end of its input. Its input ends when the process that made it ends
//! for any reason.

use process::go_before_everything;
use protocol::VERSION;
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Port of the bridge on the first host, in its own namespace.
const PORT: u16 = 7447;
/// How often a relay checks the state of its cable.
const LOOK: Duration = Duration::from_millis(10);
/// Most bytes that a relay copies at once, and that a slow cable carries at once.
const COPIED_BYTES: usize = 64 * 1024;
const PACKET_BYTES: usize = 1500;
/// Depth of the token bucket of a slow cable: packets within this time pass at once.
const BURST: Duration = Duration::from_millis(1);
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
    Loopback { port: u16, relay: u16, cable: Arc<Mutex<Cable>> },
}

/// State of the cable to host 1. The last two need a relay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cable {
    /// It carries everything.
    Plugged,
    /// It carries nothing, and neither end is notified.
    Pulled,
    /// It carries this many bits per second in each direction.
    Slow(u64),
    /// Each bridge receives the other's hello with another protocol version.
    OtherVersion,
    /// The hosts are gone.
    Gone,
}

impl Hosts {
    /// Two hosts.
    ///
    /// # Errors
    /// If not even the loopback has free ports.
    pub fn new() -> io::Result<Self> {
        Self::with_others(1)
    }

    /// Two hosts with a relay between them.
    ///
    /// # Errors
    /// If the loopback has no free ports.
    pub fn with_relay() -> io::Result<Self> {
        Ok(Self { place: relay()? })
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
            Place::Loopback { .. } => "a relay on the loopback",
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
        self.set(Cable::Pulled)
    }

    /// Restores the connection to host 1.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn plug_cable(&self) -> io::Result<()> {
        self.set(Cable::Plugged)
    }

    /// Sets the state of the cable to host 1.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn set(&self, state: Cable) -> io::Result<()> {
        match &self.place {
            // Only the far end goes down. The near end keeps its address, as it does when the cable
            // is pulled at the neighbour.
            Place::Namespaces(_, others) => {
                let state = if state == Cable::Plugged { "up" } else { "down" };
                let moved = others.first().and_then(|far| far.ip(&["link", "set", "cable", state]));
                moved.ok_or_else(|| io::Error::other("the cable cannot be switched"))?;
            }
            Place::Loopback { cable, .. } => {
                *cable.lock().unwrap_or_else(PoisonError::into_inner) = state;
            }
        }
        Ok(())
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        if let Place::Loopback { cable, .. } = &self.place {
            *cable.lock().unwrap_or_else(PoisonError::into_inner) = Cable::Gone;
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
    let port = crate::port::free()?;
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let relay = listener.local_addr()?.port();
    listener.set_nonblocking(true)?;
    let cable = Arc::new(Mutex::new(Cable::Plugged));
    thread::spawn({
        let cable = Arc::clone(&cable);
        move || loop {
            let state = *cable.lock().unwrap_or_else(PoisonError::into_inner);
            if state == Cable::Gone {
                return;
            }
            let met = (state != Cable::Pulled).then(|| listener.accept().ok()).flatten();
            // The first host may not listen yet.
            if met.is_none_or(|(near, _)| join(near, port, &cable).is_err()) {
                thread::sleep(LOOK);
            }
        }
    });
    Ok(Place::Loopback { port, relay, cable })
}

/// Copies both ways between `near` and `port`, each on a thread of its own.
fn join(near: TcpStream, port: u16, cable: &Arc<Mutex<Cable>>) -> io::Result<()> {
    let far = TcpStream::connect(("127.0.0.1", port))?;
    near.set_nonblocking(false)?;
    for stream in [&near, &far] {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(LOOK))?;
    }
    for (from, to) in [(near.try_clone()?, far.try_clone()?), (far, near)] {
        let cable = Arc::clone(cable);
        thread::spawn(move || {
            // A cable does not wait for a processor.
            go_before_everything();
            // It ends as soon as one end does.
            let _ = forward(&from, &to, &cable);
            let _ = to.shutdown(Shutdown::Both);
        });
    }
    Ok(())
}

/// Copies bytes until an end closes, as the state of the cable permits.
fn forward(mut from: &TcpStream, mut to: &TcpStream, cable: &Mutex<Cable>) -> io::Result<()> {
    let mut buffer = vec![0; COPIED_BYTES];
    let mut is_free_at = Instant::now();
    let now = || *cable.lock().unwrap_or_else(PoisonError::into_inner);
    loop {
        let most = if matches!(now(), Cable::Slow(_)) { PACKET_BYTES } else { COPIED_BYTES };
        let read = from.read(buffer.get_mut(..most).unwrap_or_default());
        // A pulled cable keeps what arrives, also what a read from before returns, and an end.
        let state = loop {
            match now() {
                Cable::Gone => return Ok(()),
                Cable::Pulled => thread::sleep(LOOK),
                state => break state,
            }
        };
        let count = match read {
            Ok(0) => return Ok(()),
            Ok(count) => count,
            Err(error)
                if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) =>
            {
                continue;
            }
            Err(error) => return Err(error),
        };
        let bytes = buffer.get_mut(..count).unwrap_or_default();
        if state == Cable::OtherVersion {
            change_version(bytes);
        }
        if let Cable::Slow(bits_per_s) = state {
            let takes = Duration::from_secs_f64(8.0 * count as f64 / bits_per_s as f64);
            is_free_at = is_free_at.max(Instant::now()) + takes;
            let wait = is_free_at.saturating_duration_since(Instant::now());
            if wait > BURST {
                thread::sleep(wait);
            }
        }
        to.write_all(bytes)?;
    }
}

/// Changes the protocol version of each hello in `bytes`. A hello is JSON, see `WIRE.md`.
fn change_version(bytes: &mut [u8]) {
    let own = format!("\"version\":{VERSION},");
    // As many digits as the own one.
    let other = format!("\"version\":{},", VERSION ^ 1);
    for start in 0..bytes.len().saturating_sub(own.len()) {
        if let Some(hello) = bytes.get_mut(start..start + own.len())
            && hello == own.as_bytes()
        {
            hello.copy_from_slice(other.as_bytes());
        }
    }
}
