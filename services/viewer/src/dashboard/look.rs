//! Colours, from the sixteen that every theme adapts to its own background, light or dark; or none.
//!
//! Each colour has the same meaning as a word or a sign that is also shown.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use std::env;

/// Whether there are colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// With the colours of the theme.
    Coloured,
    /// Without colours, as NO_COLOR requests, <https://no-color.org>.
    Plain,
}

impl Look {
    /// The look that the environment requests.
    pub fn of_environment() -> Self {
        if env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty()) {
            Self::Plain
        } else {
            Self::Coloured
        }
    }

    /// `colour`, or the terminal's default colour.
    pub fn colour(self, colour: Color) -> Color {
        match self {
            Self::Coloured => colour,
            Self::Plain => Color::Reset,
        }
    }

    /// Style of the driven path, and of the most important text.
    pub fn strong(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    /// Colour of the reference.
    pub fn reference(self) -> Color {
        self.colour(Color::Magenta)
    }

    /// Colour of predictions, of learned values, and of a good status.
    pub fn good(self) -> Color {
        self.colour(Color::Green)
    }

    /// Colour of obstacles.
    pub fn obstacle(self) -> Color {
        self.colour(Color::Yellow)
    }

    /// Colour of values before learning, and of a bad status.
    pub fn bad(self) -> Color {
        self.colour(Color::Red)
    }

    /// Style of a word about a bad status.
    pub fn alarm(self) -> Style {
        self.strong().fg(self.bad())
    }

    /// Greys out the last received picture.
    pub fn grey_out(self, area: Rect, buffer: &mut Buffer) {
        let grey = Style::new().fg(self.colour(Color::DarkGray)).bg(Color::Reset);
        buffer.set_style(area, grey.remove_modifier(Modifier::all()).add_modifier(Modifier::DIM));
    }
}
