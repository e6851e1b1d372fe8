//! Colours, out of the sixteen that every theme chooses for its own background, light or dark; or none.
//!
//! Whatever a colour says is also said by a word or a sign.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use std::env;

/// Whether there are colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// In the theme's own.
    Coloured,
    /// As NO_COLOR asks for, <https://no-color.org>.
    Plain,
}

impl Look {
    /// As the environment asks for.
    pub fn of_environment() -> Self {
        if env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty()) {
            Self::Plain
        } else {
            Self::Coloured
        }
    }

    /// `colour`, or the terminal's own.
    pub fn colour(self, colour: Color) -> Color {
        match self {
            Self::Coloured => colour,
            Self::Plain => Color::Reset,
        }
    }

    /// Of the driven path, and of what matters most.
    pub fn strong(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    /// Of the reference.
    pub fn reference(self) -> Color {
        self.colour(Color::Magenta)
    }

    /// Of what is predicted, of what has been learned, and of what is well.
    pub fn good(self) -> Color {
        self.colour(Color::Green)
    }

    /// Of what was before learning, and of what is not well.
    pub fn bad(self) -> Color {
        self.colour(Color::Red)
    }

    /// A word about something that is not well.
    pub fn alarm(self) -> Style {
        self.strong().fg(self.bad())
    }

    /// Greys out what was the last to be heard.
    pub fn grey_out(self, area: Rect, buffer: &mut Buffer) {
        let grey = Style::new().fg(self.colour(Color::DarkGray)).bg(Color::Reset);
        buffer.set_style(area, grey.remove_modifier(Modifier::all()).add_modifier(Modifier::DIM));
    }
}
