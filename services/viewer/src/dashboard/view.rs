//! Keys → what the user wants to see: the live or the held picture, help, the part of the map, and
//! whether the keys drive the robot.

use super::picture::{Contact, Picture};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use std::time::Instant;

/// The keys and their effects, as the help shows them. This is the only list of them.
pub const KEYS: [(&str, &str); 7] = [
    ("q  Esc  Ctrl-C", "end watching; no effect on the robot"),
    ("k", "drive the robot by keyboard, on its own machine"),
    ("space", "hold the picture, or resume it"),
    ("+  -", "zoom the map in and out"),
    ("f", "follow the robot, or show the whole path"),
    ("0", "reset the map"),
    ("?  h", "this help, and back"),
];

/// Initial width of the map \[m\].
const ACROSS_M: f64 = 10.0;
/// Smallest and largest width of the map \[m\].
const ACROSS_LIMITS_M: [f64; 2] = [0.5, 5000.0];
/// One step of the zoom.
const ZOOM: f64 = std::f64::consts::SQRT_2;

/// The part of the world that the map shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MapWindow {
    /// A map of fixed width, with the robot in the middle.
    Follow {
        /// Width of the map \[m\].
        across_m: f64,
    },
    /// The whole path.
    Whole,
}

/// Whether to continue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AfterKey {
    /// Continue to watch.
    Watch,
    /// Drive the robot by keyboard.
    Drive,
    /// Quit.
    Quit,
}

/// The picture, and the user's choices for it.
#[derive(Debug, Clone)]
pub struct View {
    live: Picture,
    held: Option<(Box<Picture>, Instant)>,
    help: bool,
    map: MapWindow,
    across_m: f64,
    driving: Option<String>,
    drives: bool,
}

impl View {
    /// The live picture; the map follows the robot.
    pub fn new(picture: Picture) -> Self {
        Self {
            live: picture,
            held: None,
            help: false,
            map: MapWindow::Follow { across_m: ACROSS_M },
            across_m: ACROSS_M,
            driving: None,
            drives: false,
        }
    }

    /// Takes the line about driving, and whether keys drive the robot now.
    pub fn driven(&mut self, line: Option<String>, drives: bool) {
        (self.driving, self.drives) = (line, drives);
    }

    /// The line about driving, if there is one.
    pub fn driving(&self) -> Option<&str> {
        self.driving.as_deref()
    }

    /// The keys that act now, with their effects.
    pub fn keys(&self) -> &'static [(&'static str, &'static str)] {
        if self.drives { &teleop::keys::KEYS } else { &KEYS }
    }

    /// The live picture, to be updated.
    pub fn live(&mut self) -> &mut Picture {
        &mut self.live
    }

    /// The picture to show at `now`, and its time.
    pub fn shown(&self, now: Instant) -> (&Picture, Instant) {
        self.held.as_ref().map_or((&self.live, now), |(picture, since)| (picture, *since))
    }

    /// Whether the robot is present at `now`, independent of the picture shown.
    pub fn contact(&self, now: Instant) -> Contact {
        self.live.contact(now)
    }

    /// Whether the picture is held.
    pub fn is_held(&self) -> bool {
        self.held.is_some()
    }

    /// Whether help is shown.
    pub fn shows_help(&self) -> bool {
        self.help
    }

    /// The part of the world that the map shows.
    pub fn map(&self) -> MapWindow {
        self.map
    }

    /// Applies a key that was pressed at `now`, as the help describes it. Other keys have no
    /// effect.
    pub fn press(&mut self, key: KeyEvent, now: Instant) -> AfterKey {
        if key.kind == KeyEventKind::Release {
            return AfterKey::Watch;
        }
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            KeyCode::Char('c' | 'C') if control => return AfterKey::Quit,
            _ if control => {}
            KeyCode::Char('q' | 'Q') | KeyCode::Esc => return AfterKey::Quit,
            KeyCode::Char('k' | 'K') => return AfterKey::Drive,
            KeyCode::Char(' ') => self.hold(now),
            KeyCode::Char('?' | 'h' | 'H') => self.help = !self.help,
            KeyCode::Char('+' | '=') => self.zoom(1.0 / ZOOM),
            KeyCode::Char('-' | '_') => self.zoom(ZOOM),
            KeyCode::Char('0') => self.follow(ACROSS_M),
            KeyCode::Char('f' | 'F') => match self.map {
                MapWindow::Whole => self.follow(self.across_m),
                MapWindow::Follow { .. } => self.map = MapWindow::Whole,
            },
            _ => {}
        }
        AfterKey::Watch
    }

    fn hold(&mut self, now: Instant) {
        self.held = match self.held {
            Some(_) => None,
            None => Some((Box::new(self.live.clone()), now)),
        };
    }

    /// Zooming also makes the map follow the robot.
    fn zoom(&mut self, factor: f64) {
        let [closest, widest] = ACROSS_LIMITS_M;
        self.follow((self.across_m * factor).clamp(closest, widest));
    }

    fn follow(&mut self, across_m: f64) {
        self.across_m = across_m;
        self.map = MapWindow::Follow { across_m };
    }
}

#[cfg(test)]
mod tests {
    use super::super::specimen;
    use super::*;

    fn press(view: &mut View, keys: &str) -> AfterKey {
        let keys = keys.chars().map(|key| KeyEvent::new(KeyCode::Char(key), KeyModifiers::NONE));
        keys.map(|key| view.press(key, Instant::now())).last().unwrap_or(AfterKey::Watch)
    }

    #[test]
    fn only_the_quit_keys_end_the_dashboard() {
        let mut view = View::new(Picture::new(""));
        let now = Instant::now();
        assert_eq!(
            view.press(KeyEvent::new(KeyCode::Esc, KeyModifiers::NONE), now),
            AfterKey::Quit
        );
        assert_eq!(
            view.press(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL), now),
            AfterKey::Quit
        );
        assert_eq!(press(&mut view, "q"), AfterKey::Quit);
        assert_eq!(press(&mut view, "c"), AfterKey::Watch);
        assert_eq!(press(&mut view, " ?h+-f0x1"), AfterKey::Watch);
        assert_eq!(
            view.press(
                KeyEvent::new_with_kind(KeyCode::Esc, KeyModifiers::NONE, KeyEventKind::Release),
                now
            ),
            AfterKey::Watch
        );
    }

    #[test]
    fn a_held_picture_stays_unchanged_while_the_live_one_is_updated() {
        let begin = Instant::now();
        let mut view = View::new(Picture::new(""));
        view.live().receive(specimen::state(1), begin);
        view.press(KeyEvent::new(KeyCode::Char(' '), KeyModifiers::NONE), begin);
        view.live().receive(specimen::state(2), begin);
        let tick = |view: &View| {
            view.shown(Instant::now()).0.run.state.as_ref().map(|state| state.stamp.tick)
        };
        assert_eq!(
            (view.is_held(), tick(&view), view.shown(Instant::now()).1),
            (true, Some(1), begin)
        );
        press(&mut view, " ");
        assert_eq!((view.is_held(), tick(&view)), (false, Some(2)));
    }

    #[test]
    fn the_map_zooms_within_limits_and_resets() {
        let mut view = View::new(Picture::new(""));
        let across = |view: &View| match view.map() {
            MapWindow::Follow { across_m } => Some(across_m),
            MapWindow::Whole => None,
        };
        press(&mut view, "++");
        assert!(across(&view).is_some_and(|across| (across - ACROSS_M / 2.0).abs() < 1e-9));
        press(&mut view, "f");
        assert_eq!(across(&view), None);
        press(&mut view, "f-");
        assert!(across(&view).is_some_and(|across| (across - ACROSS_M / ZOOM).abs() < 1e-9));
        press(&mut view, &"-".repeat(100));
        assert_eq!(across(&view), Some(ACROSS_LIMITS_M[1]));
        press(&mut view, &"+".repeat(100));
        assert_eq!(across(&view), Some(ACROSS_LIMITS_M[0]));
        press(&mut view, "0");
        assert_eq!(across(&view), Some(ACROSS_M));
    }

    #[test]
    fn the_key_to_drive_changes_nothing_by_itself() {
        let mut view = View::new(Picture::new(""));
        assert_eq!(press(&mut view, "k"), AfterKey::Drive);
        assert_eq!((view.driving(), view.keys()), (None, &KEYS[..]));
        view.driven(Some("DRIVING".into()), true);
        assert_eq!((view.driving(), view.keys()), (Some("DRIVING"), &teleop::keys::KEYS[..]));
    }

    #[test]
    fn help_opens_and_closes() {
        let mut view = View::new(Picture::new(""));
        press(&mut view, "?");
        assert!(view.shows_help());
        press(&mut view, "h");
        assert!(!view.shows_help());
    }
}
