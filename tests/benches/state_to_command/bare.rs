//! The libraries alone: as many bytes to another process and back, with events, and nothing else.

use super::{Failure, LONG, bare_folder};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{Config, FileName, NodeBuilder, Path as CarrierPath, SemanticString, SignalHandlingMode, ipc};
use process::{PRIORITY, go_first};
use protocol::clock::monotonic_nanos;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;
use zenoh::pubsub::Subscriber as ZenohSubscriber;
use zenoh::{Session, Wait};

/// Messages that can wait.
const DEPTH: usize = 4;

/// A process that says again what it hears.
pub(super) struct Echo {
    child: Child,
    way: Way,
}

enum Way {
    Iceoryx2 { end: Box<End>, prefix: String },
    Zenoh { session: Session, heard: Receiver<()>, bytes: usize, _ears: ZenohSubscriber<()> },
}

impl Echo {
    pub(super) fn of_iceoryx2(home: &Path, bytes: usize) -> Result<Self, Failure> {
        let folder = bare_folder(home);
        std::fs::create_dir_all(&folder)?;
        let prefix = format!("bare{}.", std::process::id());
        let words = bytes.div_ceil(size_of::<u64>());
        let end = End::open(&folder, &prefix, ["back", "there"], words)?;
        let child = start(&["iceoryx2", &folder.to_string_lossy(), &prefix, &words.to_string()])?;
        let echo = Self { child, way: Way::Iceoryx2 { end: Box::new(end), prefix } };
        echo.begin()
    }

    pub(super) fn of_zenoh(endpoint: &str, bytes: usize) -> Result<Self, Failure> {
        let session = client(endpoint)?;
        let (note, heard) = mpsc::channel();
        let ears = session.declare_subscriber("bare/back").callback(move |_| note.send(()).unwrap_or_default()).wait()?;
        let child = start(&["zenoh", endpoint])?;
        Self { child, way: Way::Zenoh { session, heard, bytes, _ears: ears } }.begin()
    }

    /// Until both ends know each other, messages go nowhere.
    fn begin(self) -> Result<Self, Failure> {
        while !self.answers(Duration::from_millis(100))? {}
        Ok(self)
    }

    /// There and back \[ns\].
    pub(super) fn round(&self) -> Result<u64, Failure> {
        let begin = monotonic_nanos();
        if self.answers(LONG)? { Ok(monotonic_nanos() - begin) } else { Err("the echo does not answer".into()) }
    }

    fn answers(&self, patience: Duration) -> Result<bool, Failure> {
        match &self.way {
            Way::Iceoryx2 { end, .. } => {
                end.say(1)?;
                Ok(end.hear(patience)?.is_some())
            }
            Way::Zenoh { session, heard, bytes, .. } => {
                session.put("bare/there", vec![1_u8; *bytes]).wait()?;
                Ok(heard.recv_timeout(patience).is_ok())
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
            let files = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
            for file in files.filter(|file| file.file_name().to_string_lossy().starts_with(prefix.as_str())) {
                let _ = std::fs::remove_file(file.path());
            }
        }
    }
}

fn start(arguments: &[&str]) -> Result<Child, Failure> {
    Ok(Command::new(std::env::current_exe()?).arg("--echo").args(arguments).stdin(Stdio::piped()).spawn()?)
}

/// The other process.
pub(super) fn answer(arguments: &[String]) -> Result<(), Failure> {
    go_first(PRIORITY);
    match arguments {
        [library, folder, prefix, words, ..] if library == "iceoryx2" => {
            let end = End::open(Path::new(folder), prefix, ["there", "back"], words.parse()?)?;
            let ended = std::thread::spawn(|| std::io::copy(&mut std::io::stdin(), &mut std::io::sink()));
            while !ended.is_finished() {
                if let Some(number) = end.hear(Duration::from_millis(200))? {
                    end.say(number)?;
                }
            }
            Ok(())
        }
        [library, endpoint, ..] if library == "zenoh" => {
            let session = client(endpoint)?;
            let echo = session.clone();
            let back = move |sample: zenoh::sample::Sample| drop(echo.put("bare/back", sample.payload().clone()).wait());
            let _ears = session.declare_subscriber("bare/there").callback(back).wait()?;
            std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
            Ok(())
        }
        _ => Err("expected iceoryx2 with folder, prefix and words, or zenoh with an endpoint".into()),
    }
}

fn client(endpoint: &str) -> Result<Session, Failure> {
    let mut config = zenoh::Config::default();
    for (key, value) in [("mode", "\"client\""), ("scouting/multicast/enabled", "false"), ("scouting/gossip/enabled", "false")] {
        config.insert_json5(key, value)?;
    }
    config.insert_json5("connect/endpoints", &format!("[\"{endpoint}\"]"))?;
    zenoh::open(config).wait()
}

/// One end: it reads from one service and writes to the other.
struct End {
    publisher: Publisher<ipc::Service, [u64], ()>,
    notifier: Notifier<ipc::Service>,
    subscriber: Subscriber<ipc::Service, [u64], ()>,
    listener: Listener<ipc::Service>,
    words: usize,
}

impl End {
    fn open(folder: &Path, prefix: &str, [from, to]: [&str; 2], words: usize) -> Result<Self, Failure> {
        let mut config = Config::default();
        config.global.prefix = FileName::new(prefix.as_bytes())?;
        config.global.set_root_path(&CarrierPath::new(folder.as_os_str().as_bytes())?);
        let node = NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled).create::<ipc::Service>()?;
        let messages = |name: &str| -> Result<_, Failure> {
            Ok(node.service_builder(&name.try_into()?).publish_subscribe::<[u64]>().subscriber_max_buffer_size(DEPTH).open_or_create()?)
        };
        let events = |name: &str| -> Result<_, Failure> { Ok(node.service_builder(&name.try_into()?).event().open_or_create()?) };
        Ok(Self {
            publisher: messages(to)?.publisher_builder().initial_max_slice_len(words).create()?,
            notifier: events(to)?.notifier_builder().create()?,
            subscriber: messages(from)?.subscriber_builder().create()?,
            listener: events(from)?.listener_builder().create()?,
            words,
        })
    }

    fn say(&self, number: u64) -> Result<(), Failure> {
        let mut sample = self.publisher.loan_slice(self.words)?;
        sample.payload_mut().fill(number);
        sample.send()?;
        self.notifier.notify()?;
        Ok(())
    }

    fn hear(&self, patience: Duration) -> Result<Option<u64>, Failure> {
        for wait in [true, false] {
            if let Some(sample) = self.subscriber.receive()? {
                return Ok(Some(sample.payload().first().copied().unwrap_or(0)));
            }
            if wait {
                self.listener.timed_wait(|_| {}, patience)?;
            }
        }
        Ok(None)
    }
}
