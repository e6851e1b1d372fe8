//! Telemetry → words, on a thread of its own: whoever waits for a robot still hears the keys.

use super::Event;
use crate::watch_command::{RETRY, WatchTarget};
use process::Stop;
use protocol::telemetry::Watcher;
use std::sync::mpsc::SyncSender;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How often the request to end is looked at.
const PATIENCE: Duration = Duration::from_millis(100);
/// How long its end is waited for. An attempt to reach a robot that is gone may take longer; it ends with the process.
const ENDS_WITHIN: Duration = Duration::from_secs(1);

/// Listens until it is ended.
pub(super) struct Ear {
    done: Stop,
    thread: JoinHandle<()>,
}

impl Ear {
    /// Passes on what `watcher` hears, and reaches out again where it hears nobody any more.
    pub(super) fn listen(target: WatchTarget, watcher: Watcher, events: SyncSender<Event>) -> Self {
        let done = Stop::new();
        let thread = thread::spawn({
            let done = done.clone();
            move || listen(&target, watcher, &events, &done)
        });
        Self { done, thread }
    }

    /// Ends it. Nobody takes in what it passes on any more.
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
            Ok(Some(word)) => events.send(Event::Said(word)),
            // A session that has failed is opened again.
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
