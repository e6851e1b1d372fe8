//! A program on a terminal of its own: a pseudo-terminal, and the text on it.

use crate::{Outcome, wait_until};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Termios, Winsize, tcgetattr, tcsetwinsize};
use std::error::Error;
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// How often its reader checks whether it should stop.
const PATIENCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };

/// A frame is drawn within much less, and the next begins after more.
const MOMENT: Duration = Duration::from_millis(30);

/// The program and its terminal; it ends with this value.
pub struct Screen {
    child: Child,
    /// The terminal's other end; none once it is unplugged.
    plug: Option<Plug>,
    emulator: Arc<Mutex<vt100::Parser>>,
    /// The program's end, held so that it can be examined after the program has ended.
    terminal: Option<OwnedFd>,
    before: Termios,
}

struct Plug {
    writer: File,
    done: Arc<AtomicBool>,
    /// Set when there was nothing to read.
    dry: Arc<AtomicBool>,
    reader: JoinHandle<()>,
}

impl Screen {
    /// Starts `command` as the first program of a session on a terminal of its own.
    ///
    /// # Errors
    /// If no terminal is available, or the program cannot be started.
    pub fn start(command: &Command, (columns, rows): (u16, u16)) -> Result<Self, Box<dyn Error>> {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&ours)?;
        unlockpt(&ours)?;
        let theirs = open(
            ptsname(&ours, Vec::new())?,
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        tcsetwinsize(&theirs, window(columns, rows))?;
        let before = tcgetattr(&theirs)?;
        let end = || theirs.try_clone().map(Stdio::from);
        let mut session = Command::new("setsid");
        session.arg("--ctty").arg(command.get_program()).args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => session.env(name, value),
                None => session.env_remove(name),
            };
        }
        let child = session.stdin(end()?).stdout(end()?).stderr(end()?).spawn()?;
        let emulator = Arc::new(Mutex::new(vt100::Parser::new(rows, columns, 0)));
        let (done, dry, writer) =
            (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default(), File::from(ours));
        let reader = thread::spawn({
            let (mut output, emulator, [done, dry]) =
                (writer.try_clone()?, Arc::clone(&emulator), [&done, &dry].map(Arc::clone));
            move || read(&mut output, &emulator, &done, &dry)
        });
        Ok(Self {
            child,
            plug: Some(Plug { writer, done, dry, reader }),
            emulator,
            terminal: Some(theirs),
            before,
        })
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The text on the screen.
    pub fn text(&self) -> String {
        lock(&self.emulator).screen().contents()
    }

    /// The screen itself.
    pub fn with<T>(&self, look: impl FnOnce(&vt100::Screen) -> T) -> T {
        look(lock(&self.emulator).screen())
    }

    /// Waits until the text on the screen satisfies `condition`.
    ///
    /// # Errors
    /// If it never does, or the program ends; the error contains the last screen.
    pub fn wait(
        &mut self,
        what: &str,
        condition: impl Fn(&str) -> bool,
    ) -> Result<String, Box<dyn Error>> {
        let mut text = String::new();
        let mut ended = None;
        let waited = wait_until(what, || {
            ended = self.child.try_wait().ok().flatten();
            text = self.text();
            condition(&text) || ended.is_some()
        });
        waited.map_err(|error| format!("{error}:\n{text}"))?;
        if condition(&text) {
            Ok(text)
        } else {
            Err(format!("{ended:?} without {what}:\n{text}").into())
        }
    }

    /// Waits until `words` are on the screen.
    ///
    /// # Errors
    /// As [`wait`](Self::wait).
    pub fn wait_for(&mut self, words: &[&str]) -> Result<String, Box<dyn Error>> {
        self.wait(&format!("{words:?}"), |text| words.iter().all(|word| text.contains(word)))
    }

    /// The text on the screen, not in the middle of a change.
    ///
    /// # Errors
    /// If it changes all the time.
    pub fn settled(&self) -> Result<String, Box<dyn Error>> {
        let mut text = self.text();
        wait_until("a moment without a change", || {
            thread::sleep(MOMENT);
            let before = std::mem::replace(&mut text, self.text());
            before == text
        })?;
        Ok(text)
    }

    /// Types `keys`.
    ///
    /// # Errors
    /// The system's error.
    pub fn press(&mut self, keys: &str) -> Outcome {
        let plug = self.plug.as_mut().ok_or("the terminal is unplugged")?;
        Ok(plug.writer.write_all(keys.as_bytes())?)
    }

    /// Changes the size of the terminal.
    ///
    /// # Errors
    /// The system's error.
    pub fn resize(&mut self, (columns, rows): (u16, u16)) -> Outcome {
        lock(&self.emulator).screen_mut().set_size(rows, columns);
        let terminal = self.terminal.as_ref().ok_or("the terminal is unplugged")?;
        Ok(tcsetwinsize(terminal, window(columns, rows))?)
    }

    /// Closes the terminal, as a user closes the window.
    pub fn unplug(&mut self) {
        self.terminal = None;
        if let Some(plug) = self.plug.take() {
            plug.done.store(true, Ordering::Release);
            let _ = plug.reader.join();
        }
    }

    /// Waits until the program has ended by itself, and all its output is on the screen.
    ///
    /// # Errors
    /// If it does not in time.
    pub fn end(&mut self) -> Result<ExitStatus, Box<dyn Error>> {
        let mut status = None;
        wait_until("its end", || {
            status = self.child.try_wait().ok().flatten();
            status.is_some()
        })
        .map_err(|error| format!("{error}:\n{}", self.text()))?;
        if let Some(plug) = &self.plug {
            plug.dry.store(false, Ordering::Release);
            wait_until("the last of its output", || {
                plug.dry.load(Ordering::Acquire) || plug.reader.is_finished()
            })?;
        }
        status.ok_or_else(|| "no status".into())
    }

    /// Waits until the terminal is as it was before the program: its modes, its cursor, and its
    /// first screen.
    ///
    /// # Errors
    /// If it never is.
    pub fn wait_until_restored(&self) -> Outcome {
        let terminal = self.terminal.as_ref().ok_or("the terminal is unplugged")?;
        wait_until("the terminal as it was", || {
            let modes = tcgetattr(terminal)
                .is_ok_and(|modes| format!("{modes:?}") == format!("{:?}", self.before));
            modes && self.with(|screen| !screen.alternate_screen() && !screen.hide_cursor())
        })
        .map_err(|error| format!("{error}:\n{}", self.text()).into())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.unplug();
    }
}

fn window(columns: u16, rows: u16) -> Winsize {
    Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 }
}

/// Shows the output until it should stop or the terminal is gone.
fn read(output: &mut File, emulator: &Mutex<vt100::Parser>, done: &AtomicBool, dry: &AtomicBool) {
    let mut bytes = [0; 4096];
    while !done.load(Ordering::Acquire) {
        if poll(&mut [PollFd::new(output, PollFlags::IN)], Some(&PATIENCE)) == Ok(0) {
            dry.store(true, Ordering::Release);
            continue;
        }
        match output.read(&mut bytes) {
            Ok(0) | Err(_) => return,
            Ok(count) => lock(emulator).process(bytes.get(..count).unwrap_or_default()),
        }
    }
}

fn lock(emulator: &Mutex<vt100::Parser>) -> MutexGuard<'_, vt100::Parser> {
    emulator.lock().unwrap_or_else(PoisonError::into_inner)
}
