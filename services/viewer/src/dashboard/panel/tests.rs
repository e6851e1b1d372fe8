use super::super::look::Look;
use super::super::picture::Picture;
use super::super::specimen;
use super::super::view::{KEYS, View};
use super::draw;
use network::telemetry::TelemetryMessage;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::{Color, Modifier};
use std::convert::Infallible;
use std::time::{Duration, Instant};

/// The cells of `view` at `now`.
fn cells(view: &View, look: Look, size: (u16, u16), now: Instant) -> Result<Buffer, Infallible> {
    let mut terminal = Terminal::new(TestBackend::new(size.0, size.1))?;
    terminal.draw(|frame| draw(frame, view, look, now))?;
    Ok(terminal.backend().buffer().clone())
}

/// Its rows as text.
fn rows(buffer: &Buffer) -> Vec<String> {
    let width = usize::from(buffer.area.width).max(1);
    buffer
        .content()
        .chunks(width)
        .map(|row| row.iter().map(ratatui::buffer::Cell::symbol).collect())
        .collect()
}

fn text(view: &View, size: (u16, u16), now: Instant) -> Result<String, Infallible> {
    Ok(rows(&cells(view, Look::Coloured, size, now)?).join("\n"))
}

fn press(view: &mut View, key: char, now: Instant) {
    view.press(KeyEvent::new(KeyCode::Char(key), KeyModifiers::NONE), now);
}

/// Asserts that these words are whole on the screen, neither cut nor covered.
fn assert_all(shown: &str, words: &[&str]) {
    for word in words {
        assert!(shown.contains(word), "{word:?} is not whole on\n{shown}");
    }
}

/// Words that are visible at any size from 80×24 on.
const WORDS: [&str; 33] = [
    "specimen at tcp/127.0.0.1:7448",
    "12.3 s, tick 123",
    " live",
    " Map: robot in the middle, 10 m across ",
    " ⠤ driven · reference o predicted ",
    " Tracking error 0.032 m ",
    " Controller ",
    "level  fresh plan",
    "reason nothing unusual",
    "model  7: forward left yaw",
    "tick   412 µs, 0.4 % of 100 ms",
    "missed 0 of 1234 periods",
    " One-step error: main → learned ",
    "forward 0.0800 → 0.0080 m/s   ÷10",
    "left    0.0600 → 0.0040 m/s   ÷15",
    "yaw     0.0300 → 0.0020 rad/s ÷15",
    " Processes",
    "plant",
    "controller",
    "learner",
    "recorder",
    "gateway",
    "running",
    "2.5 s",
    " Messages lost ",
    "state",
    "6",
    "? help",
    "space hold",
    "+ - f map",
    "q quit",
    "o",
    "·",
];

#[test]
fn eighty_by_twenty_four_shows_all_figures_uncut() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    view.live().receive(specimen::state(123), begin + Duration::from_millis(2500));
    let shown = text(&view, (80, 24), begin + Duration::from_millis(2500))?;
    assert_all(&shown, &WORDS);
    assert_all(
        &shown,
        &[
            "Processes: phase, silent since ",
            "plant      running     2.5 s",
            "state 6",
            "learner: the fit was given up",
        ],
    );
    assert_eq!(shown.matches("running").count(), 5, "{shown}");
    Ok(())
}

#[test]
fn two_hundred_by_sixty_is_used() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    view.live().receive(specimen::state(123), begin + Duration::from_millis(2500));
    let shown = text(&view, (200, 60), begin + Duration::from_millis(2500))?;
    assert_all(&shown, &WORDS);
    let more = [
        " One-step error [m/s]: • main model ⠤ with what is learned ",
        " Tick [ms]: longest 412 µs of late, deadline • 100 ms ",
        "silent epoch      pid missed last error",
        "4002      0 the fit was given up",
        "state     6 lost, 0 refused, 0 dropped in a queue",
        " Events ",
        "12.3 s  learner: the fit was given up",
    ];
    assert_all(&shown, &more);
    let empty = shown.lines().skip(1).filter(|line| line.trim().is_empty()).count();
    assert_eq!(empty, 0, "{shown}");
    Ok(())
}

#[test]
fn the_map_shows_the_goal_and_obstacles() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut picture = specimen::picture(begin);
    let yellow = |view: &View| -> Result<usize, Infallible> {
        let cells = cells(view, Look::Coloured, (200, 60), begin)?;
        Ok(cells.content().iter().filter(|cell| cell.fg == Color::Yellow).count())
    };
    let before = yellow(&View::new(picture.clone()))?;
    picture.receive(specimen::goal(), begin);
    picture.receive(specimen::obstacles(), begin);
    let view = View::new(picture);
    assert_all(&text(&view, (200, 60), begin)?, &["x goal ⠶ obstacle ", "x"]);
    assert_all(&text(&view, (80, 24), begin)?, &["x goal"]);
    let outline = yellow(&view)? - before - "⠶ obstacle ".chars().count();
    assert!((4..200).contains(&outline), "{outline} cells");
    Ok(())
}

#[test]
fn every_frame_is_closed_at_every_size() -> Result<(), Infallible> {
    let begin = Instant::now();
    let view = View::new(specimen::picture(begin));
    for size in [(80, 24), (100, 30), (119, 50), (120, 40), (120, 48), (200, 60), (300, 90)] {
        let shown = text(&view, size, begin)?;
        let [begun, top_right, bottom_left, ended] =
            ["┌", "┐", "└", "┘"].map(|corner| shown.matches(corner).count());
        assert!(begun >= 6 && [top_right, ended] == [begun; 2], "{size:?}\n{shown}");
        // The axes of the curves have such a corner, too.
        let curves = if begun > 6 { 3 } else { 1 };
        assert_eq!(bottom_left, begun + curves, "{size:?}\n{shown}");
    }
    Ok(())
}

#[test]
fn no_terminal_is_too_small_to_draw_on() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    let mut empty = View::new(Picture::new("tcp/127.0.0.1:7448"));
    for help in [false, true] {
        for width in [0, 1, 2, 5, 20, 79, 80, 81, 119, 120, 500] {
            for height in [0, 1, 2, 3, 5, 23, 24, 25, 47, 48, 200] {
                text(&view, (width, height), begin)?;
                text(&empty, (width, height), begin)?;
            }
        }
        assert!(!help || text(&view, (20, 5), begin)?.contains("Help"));
        press(&mut view, 'h', begin);
        press(&mut empty, 'h', begin);
    }
    let shown = text(&View::new(specimen::picture(begin)), (20, 5), begin)?;
    assert_all(&shown, &["live", "error 0.032 m", "fresh plan", "? help"]);
    Ok(())
}

#[test]
fn a_lost_robot_is_reported_and_the_last_picture_is_grey() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    let later = begin + Duration::from_secs(7);
    view.live().look(later);
    let buffer = cells(&view, Look::Coloured, (80, 24), later)?;
    let shown = rows(&buffer).join("\n");
    assert_all(&shown, &["LOST for 7 s, waiting for it", "fresh plan", "Tracking error 0.032 m"]);
    for (index, cell) in buffer.content().iter().enumerate().skip(80).take(80 * 22) {
        assert!(
            cell.fg == Color::DarkGray && cell.modifier == Modifier::DIM,
            "cell {index}: {cell:?}"
        );
    }
    view.live().receive(specimen::state(124), later);
    let buffer = cells(&view, Look::Coloured, (80, 24), later)?;
    assert_all(&rows(&buffer).join("\n"), &["live: the robot is back"]);
    assert!(buffer.content().iter().all(|cell| cell.fg != Color::DarkGray));
    Ok(())
}

#[test]
fn a_held_picture_does_not_hide_that_the_robot_is_lost() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    press(&mut view, ' ', begin);
    view.live().receive(specimen::state(130), begin);
    assert_all(&text(&view, (80, 24), begin)?, &["HELD, space resumes; live", "tick 123"]);
    let later = begin + Duration::from_secs(7);
    view.live().look(later);
    assert_all(&text(&view, (80, 24), later)?, &["HELD, space resumes; LOST for 7 s", "tick 123"]);
    Ok(())
}

#[test]
fn help_shows_every_key_and_closes() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    press(&mut view, '?', begin);
    for size in [(80, 24), (200, 60)] {
        let shown = text(&view, size, begin)?;
        for (keys, what) in KEYS {
            assert_all(&shown, &[keys, what]);
        }
        assert_all(&shown, &["Watching only reads. Only driving (k) affects the robot."]);
    }
    press(&mut view, '?', begin);
    assert!(!text(&view, (80, 24), begin)?.contains(" Help "));
    Ok(())
}

#[test]
fn the_map_shows_the_selected_part() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    press(&mut view, 'f', begin);
    assert_all(&text(&view, (80, 24), begin)?, &["Map: whole path, "]);
    press(&mut view, '0', begin);
    press(&mut view, '-', begin);
    assert_all(&text(&view, (80, 24), begin)?, &["Map: robot in the middle, 14 m across"]);
    Ok(())
}

#[test]
fn without_colours_the_text_is_the_same() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    let later = begin + Duration::from_secs(7);
    for (lost, size) in [(false, (80, 24)), (false, (200, 60)), (true, (80, 24)), (true, (200, 60))]
    {
        if lost {
            view.live().look(later);
        }
        let (plain, coloured) =
            (cells(&view, Look::Plain, size, later)?, cells(&view, Look::Coloured, size, later)?);
        assert_eq!(rows(&plain), rows(&coloured));
        assert!(
            plain.content().iter().all(|cell| (cell.fg, cell.bg) == (Color::Reset, Color::Reset))
        );
        assert!(coloured.content().iter().any(|cell| cell.fg != Color::Reset));
        let themed = |color: Color| {
            !matches!(color, Color::Black | Color::White | Color::Rgb(..) | Color::Indexed(_))
        };
        assert!(
            coloured.content().iter().all(|cell| themed(cell.fg) && cell.bg == Color::Reset),
            "a theme's own background stays"
        );
    }
    Ok(())
}

#[test]
fn a_fallback_level_of_last_resort_shows_its_reason() -> Result<(), Infallible> {
    let begin = Instant::now();
    let mut view = View::new(specimen::picture(begin));
    let mut braking = specimen::state(124);
    if let TelemetryMessage::State(state) = &mut braking.message {
        (state.fallback_level, state.reason) = (5, 2);
    }
    view.live().receive(braking, begin);
    let shown = text(&view, (80, 24), begin)?;
    assert_all(
        &shown,
        &["level  brake", "reason command missing", "12.4 s: brake: command missing"],
    );
    Ok(())
}
