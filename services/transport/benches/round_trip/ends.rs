//! The ends of bare libraries, for measurements beside them.

use super::Failure;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{
    Config, FileName, NodeBuilder, Path as CarrierPath, SemanticString, SignalHandlingMode, ipc,
};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::time::{Duration, Instant};

/// One end: it reads from one service and writes to the other.
pub(crate) struct End {
    publisher: Publisher<ipc::Service, [u64], ()>,
    notifier: Notifier<ipc::Service>,
    subscriber: Subscriber<ipc::Service, [u64], ()>,
    listener: Listener<ipc::Service>,
    words: usize,
}

impl End {
    /// Opens an end in `folder`. Its files in shared memory begin with `prefix`. Messages have a
    /// fixed number of words, and a fixed number of them can wait.
    pub(crate) fn open(
        folder: &Path,
        prefix: &str,
        [from, to]: [&str; 2],
        words: usize,
        depth: usize,
    ) -> Result<Self, Failure> {
        let mut config = Config::default();
        config.global.prefix = FileName::new(prefix.as_bytes())?;
        config.global.set_root_path(&CarrierPath::new(folder.as_os_str().as_bytes())?);
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()?;
        let messages = |name: &str| -> Result<_, Failure> {
            Ok(node
                .service_builder(&name.try_into()?)
                .publish_subscribe::<[u64]>()
                .subscriber_max_buffer_size(depth)
                .open_or_create()?)
        };
        let events = |name: &str| -> Result<_, Failure> {
            Ok(node.service_builder(&name.try_into()?).event().open_or_create()?)
        };
        Ok(Self {
            publisher: messages(to)?.publisher_builder().initial_max_slice_len(words).create()?,
            notifier: events(to)?.notifier_builder().create()?,
            subscriber: messages(from)?.subscriber_builder().create()?,
            listener: events(from)?.listener_builder().create()?,
            words,
        })
    }

    pub(crate) fn say(&self, number: u64) -> Result<(), Failure> {
        let mut sample = self.publisher.loan_slice(self.words)?;
        sample.payload_mut().fill(number);
        sample.send()?;
        self.notifier.notify()?;
        Ok(())
    }

    /// The next message, if it arrives within `patience`.
    pub(crate) fn receive(&self, patience: Duration) -> Result<Option<u64>, Failure> {
        let end = Instant::now() + patience;
        loop {
            if let Some(sample) = self.subscriber.receive()? {
                return Ok(Some(sample.payload().first().copied().unwrap_or(0)));
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            // The listener may wake up for a message that has been received already.
            self.listener.timed_wait(|_| {}, left)?;
        }
    }
}

/// Removes the remains in shared memory: one small file stays behind after a clean exit.
pub(crate) fn sweep(prefix: &str) {
    let files = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    for file in files.filter(|file| file.file_name().to_string_lossy().starts_with(prefix)) {
        let _ = std::fs::remove_file(file.path());
    }
}
