//! The keys of a terminal, until a key or a signal ends it.

use super::steering::Steering;
use super::way::Way;
use super::{DriveError, DriveOptions};
use crossterm::event::{self, Event};
use crossterm::terminal::{disable_raw_mode, enable_raw_mode, size};
use process::Stop;
use std::io::{self, IsTerminal};
use std::panic;
use std::path::Path;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};
use teleop::dead_man::{DeadMan, Speeds};
use teleop::keys::{KEYS, Key};
use terminal::Terminal;

/// Longest wait for a key.
const PATIENCE: Duration = Duration::from_millis(50);
/// The same, while a request waits for its reply.
const REPLY_PATIENCE: Duration = Duration::from_millis(5);

/// Drives by the keys of the standard input.
///
/// # Errors
/// [`DriveError`]. The terminal is restored in any case.
pub(super) fn run(options: &DriveOptions, base: &Path) -> Result<(), DriveError> {
    if !io::stdin().is_terminal() {
        return Err(DriveError::NoTerminal);
    }
    let mut speeds = Speeds::default();
    if let Some(speed) = options.speed {
        if !(speed.is_finite() && speed > 0.0) {
            return Err(DriveError::Speed { speed });
        }
        speeds.ground_mps = speed;
    }
    let dead_man = DeadMan::new(Duration::from_secs_f64(options.dead_man_s), speeds);
    let way = match Way::over_network(&options.to, options.stop_at.as_deref())? {
        Some(way) => way,
        None => Way::on_this_machine(options.to.run.as_deref(), base, Instant::now())?,
    };
    let mut steering = Steering::new(way, dead_man);
    let stop = Stop::new();
    stop.on_signals().map_err(DriveError::Terminal)?;
    let raw = RawMode::begin().map_err(DriveError::Terminal)?;
    let mut terminal = Terminal::new();
    for (keys, what) in KEYS {
        terminal.say(format_args!("{keys:<14}{what}"));
    }
    terminal.say("The line shows forward, left [m/s] and turning [rad/s].");
    let driven = steer(&mut steering, &read_keys(), &stop, &mut terminal);
    let stands = steering.end();
    terminal.say("driving by keyboard has ended");
    drop(raw);
    driven.and(stands)
}

fn steer(
    steering: &mut Steering,
    events: &Receiver<io::Result<Event>>,
    stop: &Stop,
    terminal: &mut Terminal,
) -> Result<(), DriveError> {
    while !stop.requested() {
        let patience = if steering.waits() { REPLY_PATIENCE } else { PATIENCE };
        let key = match events.recv_timeout(patience) {
            Ok(event) => event.map_err(DriveError::Terminal)?.as_key_event(),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        };
        let now = Instant::now();
        let key = key.and_then(|key| Key::of(&key));
        if key == Some(Key::End) {
            return Ok(());
        }
        let changed = key.map_or(Ok(None), |key| steering.press(key, now))?;
        for news in [changed, steering.step(now)?].into_iter().flatten() {
            terminal.say(news);
        }
        terminal.progress(now, || Some(fitted(&steering.line(now))));
    }
    Ok(())
}

/// As much of `line` as the terminal has columns.
fn fitted(line: &str) -> String {
    let columns = size().map_or(usize::MAX, |(columns, _)| usize::from(columns));
    line.chars().take(columns.saturating_sub(1)).collect()
}

/// Reads keys on a thread of its own, until the process ends: the library never returns once the
/// terminal is closed.
fn read_keys() -> Receiver<io::Result<Event>> {
    let (events, received) = mpsc::channel();
    thread::spawn(move || {
        loop {
            let event = event::read();
            let is_over = event.is_err();
            if events.send(event).is_err() || is_over {
                return;
            }
        }
    });
    received
}

/// Raw mode of the terminal, until this value is dropped or a thread panics.
struct RawMode;

impl RawMode {
    fn begin() -> io::Result<Self> {
        enable_raw_mode()?;
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            let _ = disable_raw_mode();
            before(info);
        }));
        Ok(Self)
    }
}

impl Drop for RawMode {
    fn drop(&mut self) {
        let _ = disable_raw_mode();
    }
}
