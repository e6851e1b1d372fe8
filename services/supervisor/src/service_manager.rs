//! launcher → service manager: the graph is ready, its loop runs, it stops. The protocol of
//! `sd_notify(3)`.
//!
//! | message      | when                                                                         |
//! |--------------|------------------------------------------------------------------------------|
//! | `READY=1`    | every process of the launch is ready                                         |
//! | `WATCHDOG=1` | four times per `WATCHDOG_USEC`, if the loops of plant and controller, as far |
//! |              | as they belong to this launch, have each run since the last message          |
//! | `STOPPING=1` | the processes are requested to stop                                          |
//!
//! The thread of a loop sends the heartbeats to the launcher. A process that hangs sends none, so
//! the launcher does not reset the watchdog. All this runs on the launcher's thread and does not
//! wait: a message that the service manager does not accept is dropped.

use protocol::message::Participant;
use std::collections::BTreeMap;
use std::env;
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Socket of the service manager, timeout of its watchdog, and process that resets the watchdog.
/// Processes of the graph do not inherit them.
pub const VARIABLES: [&str; 3] = ["NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"];

/// Number of resets of the watchdog within its timeout.
const FEEDS: u32 = 4;

/// The service manager that has started this launch, if there is one.
#[derive(Debug, Default)]
pub struct ServiceManager {
    socket: Option<UnixDatagram>,
    watchdog: Option<Watchdog>,
}

/// When the watchdog is reset, and which loops it depends on.
#[derive(Debug)]
struct Watchdog {
    every: Duration,
    next: Option<Instant>,
    /// Loops that must run, with the process and its heartbeats at the last reset.
    loops: BTreeMap<Participant, Option<(u32, u64)>>,
}

impl ServiceManager {
    /// The service manager in the environment variables, for a launch with the loops of `roles`.
    ///
    /// # Errors
    /// If the variables name one that cannot be reached: it would wait until its timeout.
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

    /// Resets the watchdog at `now`, if it is due and the loops have run. `received` returns a
    /// role's process and its heartbeats.
    pub fn feed(&mut self, received: impl FnMut(Participant) -> Option<(u32, u64)>, now: Instant) {
        if self.watchdog.as_mut().is_some_and(|watchdog| watchdog.is_fed(received, now)) {
            self.say("WATCHDOG=1");
        }
    }

    /// The processes are requested to stop.
    pub fn stopping(&self) {
        self.say("STOPPING=1");
    }

    fn say(&self, what: &str) {
        let Some(socket) = &self.socket else { return };
        if let Err(error) = socket.send(what.as_bytes()) {
            tracing::warn!(%error, what, "the service manager could not be notified");
        }
    }
}

impl Watchdog {
    /// Depends on the loops that drive the robot. A launch without them depends on all its
    /// processes.
    fn new(every: Duration, roles: &[Participant]) -> Self {
        let drives =
            |role: &Participant| matches!(role, Participant::Plant | Participant::Controller);
        let any = roles.iter().any(drives);
        let loops =
            roles.iter().filter(|role| !any || drives(role)).map(|&role| (role, None)).collect();
        Self { every, next: None, loops }
    }

    /// Whether a reset is due, and every loop has run since the last one.
    fn is_fed(
        &mut self,
        received: impl FnMut(Participant) -> Option<(u32, u64)>,
        now: Instant,
    ) -> bool {
        if self.next.is_some_and(|next| now < next) {
            return false;
        }
        let beats: Vec<Option<(u32, u64)>> = self.loops.keys().copied().map(received).collect();
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
    fn the_watchdog_is_reset_only_while_every_driving_loop_runs() {
        let mut watchdog = Watchdog::new(EVERY, Participant::ALL);
        let begin = Instant::now();
        let mut fed = |seconds: u32, plant, controller: Option<(u32, u64)>| {
            let received = |role| match role {
                Participant::Plant => Some(plant),
                Participant::Controller => controller,
                _ => None,
            };
            watchdog.is_fed(received, begin + EVERY * seconds)
        };
        assert!(!fed(0, (1, 5), None), "nothing has been received from the controller");
        assert!(fed(1, (1, 6), Some((2, 1))));
        assert!(!fed(1, (1, 7), Some((2, 2))), "it is not time");
        assert!(!fed(2, (1, 8), Some((2, 1))), "the controller hangs");
        assert!(!fed(9, (1, 99), Some((2, 1))), "and goes on hanging");
        assert!(fed(10, (1, 100), Some((3, 1))), "another has taken its place");
        assert!(!fed(11, (1, 100), Some((3, 2))), "the gate hangs");
        assert!(fed(12, (1, 101), Some((3, 2))));
    }

    #[test]
    fn a_launch_without_a_driving_loop_depends_on_its_other_processes() {
        let mut watchdog = Watchdog::new(EVERY, &[Participant::Recorder, Participant::Gateway]);
        let now = Instant::now();
        assert!(!watchdog.is_fed(|role| (role == Participant::Recorder).then_some((1, 1)), now));
        assert!(watchdog.is_fed(|_| Some((1, 1)), now));
    }

    #[test]
    fn it_is_reached_by_path_and_abstract_name_and_a_missing_socket_is_an_error() -> io::Result<()>
    {
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
            let mut message = [0; 64];
            let length = listener.recv(&mut message)?;
            assert_eq!(message.get(..length), Some(&b"READY=1"[..]));
        }
        assert!(
            ServiceManager::reach(Some(folder.path().join("nobody").into()), None, &[]).is_err()
        );
        assert!(
            ServiceManager::reach(None, Some("1".into()), &[])
                .is_ok_and(|manager| manager.socket.is_none())
        );
        Ok(())
    }

    #[test]
    fn a_service_manager_that_does_not_read_blocks_no_launch() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("notify");
        let _deaf = UnixDatagram::bind(&path)?;
        let manager = ServiceManager::reach(Some(path.into()), None, &[])?;
        // Far more than its queue holds: a sender that waits would wait forever.
        (0..10_000).for_each(|_| manager.ready());
        Ok(())
    }
}
