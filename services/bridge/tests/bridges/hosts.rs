//! Hosts with a bridge each, and peers that are none.

use crate::certificates::Authority;
use crate::relay::Relay;
use access::{Credentials, from_here};
use bridge::settings::{Meeting, Remote, Settings};
use network::{Client, guarded, over_tls};
use process::Run;
use protocol::message::{Health, Participant, Phase};
use protocol::topic::{OnTopic, Topic};
use serde_json::{Value, json};
use std::error::Error;
use std::fs;
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use transport::{HeldLinks, Identity, Links, Ports, Since, Source, sweep};
use zenoh::qos::CongestionControl;
use zenoh::{Config, Wait};

pub(crate) type Failure = Box<dyn Error + Send + Sync>;
pub(crate) type Outcome = Result<(), Failure>;

/// Longer than any test machine needs.
pub(crate) const LONG: Duration = Duration::from_mins(1);
/// Long enough to notice that an event does not happen.
pub(crate) const BRIEF: Duration = Duration::from_millis(400);
const GRAPH: &str = "g";
const PERIOD_NANOS: u64 = 20_000_000;

/// One host: its shared memory, and the settings of its bridge. The links are removed with it.
pub(crate) struct Host {
    pub(crate) settings: Settings,
    pub(crate) ports: Ports,
    _held: HeldLinks,
    remains: Remains,
}

struct Remains {
    links: Links,
    folder: TempDir,
}

impl Drop for Remains {
    fn drop(&mut self) {
        // A failed test must leave no remains beside its message.
        let _ = sweep(&self.links);
    }
}

impl Host {
    fn new(name: &str, lock_step: bool, remote: Remote) -> Result<Self, Failure> {
        static HOSTS: AtomicU32 = AtomicU32::new(0);
        let folder = tempfile::tempdir()?;
        let graph = format!("b{}-{}", std::process::id(), HOSTS.fetch_add(1, Ordering::Relaxed));
        let patience = u64::try_from(LONG.as_millis())?;
        let root = folder.path().join("r");
        let links = Links::on_this_machine(graph, root, lock_step, patience);
        let ports = Ports::open(&links, Identity::new(1))?;
        let mut run = Run::new(folder.path(), PERIOD_NANOS, links.clone());
        run.scheduling.real_time_priority = Some(0);
        Ok(Self {
            settings: Settings {
                requests: None,
                run,
                graph: GRAPH.to_owned(),
                host: name.to_owned(),
                processes: processes(name),
                remotes: vec![remote],
                credentials: None,
            },
            _held: ports.hold_links()?,
            ports,
            remains: Remains { links, folder },
        })
    }

    /// A reader that was there before the writers.
    pub(crate) fn source<T: OnTopic>(&self) -> Result<Source<T>, Failure> {
        let mut source = self.ports.source(Since::First)?;
        source.wait(Duration::ZERO)?;
        Ok(source)
    }

    /// Starts the bridge.
    pub(crate) fn start(&self) -> Result<Bridge, Failure> {
        let file = self.remains.folder.path().join("bridge.toml");
        fs::write(&file, toml::to_string(&self.settings)?)?;
        let healths = self.ports.source(Since::Joining)?;
        let child = Command::new(env!("CARGO_BIN_EXE_bridge"))
            .arg("--settings")
            .arg(file)
            .arg("--stop-with-stdin")
            .stdin(Stdio::piped())
            .spawn()?;
        Ok(Bridge { child, healths })
    }
}

/// A running bridge. It is killed when this is dropped.
pub(crate) struct Bridge {
    child: Child,
    healths: Source<Health>,
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Bridge {
    /// Waits for a heartbeat of this process that is as wanted.
    pub(crate) fn until(&mut self, wanted: impl Fn(&Health) -> bool) -> Result<Health, Failure> {
        let begin = Instant::now();
        let mut last = None;
        while begin.elapsed() < LONG {
            if let Some(status) = self.child.try_wait()? {
                return Err(format!("the bridge has ended: {status}").into());
            }
            self.healths.wait(Duration::from_millis(100))?;
            while let Some(health) = self.healths.next()? {
                if health.pid != self.child.id() {
                    continue;
                }
                if wanted(&health) {
                    return Ok(health);
                }
                last = Some((health.phase(), health.refused, health.received));
            }
        }
        Err(format!("the bridge does not become as wanted; last: {last:?}").into())
    }

    pub(crate) fn is_running(&mut self) -> Result<Health, Failure> {
        self.until(|health| health.phase() == Phase::Running)
    }

    /// Messages of `topic` that it has refused, once there are `count` at least.
    pub(crate) fn refuses(&mut self, topic: Topic, count: u64) -> Result<u64, Failure> {
        let index = topic.index();
        Ok(self.until(|health| health.refused[index] >= count)?.refused[index])
    }
}

/// Every topic crosses between `robot` and `control`.
pub(crate) fn processes(host: &str) -> Vec<Participant> {
    use Participant::{Bridge, Controller, Learner, Plant, Recorder};
    if host == "robot" { vec![Plant, Learner, Bridge] } else { vec![Controller, Recorder, Bridge] }
}

fn remote(host: &str, meeting: Meeting) -> Remote {
    let processes = processes(host);
    Remote { host: host.to_owned(), processes, driver: false, lists: None, meeting }
}

/// Two hosts, of which `control` listens.
pub(crate) struct Pair {
    pub(crate) robot: Host,
    pub(crate) control: Host,
    /// Port of `control`.
    pub(crate) port: u16,
}

impl Pair {
    pub(crate) fn new(lock_step: bool) -> Result<Self, Failure> {
        Self::of_paces([lock_step; 2])
    }

    /// Whether each of robot and control is in lock step.
    pub(crate) fn of_paces([robot, control]: [bool; 2]) -> Result<Self, Failure> {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        Ok(Self {
            robot: Host::new(
                "robot",
                robot,
                remote("control", Meeting::Connect(endpoint.clone())),
            )?,
            control: Host::new("control", control, remote("robot", Meeting::Listen(endpoint)))?,
            port,
        })
    }

    /// The robot connects over a relay.
    pub(crate) fn relayed(lock_step: bool) -> Result<(Self, Relay), Failure> {
        let mut pair = Self::new(lock_step)?;
        let relay = Relay::to(pair.port)?;
        let meeting = Meeting::Connect(format!("tcp/127.0.0.1:{}", relay.port));
        pair.robot.settings.remotes = vec![remote("control", meeting)];
        Ok((pair, relay))
    }

    /// The robot connects over a relay that lets so many bytes per second pass.
    pub(crate) fn slow(bytes_per_s: u64) -> Result<(Self, Relay), Failure> {
        let (pair, relay) = Self::relayed(false)?;
        relay.limit(bytes_per_s);
        Ok((pair, relay))
    }

    /// With certificates.
    pub(crate) fn guarded(authority: &Authority) -> Result<Self, Failure> {
        let mut pair = Self::new(false)?;
        for host in [&mut pair.robot, &mut pair.control] {
            host.settings.credentials = Some(authority.of_host(&host.settings.host)?);
        }
        Ok(pair)
    }

    /// Starts both bridges, and waits until they are connected.
    pub(crate) fn start(&self) -> Result<[Bridge; 2], Failure> {
        let mut bridges = [self.robot.start()?, self.control.start()?];
        for bridge in &mut bridges {
            bridge.is_running()?;
        }
        Ok(bridges)
    }

    /// Starts the bridge of `control` alone, and waits until it listens.
    pub(crate) fn alone(&self) -> Result<Bridge, Failure> {
        let mut bridge = self.control.start()?;
        bridge.until(|health| health.phase() == Phase::Ready)?;
        Ok(bridge)
    }

    /// A zenoh client in the place of the robot. It fails if it is refused.
    pub(crate) fn client(&self, credentials: Option<&Credentials>) -> Result<Peer, Failure> {
        let endpoint = from_here(&format!("tcp/127.0.0.1:{}", self.port));
        let endpoint = if credentials.is_some() { over_tls(&endpoint) } else { endpoint };
        let settings: [(&str, Value); 6] = [
            ("mode", json!("client")),
            ("connect/endpoints", json!([endpoint])),
            ("connect/timeout_ms", json!(0)),
            ("connect/exit_on_failure", json!(true)),
            ("scouting/multicast/enabled", json!(false)),
            ("scouting/gossip/enabled", json!(false)),
        ];
        let mut config = Config::default();
        for (key, value) in settings {
            config.insert_json5(key, &value.to_string())?;
        }
        if let Some(credentials) = credentials {
            config = guarded(config, credentials, &[])?;
        }
        Ok(Peer { session: Client::open(config)? })
    }
}

/// A zenoh client.
pub(crate) struct Peer {
    pub(crate) session: Client,
}

impl Peer {
    /// Puts `payloads` with their attachments in order, on the key of `what` from robot to control,
    /// as soon as the bridge of control subscribes to it.
    pub(crate) fn put<'a>(
        &self,
        what: &str,
        payloads: impl IntoIterator<Item = (&'a [u8], Option<&'a [u8]>)>,
    ) -> Outcome {
        let publisher = self
            .session
            .declare_publisher(format!("coxswain-link/{GRAPH}/robot/control/{what}"))
            .congestion_control(CongestionControl::Block)
            .wait()?;
        let begin = Instant::now();
        while !publisher.matching_status().wait()?.matching() {
            if begin.elapsed() > LONG {
                return Err(format!("the bridge does not subscribe to {what}").into());
            }
            thread::sleep(Duration::from_millis(5));
        }
        for (payload, attachment) in payloads {
            publisher.put(payload).attachment(attachment).wait()?;
        }
        Ok(())
    }

    /// Tells that it is a bridge of this version and pace.
    pub(crate) fn hello(&self, version: u16, lock_step: bool) -> Outcome {
        let hello = json!({ "version": version, "instance": 1, "lock_step": lock_step });
        let hello = hello.to_string();
        self.put("hello", [(hello.as_bytes(), None)])
    }
}

/// The next message that is as wanted.
pub(crate) fn receive<T: OnTopic>(
    source: &mut Source<T>,
    wanted: impl Fn(&T) -> bool,
) -> Result<T, Failure> {
    loop {
        if !source.wait(LONG)? {
            return Err(format!("no such {} comes; {:?}", T::NAME, source.tally()).into());
        }
        while let Some(message) = source.next()? {
            if wanted(&message) {
                return Ok(message);
            }
        }
    }
}

/// Whether no message comes for a while.
pub(crate) fn is_silent<T: OnTopic>(source: &mut Source<T>) -> Result<bool, Failure> {
    thread::sleep(BRIEF);
    Ok(source.next()?.is_none())
}
