//! The libraries alone: as many bytes to another process and back, with events, and nothing else.

use super::ends::{End, sweep};
use super::{Failure, LONG, bare_folder};
use access::Credentials;
use network::guarded;
use process::{PRIORITY, go_first};
use protocol::clock::monotonic_nanos;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;
use zenoh::pubsub::Subscriber as ZenohSubscriber;
use zenoh::{Session, Wait};

/// Messages that can wait.
const DEPTH: usize = 4;

/// A process that sends back each message that it receives.
pub(super) struct Echo {
    child: Child,
    way: Way,
}

enum Way {
    Iceoryx2 {
        end: Box<End>,
        prefix: String,
    },
    Zenoh {
        session: Session,
        received: Receiver<()>,
        bytes: usize,
        _subscriber: ZenohSubscriber<()>,
    },
}

impl Echo {
    pub(super) fn of_iceoryx2(home: &Path, bytes: usize) -> Result<Self, Failure> {
        let folder = bare_folder(home);
        std::fs::create_dir_all(&folder)?;
        let prefix = format!("bare{}.", std::process::id());
        let words = bytes.div_ceil(size_of::<u64>());
        let end = End::open(&folder, &prefix, ["back", "there"], words, DEPTH)?;
        let child = start(&["iceoryx2", &folder.to_string_lossy(), &prefix, &words.to_string()])?;
        let echo = Self { child, way: Way::Iceoryx2 { end: Box::new(end), prefix } };
        echo.begin()
    }

    /// Two peers with the certificates in `folder`.
    pub(super) fn of_zenoh(folder: &Path, bytes: usize) -> Result<Self, Failure> {
        // Another program may take the port first; then the bench fails.
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let endpoint = format!("tls/127.0.0.1:{port}");
        let credentials = folder.join("robot-host");
        let session = peer("listen", &endpoint, &credentials)?;
        let (note, received) = mpsc::channel();
        let subscriber = session
            .declare_subscriber("bare/back")
            .callback(move |_| note.send(()).unwrap_or_default())
            .wait()?;
        let credentials = folder.join("control-host");
        let child = start(&["zenoh", &endpoint, &credentials.to_string_lossy()])?;
        Self { child, way: Way::Zenoh { session, received, bytes, _subscriber: subscriber } }
            .begin()
    }

    /// Until both ends know each other, messages are lost.
    fn begin(self) -> Result<Self, Failure> {
        while !self.answers(Duration::from_millis(100))? {}
        Ok(self)
    }

    /// Time of one round trip \[ns\].
    pub(super) fn round(&self) -> Result<u64, Failure> {
        let begin = monotonic_nanos();
        if self.answers(LONG)? {
            Ok(monotonic_nanos() - begin)
        } else {
            Err("the echo does not answer".into())
        }
    }

    fn answers(&self, patience: Duration) -> Result<bool, Failure> {
        match &self.way {
            Way::Iceoryx2 { end, .. } => {
                end.say(1)?;
                Ok(end.receive(patience)?.is_some())
            }
            Way::Zenoh { session, received, bytes, .. } => {
                session.put("bare/there", vec![1_u8; *bytes]).express(true).wait()?;
                Ok(received.recv_timeout(patience).is_ok())
            }
        }
    }
}

impl Drop for Echo {
    fn drop(&mut self) {
        // It ends with its input.
        drop(self.child.stdin.take());
        let _ = self.child.wait();
        if let Way::Iceoryx2 { prefix, .. } = &self.way {
            sweep(prefix);
        }
    }
}

fn start(arguments: &[&str]) -> Result<Child, Failure> {
    Ok(Command::new(std::env::current_exe()?)
        .arg("--echo")
        .args(arguments)
        .stdin(Stdio::piped())
        .spawn()?)
}

/// One of two peers that know each other by `endpoint` alone. `side` is listen or connect.
fn peer(side: &str, endpoint: &str, credentials: &Path) -> Result<Session, Failure> {
    let mut config = zenoh::Config::default();
    let settings = [
        ("mode", "\"peer\""),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("connect/timeout_ms", "-1"),
        ("listen/endpoints", "[]"),
    ];
    for (key, value) in settings {
        config.insert_json5(key, value)?;
    }
    config.insert_json5(&format!("{side}/endpoints"), &format!("[\"{endpoint}\"]"))?;
    zenoh::open(guarded(config, &Credentials::in_folder(credentials), &[])?).wait()
}

/// The other process.
pub(super) fn answer(arguments: &[String]) -> Result<(), Failure> {
    go_first(PRIORITY);
    match arguments {
        [library, folder, prefix, words, ..] if library == "iceoryx2" => {
            let end =
                End::open(Path::new(folder), prefix, ["there", "back"], words.parse()?, DEPTH)?;
            let ended =
                std::thread::spawn(|| std::io::copy(&mut std::io::stdin(), &mut std::io::sink()));
            while !ended.is_finished() {
                if let Some(number) = end.receive(Duration::from_millis(200))? {
                    end.say(number)?;
                }
            }
            Ok(())
        }
        [library, endpoint, credentials, ..] if library == "zenoh" => {
            let session = peer("connect", endpoint, Path::new(credentials))?;
            let echo = session.clone();
            let back = move |sample: zenoh::sample::Sample| {
                drop(echo.put("bare/back", sample.payload().clone()).express(true).wait());
            };
            let _subscriber = session.declare_subscriber("bare/there").callback(back).wait()?;
            std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
            Ok(())
        }
        _ => Err(
            "expected iceoryx2 with folder, prefix and words, or zenoh with endpoint and folder"
                .into(),
        ),
    }
}
