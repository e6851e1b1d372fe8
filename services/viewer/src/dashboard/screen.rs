//! Takes the terminal and restores it: at the end, on errors, and on panics.

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

/// Whether the terminal is taken: it is restored once.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The terminal of this process.
#[derive(Debug)]
pub struct Screen {
    /// Never dropped. Its destructor reports on the standard error that a closed terminal cannot be
    /// restored, and panics because the standard error is closed too.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
}

impl Screen {
    /// Takes the terminal. Its content is restored when this value is dropped, or when this thread
    /// panics.
    ///
    /// # Errors
    /// The error of the system. The terminal is then unchanged.
    pub fn take() -> io::Result<Self> {
        give_back_on_panic();
        let terminal = Terminal::new(CrosstermBackend::new(io::stdout()))?;
        enable_raw_mode()?;
        TAKEN.store(true, Ordering::Release);
        // From here on the terminal is restored in every case.
        let screen = Self { terminal: ManuallyDrop::new(terminal) };
        execute!(io::stdout(), EnterAlternateScreen, Hide)?;
        Ok(screen)
    }

    /// Shows what `draw` draws.
    ///
    /// # Errors
    /// The error of the system.
    pub fn draw(&mut self, draw: impl FnOnce(&mut Frame<'_>)) -> io::Result<()> {
        self.terminal.draw(draw).map(|_| ())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        give_back();
    }
}

/// If the terminal is closed, the failure to restore it is not reported.
fn give_back() {
    if TAKEN.swap(false, Ordering::AcqRel) {
        let _ = execute!(io::stdout(), Show, LeaveAlternateScreen);
        let _ = disable_raw_mode();
    }
}

/// A panic of this thread is reported after the terminal is restored. A panic of another thread is
/// not reported: it would spoil the picture, and it does not end the program.
fn give_back_on_panic() {
    let (drawing, before) = (thread::current().id(), panic::take_hook());
    panic::set_hook(Box::new(move |info| {
        if thread::current().id() == drawing {
            give_back();
        }
        if !TAKEN.load(Ordering::Acquire) {
            before(info);
        }
    }));
}
