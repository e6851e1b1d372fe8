//! The watched robot, the time of the run, whether the robot is present, and its exposure.

use super::super::picture::Contact;
use super::Scene;
use protocol::message::Exposure;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};

pub(super) fn draw(
    frame: &mut Frame<'_>,
    area: Rect,
    scene: Scene<'_>,
    contact: Contact,
    held: bool,
) {
    let (word, style) = match contact {
        Contact::Awaited => ("waiting for the robot".to_owned(), Style::new()),
        Contact::Live => ("live".to_owned(), scene.look.strong().fg(scene.look.good())),
        Contact::Back => {
            ("live: the robot is back".to_owned(), scene.look.strong().fg(scene.look.good()))
        }
        Contact::Lost(silent) => {
            (format!("LOST for {:.0} s, waiting for it", silent.as_secs_f64()), scene.look.alarm())
        }
    };
    let (word, style) = if held {
        (format!("HELD, space resumes; {word}"), style.add_modifier(Modifier::REVERSED))
    } else {
        (word, style)
    };
    let picture = scene.picture;
    let mut word = Line::from(Span::styled(word, style)).right_aligned();
    let insecure = match (picture.run.exposure(), area.width) {
        (Exposure::Closed, _) => String::new(),
        (_, ..80) => "INSECURE  ".to_owned(),
        (exposure, _) => format!("INSECURE: {exposure}  "),
    };
    word.spans.insert(0, Span::styled(insecure, scene.look.alarm()));
    let who =
        format!("{} at {}", picture.robot.as_deref().unwrap_or("no robot yet"), picture.endpoint);
    let when = picture.run.state.as_ref().map_or_else(String::new, |state| {
        format!("{:.1} s, tick {}", picture.seconds(), state.stamp.tick)
    });
    let room = usize::from(area.width).saturating_sub(word.width() + 2);
    // Text that does not fit is left out, the endpoint first.
    let title = [format!("{who}   {when}"), when]
        .into_iter()
        .find(|title| title.chars().count() <= room)
        .unwrap_or_default();
    let [left, right] =
        Layout::horizontal([Constraint::Fill(1), Constraint::Length(word.width() as u16)])
            .areas(area);
    frame.render_widget(Line::styled(title, scene.look.strong()), left);
    frame.render_widget(word, right);
}
