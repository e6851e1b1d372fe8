//! iceoryx2 alone: as many bytes, in place, with events, and nothing else.

use super::{Failure, LONG};
use criterion::Criterion;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{Config, FileName, Node, NodeBuilder, Path as CarrierPath, SemanticString, SignalHandlingMode, ipc};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::sync::mpsc;
use std::thread;

/// Ends the echo.
const LAST: u64 = u64::MAX;

/// One thread's end: it reads from one service and writes to the other.
struct End {
    publisher: Publisher<ipc::Service, [u64], ()>,
    notifier: Notifier<ipc::Service>,
    subscriber: Subscriber<ipc::Service, [u64], ()>,
    listener: Listener<ipc::Service>,
    words: usize,
}

impl End {
    fn open(config: &Config, [from, to]: [&str; 2], words: usize, depth: usize) -> Result<Self, Failure> {
        let node = NodeBuilder::new().config(config).signal_handling_mode(SignalHandlingMode::Disabled).create::<ipc::Service>()?;
        let messages = |name: &str| -> Result<_, Failure> {
            Ok(node.service_builder(&name.try_into()?).publish_subscribe::<[u64]>().subscriber_max_buffer_size(depth).open_or_create()?)
        };
        let events = |node: &Node<ipc::Service>, name: &str| -> Result<_, Failure> {
            Ok(node.service_builder(&name.try_into()?).event().open_or_create()?)
        };
        Ok(Self {
            publisher: messages(to)?.publisher_builder().initial_max_slice_len(words).create()?,
            notifier: events(&node, to)?.notifier_builder().create()?,
            subscriber: messages(from)?.subscriber_builder().create()?,
            listener: events(&node, from)?.listener_builder().create()?,
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

    fn hear(&self) -> Result<u64, Failure> {
        loop {
            if let Some(sample) = self.subscriber.receive()? {
                return Ok(sample.payload().first().copied().unwrap_or(0));
            }
            self.listener.timed_wait(|_| {}, LONG)?;
        }
    }
}

/// Messages of so many words, of which so many can wait.
pub(crate) fn measure(criterion: &mut Criterion, folder: &Path, name: &str, words: usize, depth: usize) -> Result<(), Failure> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(format!("bare{}.", std::process::id()).as_bytes())?;
    config.global.set_root_path(&CarrierPath::new(folder.join(format!("bare-{name}")).as_os_str().as_bytes())?);
    thread::scope(|scope| -> Result<(), Failure> {
        let (ready, is_ready) = mpsc::channel();
        let config = &config;
        let echo = scope.spawn(move || -> Result<(), Failure> {
            let end = End::open(config, ["there", "back"], words, depth)?;
            ready.send(())?;
            loop {
                let number = end.hear()?;
                end.say(number)?;
                if number == LAST {
                    return Ok(());
                }
            }
        });
        let end = End::open(config, ["back", "there"], words, depth)?;
        is_ready.recv()?;
        let mut number = 0;
        let mut failure = None;
        criterion.bench_function(&format!("round trip/iceoryx2 alone, {name}"), |bencher| {
            bencher.iter(|| {
                number += 1;
                match end.say(number).and_then(|()| end.hear()) {
                    Ok(answer) if answer == number => {}
                    Ok(_) => failure = Some("another number came back".into()),
                    Err(error) => failure = Some(error),
                }
            });
        });
        end.say(LAST)?;
        end.hear()?;
        echo.join().map_err(|_| "the echo panicked")??;
        failure.map_or(Ok(()), Err)
    })?;
    // One small file stays behind after a clean exit.
    let prefix = format!("bare{}.", std::process::id());
    for entry in std::fs::read_dir("/dev/shm")? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(&prefix) {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}
