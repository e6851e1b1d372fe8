//! What acts on the wheels and why, with which model, and how long it took.

use super::{Scene, block, duration_text, period_text};
use protocol::message::{FallbackLevel, Goal, GoalPhase, Participant, Plan, Reason};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;

/// Height of the panel.
pub(super) const SMALL_ROWS: u16 = 7;
/// Axes of `learned_axes`.
const AXES: [(u32, &str); 3] = [(1, "forward"), (2, "left"), (4, "yaw")];

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, scene: Scene<'_>) {
    let (picture, look) = (scene.picture, scene.look);
    let well = Style::new().fg(look.good());
    let mut lines = Vec::new();
    if let Some(state) = &picture.run.state {
        let style =
            if state.fallback_level() == FallbackLevel::FreshPlan { well } else { look.alarm() };
        lines.push(row("level", Span::styled(state.fallback_level().text(), style)));
        let reason =
            if state.cause() == Reason::None { "nothing unusual" } else { state.cause().text() };
        lines.push(row("reason", Span::raw(reason)));
    }
    if let Some(goal) = &picture.run.goal {
        lines.push(row("goal", Span::raw(goal_text(goal))));
    }
    if let Some(plan) = &picture.plan {
        lines.push(row("model", Span::raw(model(plan))));
        let late = plan.tick_nanos > picture.period_nanos;
        let share = plan.tick_nanos as f64 / picture.period_nanos.max(1) as f64 * 100.0;
        let tick = format!(
            "{}, {share:.1} % of {}",
            duration_text(plan.tick_nanos),
            period_text(picture.period_nanos)
        );
        lines.push(row("tick", Span::styled(tick, if late { look.alarm() } else { Style::new() })));
    }
    if let Some(process) = picture.run.processes.get(&Participant::Controller) {
        let (met, missed) = (process.health.deadlines_met, process.health.deadlines_missed);
        let text = format!("{missed} of {} periods", met.saturating_add(missed));
        lines.push(row(
            "missed",
            Span::styled(text, if missed > 0 { look.alarm() } else { Style::new() }),
        ));
    }
    frame.render_widget(Paragraph::new(lines).block(block(" Controller ", look)), area);
}

fn row<'a>(name: &str, value: Span<'a>) -> Line<'a> {
    Line::from(vec![Span::raw(format!("{name:<7}")), value])
}

/// The goal, and how far the robot is.
fn goal_text(goal: &Goal) -> String {
    let (id, kind) = (goal.id, goal.kind());
    match goal.phase() {
        GoalPhase::Active => {
            format!("{id} ({kind}): {:.0} %, {:.2} m left", 100.0 * goal.progress, goal.left_m)
        }
        phase => format!("{id} ({kind}): {phase}"),
    }
}

/// The model in use, and the axes on which it is used.
fn model(plan: &Plan) -> String {
    let learned: Vec<&str> = AXES
        .into_iter()
        .filter(|(bit, _)| plan.learned_axes & bit != 0)
        .map(|(_, axis)| axis)
        .collect();
    match (plan.model_version, learned.is_empty()) {
        (0, _) => "main model alone".to_owned(),
        (version, true) => format!("{version}, on no axis"),
        (version, false) => format!("{version}: {}", learned.join(" ")),
    }
}
