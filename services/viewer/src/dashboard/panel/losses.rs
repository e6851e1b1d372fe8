//! Messages that did not arrive, as the processes report them.

use super::super::picture::Losses;
use super::{Scene, block};
use protocol::topic::{TOPIC_COUNT, Topic};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::{Paragraph, Wrap};

/// Height with one row per topic.
pub(super) const LARGE_ROWS: u16 = TOPIC_COUNT as u16 + 2;

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let losses: Vec<(Topic, Losses)> = Topic::ALL
        .map(|topic| (topic, scene.picture.losses_of(topic)))
        .into_iter()
        .filter(|&(_, of)| of != Losses::default())
        .collect();
    let style = if losses.is_empty() {
        scene.look.strong().fg(scene.look.good())
    } else {
        scene.look.alarm()
    };
    let short = area.height < LARGE_ROWS;
    let lines: Vec<Line<'_>> = match losses.as_slice() {
        [] if scene.picture.run.processes.is_empty() => Vec::new(),
        [] => vec![Line::styled("none", style)],
        some if short => {
            let all = some.iter().map(|(topic, of)| {
                format!(
                    "{} {}",
                    topic.name(),
                    of.lost.saturating_add(of.refused).saturating_add(of.dropped)
                )
            });
            vec![Line::styled(all.collect::<Vec<_>>().join(", "), style)]
        }
        some => some.iter().map(|&(topic, of)| Line::styled(in_full(topic, of), style)).collect(),
    };
    frame.render_widget(
        Paragraph::new(lines).wrap(Wrap { trim: true }).block(block(" Messages lost ", scene.look)),
        area,
    );
}

fn in_full(topic: Topic, of: Losses) -> String {
    format!(
        "{:<8}  {} lost, {} refused, {} dropped in a queue",
        topic.name(),
        of.lost,
        of.refused,
        of.dropped
    )
}
