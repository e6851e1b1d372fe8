//! `coxswain watch` on a terminal: telemetry and keys → pictures.
//!
//! | module           | what it holds                                                 |
//! |------------------|---------------------------------------------------------------|
//! | [`picture`]      | what was received → what is shown                             |
//! | [`trail`]        | a bounded history                                             |
//! | [`view`]         | keys → which picture, which part of the map; the list of keys |
//! | [`look`]         | colours, or none                                              |
//! | [`panel`]        | the picture → cells, one module per panel                     |
//! | [`screen`]       | takes the terminal and restores it                            |
//! | `receive_thread` | the thread that receives telemetry                            |
//! | `driving`        | keys → the robot, while the view drives it                    |
//!
//! Keys also have their own thread, because the library that reads them never returns once the
//! terminal is closed.

mod driving;
pub mod look;
pub mod panel;
pub mod picture;
mod receive_thread;
pub mod screen;
#[cfg(test)]
mod specimen;
pub mod trail;
pub mod view;

use crate::{WatchError, WatchTarget};
use driving::Driving;
use look::Look;
use network::telemetry::Telemetry;
use picture::Picture;
use process::Stop;
use ratatui::crossterm::event::{self, KeyEvent};
use receive_thread::ReceiveThread;
use rustix::io::Errno;
use screen::Screen;
use std::io;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::thread;
use std::time::{Duration, Instant};
use teleop::steer::Join;
use view::{AfterKey, View};

/// Time between two pictures. Keys take effect at once.
const FRAME: Duration = Duration::from_millis(100);
/// Longest time between two steps of driving.
const STEP: Duration = Duration::from_millis(10);
/// Largest number of waiting events.
const WAITING_MAX: usize = 256;

/// An input of the loop.
enum Event {
    /// A message of a robot or process.
    Telemetry(Telemetry),
    /// The endpoint that is watched from now on.
    At(String),
    /// A pressed key, or a new size of the terminal.
    Terminal(event::Event),
    /// Keys cannot be read any more.
    Deaf(io::Error),
}

/// Shows what `target` publishes until the user or `stop` requests the end, or the terminal is
/// closed. `join` joins a launch on this machine, to drive it.
///
/// # Errors
/// [`WatchError`] if there is nothing to watch at the start, or the terminal cannot be used. The
/// terminal is restored in either case.
pub fn run(target: WatchTarget, stop: &Stop, join: &Join<'_>) -> Result<(), WatchError> {
    let (watcher, endpoint) = target.open()?;
    let (events, received) = mpsc::sync_channel(WAITING_MAX);
    let mut screen = Screen::take().map_err(WatchError::Terminal)?;
    let keys = events.clone();
    thread::spawn(move || read_keys(&keys));
    let thread = ReceiveThread::begin(target.clone(), watcher, events);
    let mut shown =
        Shown { view: View::new(Picture::new(&endpoint)), driving: Driving::new(join), target };
    let watched = shown.watch(&mut screen, &received, stop);
    shown.driving.end();
    drop((screen, received));
    thread.end();
    match watched {
        // The terminal is closed, so there is nothing to report to.
        Err(error) if has_gone(&error) => Ok(()),
        watched => watched.map_err(WatchError::Terminal),
    }
}

/// What the keys act on.
struct Shown<'a> {
    view: View,
    driving: Driving<'a>,
    target: WatchTarget,
}

impl Shown<'_> {
    fn watch(
        &mut self,
        screen: &mut Screen,
        received: &Receiver<Event>,
        stop: &Stop,
    ) -> io::Result<()> {
        let look = Look::of_environment();
        let mut next = Instant::now();
        while !stop.requested() {
            let now = Instant::now();
            self.driving.step(now);
            if now >= next {
                self.view.live().look(now);
                self.view.driven(self.driving.line(now), self.driving.is_on());
                screen.draw(|frame| panel::draw(frame, &self.view, look, now))?;
                next = now + FRAME;
            }
            let wait = next.saturating_duration_since(Instant::now());
            let wait = if self.driving.is_on() { wait.min(STEP) } else { wait };
            match received.recv_timeout(wait) {
                Ok(Event::Telemetry(telemetry)) => {
                    self.view.live().receive(telemetry, Instant::now());
                }
                Ok(Event::At(endpoint)) => self.view.live().endpoint = endpoint,
                Ok(Event::Terminal(event)) => {
                    let press = |key| self.press(key, Instant::now());
                    if event.as_key_event().map(press) == Some(AfterKey::Quit) {
                        return Ok(());
                    }
                    next = now;
                }
                Ok(Event::Deaf(error)) => return Err(error),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
        }
        Ok(())
    }

    /// A key of driving, while the view drives, or else one of the view.
    fn press(&mut self, key: KeyEvent, now: Instant) -> AfterKey {
        if self.driving.press(&key, now) {
            return AfterKey::Watch;
        }
        let after_key = self.view.press(key, now);
        if after_key == AfterKey::Drive && !self.driving.is_on() {
            let run = self.target.run_at(&self.view.live().endpoint);
            self.driving.begin(run.as_deref());
        }
        after_key
    }
}

/// Forwards key events until the receiver is dropped.
fn read_keys(events: &SyncSender<Event>) {
    loop {
        let event = event::read();
        let over = event.is_err();
        if events.send(event.map_or_else(Event::Deaf, Event::Terminal)).is_err() || over {
            return;
        }
    }
}

/// Whether the terminal is closed, or is a pipe without a reader.
fn has_gone(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::BrokenPipe
        || error.raw_os_error() == Some(Errno::IO.raw_os_error())
}
