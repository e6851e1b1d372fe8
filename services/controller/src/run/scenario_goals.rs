//! In lock step: the goals of the scenario, each at its tick, and the reviews of their ways. All of
//! it happens on the control thread, after its command, so that a run has the same bits every time.

use crate::control::Controller;
use crate::goal::keeper::Keeper;
use crate::goal::schedule::Schedule;
use crate::goal::{Course, GoalError, OUTLOOK_POINTS, Outlook};
use crate::settings::Settings;
use robot::Surroundings;

/// A goal of the scenario that is not followed.
#[derive(Debug, thiserror::Error)]
pub(super) enum NotFollowed {
    /// The goal itself.
    #[error("a goal of the scenario is refused: {0}")]
    Goal(GoalError),
    /// Another way to the present one.
    #[error("the way is not planned anew: {0}")]
    Way(GoalError),
}

/// The goals that are left, and the way to the present one.
pub(super) struct ScenarioGoals<'a> {
    settings: &'a Settings,
    schedule: Schedule,
    keeper: Keeper,
    map: Surroundings,
    period_s: f64,
}

impl<'a> ScenarioGoals<'a> {
    pub(super) fn new(settings: &'a Settings) -> Self {
        let period_s = settings.run.period_nanos as f64 * 1e-9;
        let schedule = Schedule::new(&settings.goals, period_s);
        let (keeper, map) = (Keeper::default(), settings.surroundings());
        Self { settings, schedule, keeper, map, period_s }
    }

    /// Follows the goal that is due at `tick`, from `tick` on, or another way to the present one.
    pub(super) fn follow(
        &mut self,
        controller: &mut Controller,
        tick: u64,
    ) -> Result<(), NotFollowed> {
        let due = self.schedule.due(tick);
        if due.is_none() && !self.keeper.is_due(tick, self.period_s) {
            return Ok(());
        }
        let mut outlook = Outlook::with_room(OUTLOOK_POINTS);
        if !controller.look_out(&mut outlook) {
            return Ok(());
        }
        let (robot, map, period_s) = (&self.settings.robot, &self.map, self.period_s);
        let course = match &due {
            Some((id, request)) => Course::new(request, *id, &outlook, robot, map, period_s)
                .map(Some)
                .map_err(NotFollowed::Goal),
            None => self.keeper.review(&outlook, robot, map, period_s).map_err(NotFollowed::Way),
        };
        let Some(mut course) = course? else { return Ok(()) };
        let way = std::mem::take(&mut course.way);
        if controller.follow(&mut course, tick) {
            match due {
                Some((id, request)) => self.keeper.keep(id, &request, way),
                None => self.keeper.take_way(way),
            }
        }
        Ok(())
    }
}
