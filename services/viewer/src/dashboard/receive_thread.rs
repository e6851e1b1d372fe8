//! Receives telemetry on a separate thread, so that waiting for a robot does not block the keys.

use super::Event;
use crate::{RETRY, WatchTarget};
use network::telemetry::Watcher;
use process::Stop;
use std::sync::mpsc::SyncSender;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Time between two checks whether the end was requested.
const PATIENCE: Duration = Duration::from_millis(100);
/// How long `end` waits for the thread. An attempt to connect to a robot that is gone may take
/// longer; it ends with the process.
const ENDS_WITHIN: Duration = Duration::from_secs(1);

/// The receive thread. It runs until `end`.
pub(super) struct ReceiveThread {
    done: Stop,
    thread: JoinHandle<()>,
}

impl ReceiveThread {
    /// Forwards what `watcher` receives, and connects again when the connection is lost.
    pub(super) fn begin(target: WatchTarget, watcher: Watcher, events: SyncSender<Event>) -> Self {
        let done = Stop::new();
        let thread = thread::spawn({
            let done = done.clone();
            move || listen(&target, watcher, &events, &done)
        });
        Self { done, thread }
    }

    /// Ends the thread. Its messages are not received any more.
    pub(super) fn end(self) {
        self.done.request();
        let begin = Instant::now();
        while !self.thread.is_finished() && begin.elapsed() < ENDS_WITHIN {
            thread::sleep(Duration::from_millis(5));
        }
    }
}

fn listen(target: &WatchTarget, mut watcher: Watcher, events: &SyncSender<Event>, done: &Stop) {
    while !done.requested() {
        let passed_on = match watcher.next(PATIENCE) {
            Ok(Some(telemetry)) => events.send(Event::Telemetry(telemetry)),
            // Opens a failed session again.
            _ if !watcher.is_connected() => {
                if let Ok((again, endpoint)) = target.open() {
                    watcher = again;
                    events.send(Event::At(endpoint))
                } else {
                    thread::sleep(RETRY);
                    Ok(())
                }
            }
            Ok(None) => Ok(()),
            Err(_) => {
                thread::sleep(RETRY);
                Ok(())
            }
        };
        if passed_on.is_err() {
            return;
        }
    }
}
