//! `coxswain watch` on a terminal: telemetry and keys → pictures.
//!
//! | module      | what it holds                                                 |
//! |-------------|---------------------------------------------------------------|
//! | [`picture`] | what was heard → what is shown                                |
//! | [`trail`]   | a bounded history                                             |
//! | [`view`]    | keys → which picture, which part of the map; the list of keys |
//! | [`look`]    | colours, or none                                              |
//! | [`panel`]   | the picture → cells, one module per panel                     |
//! | [`screen`]  | the terminal, taken and given back                            |
//! | `ear`       | listens on a thread of its own                                |
//!
//! Keys are read on a thread of their own, too: the library that reads them never returns once the terminal has gone.

mod ear;
pub mod look;
pub mod panel;
pub mod picture;
pub mod screen;
#[cfg(test)]
mod specimen;
pub mod trail;
pub mod view;

use crate::watch_command::{WatchError, WatchTarget};
use ear::Ear;
use look::Look;
use picture::Picture;
use process::Stop;
use protocol::telemetry::Word;
use ratatui::crossterm::event;
use rustix::io::Errno;
use screen::Screen;
use std::io;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::thread;
use std::time::{Duration, Instant};
use view::{AfterKey, View};

/// How often the picture is drawn. Keys are answered at once.
const FRAME: Duration = Duration::from_millis(100);
/// Most events that wait to be looked at.
const WAITING_MAX: usize = 256;

/// What the loop hears of.
enum Event {
    /// A robot or process said something.
    Said(Word),
    /// It is watched here from now on.
    At(String),
    /// A key was pressed, or the terminal has another size.
    Terminal(event::Event),
    /// Keys cannot be read any more.
    Deaf(io::Error),
}

/// Shows what is received from `target` until a person or `stop` asks for the end, or the terminal has gone.
///
/// # Errors
/// [`WatchError`] if there is nothing to watch at the start, or the terminal cannot be used. It is as it was in either case.
pub fn run(target: WatchTarget, stop: &Stop) -> Result<(), WatchError> {
    let (watcher, endpoint) = target.open()?;
    let (events, heard) = mpsc::sync_channel(WAITING_MAX);
    let mut screen = Screen::take().map_err(WatchError::Terminal)?;
    let keys = events.clone();
    thread::spawn(move || read_keys(&keys));
    let ear = Ear::listen(target, watcher, events);
    let shown = show(&mut screen, &heard, &mut View::new(Picture::new(&endpoint)), stop);
    drop((screen, heard));
    ear.end();
    match shown {
        // Nobody looks any more.
        Err(error) if has_gone(&error) => Ok(()),
        shown => shown.map_err(WatchError::Terminal),
    }
}

fn show(
    screen: &mut Screen,
    heard: &Receiver<Event>,
    view: &mut View,
    stop: &Stop,
) -> io::Result<()> {
    let look = Look::of_environment();
    let mut next = Instant::now();
    while !stop.requested() {
        let now = Instant::now();
        if now >= next {
            view.live().look(now);
            screen.draw(|frame| panel::draw(frame, view, look, now))?;
            next = now + FRAME;
        }
        match heard.recv_timeout(next.saturating_duration_since(Instant::now())) {
            Ok(Event::Said(word)) => view.live().hear(word, Instant::now()),
            Ok(Event::At(endpoint)) => view.live().endpoint = endpoint,
            Ok(Event::Terminal(event)) => {
                let after_key =
                    event.as_key_event().map_or(AfterKey::Watch, |key| view.press(key, now));
                if after_key == AfterKey::Quit {
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

/// Passes on what is typed until nobody takes it in any more.
fn read_keys(events: &SyncSender<Event>) {
    loop {
        let event = event::read();
        let over = event.is_err();
        if events.send(event.map_or_else(Event::Deaf, Event::Terminal)).is_err() || over {
            return;
        }
    }
}

/// Whether the terminal is no more, or is a pipe that nobody reads.
fn has_gone(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::BrokenPipe
        || error.raw_os_error() == Some(Errno::IO.raw_os_error())
}
