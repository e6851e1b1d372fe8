//! The terminal, taken and given back as it was: at the end, on errors, and on panics.

use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::{Hide, Show};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::{Frame, Terminal};
use std::io::{self, Stdout};
use std::mem::ManuallyDrop;
use std::panic;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

/// Whether it is taken: it is given back once.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The terminal of this process.
#[derive(Debug)]
pub struct Screen {
    /// Never dropped: it would complain on the standard error that a terminal which has gone cannot be given back, and panic as that has gone, too.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
}

impl Screen {
    /// Takes the terminal; what was on it comes back when this value goes, or when this thread panics.
    ///
    /// # Errors
    /// What the system says. The terminal is as it was then.
    pub fn take() -> io::Result<Self> {
        give_back_on_panic();
        let terminal = Terminal::new(CrosstermBackend::new(io::stdout()))?;
        enable_raw_mode()?;
        TAKEN.store(true, Ordering::Release);
        // From here on whatever happens gives it back.
        let screen = Self { terminal: ManuallyDrop::new(terminal) };
        execute!(io::stdout(), EnterAlternateScreen, Hide)?;
        Ok(screen)
    }

    /// Shows what `draw` draws.
    ///
    /// # Errors
    /// What the system says.
    pub fn draw(&mut self, draw: impl FnOnce(&mut Frame<'_>)) -> io::Result<()> {
        self.terminal.draw(draw).map(|_| ())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        give_back();
    }
}

/// Whoever has no terminal any more is not told that it cannot be given back.
fn give_back() {
    if TAKEN.swap(false, Ordering::AcqRel) {
        let _ = execute!(io::stdout(), Show, LeaveAlternateScreen);
        let _ = disable_raw_mode();
    }
}

/// A panic of this thread is told on a terminal that was given back. One of another thread would spoil the picture, and ends nothing.
fn give_back_on_panic() {
    let (drawing, before) = (thread::current().id(), panic::take_hook());
    panic::set_hook(Box::new(move |told| {
        if thread::current().id() == drawing {
            give_back();
        }
        if !TAKEN.load(Ordering::Acquire) {
            before(told);
        }
    }));
}
