//! A key event → what it requests.

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// The keys and their effects, as a help shows them. This is the only list of them.
pub const KEYS: [(&str, &str); 7] = [
    ("w  s  ↑  ↓", "forward, back"),
    ("a  d  ←  →", "to the left, to the right"),
    ("q  e", "turn to the left, to the right"),
    ("+  -", "faster, slower"),
    ("space", "stand"),
    ("x", "latched stop, as `coxswain stop`"),
    ("Esc  Ctrl-C", "stand, and end driving"),
];

/// Direction of a motion in the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Forward.
    Forward,
    /// Backward.
    Back,
    /// To the left, without a turn.
    Left,
    /// To the right, without a turn.
    Right,
    /// Counter-clockwise.
    TurnLeft,
    /// Clockwise.
    TurnRight,
}

/// What a key requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// Drive in a direction.
    Drive(Direction),
    /// Larger speeds.
    Faster,
    /// Smaller speeds.
    Slower,
    /// Stand, and hold the place.
    Stand,
    /// Latched stop of the gate.
    Stop,
    /// End of driving.
    End,
}

impl Key {
    /// The request of a pressed or repeated key, if it has one. Capital letters count as small
    /// ones.
    pub fn of(event: &KeyEvent) -> Option<Self> {
        if event.kind == KeyEventKind::Release {
            return None;
        }
        if event.modifiers.contains(KeyModifiers::CONTROL) {
            return matches!(event.code, KeyCode::Char('c' | 'C')).then_some(Self::End);
        }
        Some(match event.code {
            KeyCode::Up | KeyCode::Char('w' | 'W') => Self::Drive(Direction::Forward),
            KeyCode::Down | KeyCode::Char('s' | 'S') => Self::Drive(Direction::Back),
            KeyCode::Left | KeyCode::Char('a' | 'A') => Self::Drive(Direction::Left),
            KeyCode::Right | KeyCode::Char('d' | 'D') => Self::Drive(Direction::Right),
            KeyCode::Char('q' | 'Q') => Self::Drive(Direction::TurnLeft),
            KeyCode::Char('e' | 'E') => Self::Drive(Direction::TurnRight),
            KeyCode::Char('+' | '=') => Self::Faster,
            KeyCode::Char('-' | '_') => Self::Slower,
            KeyCode::Char(' ') => Self::Stand,
            KeyCode::Char('x' | 'X') => Self::Stop,
            KeyCode::Esc => Self::End,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(code: KeyCode) -> Option<Key> {
        Key::of(&KeyEvent::new(code, KeyModifiers::NONE))
    }

    #[test]
    fn each_direction_has_a_letter_and_moves_have_arrows() {
        for (letter, arrow, direction) in [
            ('w', Some(KeyCode::Up), Direction::Forward),
            ('s', Some(KeyCode::Down), Direction::Back),
            ('a', Some(KeyCode::Left), Direction::Left),
            ('d', Some(KeyCode::Right), Direction::Right),
            ('q', None, Direction::TurnLeft),
            ('e', None, Direction::TurnRight),
        ] {
            let codes = [letter, letter.to_ascii_uppercase()].map(KeyCode::Char);
            for code in codes.into_iter().chain(arrow) {
                assert_eq!(of(code), Some(Key::Drive(direction)), "{code:?}");
            }
        }
    }

    #[test]
    fn a_released_key_and_an_unknown_key_request_nothing() {
        let released =
            KeyEvent::new_with_kind(KeyCode::Up, KeyModifiers::NONE, KeyEventKind::Release);
        assert_eq!(Key::of(&released), None);
        assert_eq!(of(KeyCode::Char('z')), None);
        assert_eq!(of(KeyCode::Tab), None);
    }

    #[test]
    fn control_with_a_letter_does_not_drive() {
        let control =
            |letter| Key::of(&KeyEvent::new(KeyCode::Char(letter), KeyModifiers::CONTROL));
        assert_eq!((control('c'), control('w')), (Some(Key::End), None));
        assert_eq!(of(KeyCode::Esc), Some(Key::End));
    }
}
