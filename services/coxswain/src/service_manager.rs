//! launcher → service manager: that the graph is ready, that its loop turns, that it ends. The protocol of `sd_notify(3)`.
//!
//! | said           | when                                                                                                     |
//! |----------------|----------------------------------------------------------------------------------------------------------|
//! | `READY=1`      | every process of the launch is ready                                                                     |
//! | `WATCHDOG=1`   | four times per `WATCHDOG_USEC`, if since the last time the loops of plant and controller, as far as they  |
//! |                | belong to this launch, have each turned at least once                                                    |
//! | `STOPPING=1`   | the processes are asked to end                                                                           |
//!
//! A loop's own thread tells the launcher its heartbeats: who hangs is silent, and what is silent feeds no watchdog. All of it happens on the
//! launcher's thread, and nobody is waited for: what the service manager does not take is not said.

use protocol::message::Participant;
use std::collections::BTreeMap;
use std::env;
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Where the service manager listens, how long it waits for the watchdog to be fed, and by which process. Not handed on to processes of the graph.
pub const VARIABLES: [&str; 3] = ["NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"];

/// The watchdog is fed so often while it waits.
const FEEDS: u32 = 4;

/// Whoever has started this launch and wants to know how it is; most often nobody.
#[derive(Debug, Default)]
pub struct ServiceManager {
    socket: Option<UnixDatagram>,
    watchdog: Option<Watchdog>,
}

/// When the watchdog is fed, and by whom.
#[derive(Debug)]
struct Watchdog {
    every: Duration,
    next: Option<Instant>,
    /// Whose loops must turn, and how far each had come when it was fed last.
    loops: BTreeMap<Participant, Option<(u32, u64)>>,
}

impl ServiceManager {
    /// The one that the environment names, of a launch whose loops are those of `roles`.
    ///
    /// # Errors
    /// If it names one that cannot be reached: it would wait in vain.
    pub fn of_environment(roles: &[Participant]) -> io::Result<Self> {
        let [socket, patience, pid] = VARIABLES.map(env::var_os);
        let ours = pid.is_none_or(|pid| pid == OsStr::new(&std::process::id().to_string()));
        Self::reach(socket, patience.filter(|_| ours), roles)
    }

    fn reach(
        socket: Option<OsString>,
        patience_micros: Option<OsString>,
        roles: &[Participant],
    ) -> io::Result<Self> {
        let Some(name) = socket.filter(|name| !name.is_empty()) else { return Ok(Self::default()) };
        let address = match name.as_bytes().strip_prefix(b"@") {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(&name)?,
        };
        let socket = UnixDatagram::unbound()?;
        socket.connect_addr(&address)?;
        socket.set_nonblocking(true)?;
        let micros = patience_micros
            .and_then(|micros| micros.to_str()?.parse().ok())
            .filter(|&micros: &u64| micros > 0);
        let watchdog =
            micros.map(|micros| Watchdog::new(Duration::from_micros(micros) / FEEDS, roles));
        Ok(Self { socket: Some(socket), watchdog })
    }

    /// Every process is ready.
    pub fn ready(&self) {
        self.say("READY=1");
    }

    /// Feeds the watchdog at `now`, if it is time and the loops have turned, of which `heard` says the process and its heartbeats.
    pub fn feed(&mut self, heard: impl FnMut(Participant) -> Option<(u32, u64)>, now: Instant) {
        if self.watchdog.as_mut().is_some_and(|watchdog| watchdog.is_fed(heard, now)) {
            self.say("WATCHDOG=1");
        }
    }

    /// The processes are asked to end.
    pub fn stopping(&self) {
        self.say("STOPPING=1");
    }

    fn say(&self, what: &str) {
        let Some(socket) = &self.socket else { return };
        if let Err(error) = socket.send(what.as_bytes()) {
            tracing::warn!(%error, what, "the service manager could not be told");
        }
    }
}

impl Watchdog {
    /// Fed by the loops that drive the robot; where there is none of them, by all that there are.
    fn new(every: Duration, roles: &[Participant]) -> Self {
        let drives =
            |role: &Participant| matches!(role, Participant::Plant | Participant::Controller);
        let any = roles.iter().any(drives);
        let loops =
            roles.iter().filter(|role| !any || drives(role)).map(|&role| (role, None)).collect();
        Self { every, next: None, loops }
    }

    /// Whether it is time, and every loop has turned since it was so last.
    fn is_fed(
        &mut self,
        heard: impl FnMut(Participant) -> Option<(u32, u64)>,
        now: Instant,
    ) -> bool {
        if self.next.is_some_and(|next| now < next) {
            return false;
        }
        let beats: Vec<Option<(u32, u64)>> = self.loops.keys().copied().map(heard).collect();
        if self.loops.values().zip(&beats).any(|(before, beats)| beats.is_none() || beats == before)
        {
            return false;
        }
        self.loops.values_mut().zip(beats).for_each(|(before, beats)| *before = beats);
        self.next = Some(now + self.every);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVERY: Duration = Duration::from_secs(1);

    #[test]
    fn the_watchdog_is_fed_by_every_loop_that_drives_and_by_none_that_stands_still() {
        let mut watchdog = Watchdog::new(EVERY, Participant::ALL);
        let begin = Instant::now();
        let mut fed = |seconds: u32, plant, controller: Option<(u32, u64)>| {
            let heard = |role| match role {
                Participant::Plant => Some(plant),
                Participant::Controller => controller,
                _ => None,
            };
            watchdog.is_fed(heard, begin + EVERY * seconds)
        };
        assert!(!fed(0, (1, 5), None), "nothing has been heard of the controller");
        assert!(fed(1, (1, 6), Some((2, 1))));
        assert!(!fed(1, (1, 7), Some((2, 2))), "it is not time");
        assert!(!fed(2, (1, 8), Some((2, 1))), "the controller hangs");
        assert!(!fed(9, (1, 99), Some((2, 1))), "and goes on hanging");
        assert!(fed(10, (1, 100), Some((3, 1))), "another has taken its place");
        assert!(!fed(11, (1, 100), Some((3, 2))), "the gate hangs");
        assert!(fed(12, (1, 101), Some((3, 2))));
    }

    #[test]
    fn a_launch_without_a_loop_that_drives_is_watched_by_what_it_has() {
        let mut watchdog = Watchdog::new(EVERY, &[Participant::Recorder, Participant::Gateway]);
        let now = Instant::now();
        assert!(!watchdog.is_fed(|role| (role == Participant::Recorder).then_some((1, 1)), now));
        assert!(watchdog.is_fed(|_| Some((1, 1)), now));
    }

    #[test]
    fn it_is_reached_by_path_and_by_abstract_name_and_one_that_is_not_there_is_an_error()
    -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("notify");
        let name = format!("coxswain-test-{}", std::process::id());
        for (listener, socket) in [
            (UnixDatagram::bind(&path)?, path.clone().into_os_string()),
            (
                UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name)?)?,
                format!("@{name}").into(),
            ),
        ] {
            ServiceManager::reach(Some(socket), Some("4000000".into()), &[Participant::Plant])?
                .ready();
            let mut said = [0; 64];
            let length = listener.recv(&mut said)?;
            assert_eq!(said.get(..length), Some(&b"READY=1"[..]));
        }
        assert!(
            ServiceManager::reach(Some(folder.path().join("nobody").into()), None, &[]).is_err()
        );
        assert!(
            ServiceManager::reach(None, Some("1".into()), &[])
                .is_ok_and(|nobody| nobody.socket.is_none())
        );
        Ok(())
    }

    #[test]
    fn a_service_manager_that_takes_nothing_holds_nobody_up() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("notify");
        let _deaf = UnixDatagram::bind(&path)?;
        let manager = ServiceManager::reach(Some(path.into()), None, &[])?;
        // Far more than its queue holds: who waited would wait for ever.
        (0..10_000).for_each(|_| manager.ready());
        Ok(())
    }
}
