//! The obstacles of the newest lists.

use protocol::message::{OBSTACLES_MAX, ObstacleSource};
use robot::Obstacle;

/// Longest time for which an obstacle is taken to move on without a new list \[s\].
const PREDICTED_MAX_S: f64 = 1.0;

/// The newest list of each source. Does not allocate after set-up.
#[derive(Debug)]
pub(super) struct Seen {
    /// Obstacles and the tick at which they were there.
    lists: [(Vec<Obstacle>, u64); ObstacleSource::ALL.len()],
    period_s: f64,
}

impl Seen {
    pub(super) fn new(period_s: f64) -> Self {
        let list = || (Vec::with_capacity(OBSTACLES_MAX), 0);
        Self { lists: [list(), list()], period_s }
    }

    /// Replaces the list of `source` by obstacles that were there at `tick`.
    pub(super) fn replace(&mut self, source: ObstacleSource, obstacles: &[Obstacle], tick: u64) {
        let [robot, planner] = &mut self.lists;
        let (list, at) = match source {
            ObstacleSource::Robot => robot,
            ObstacleSource::Planner => planner,
        };
        list.clear();
        list.extend(obstacles.iter().take(OBSTACLES_MAX));
        *at = tick;
    }

    /// A plant has started: what was seen before belongs to another clock.
    pub(super) fn forget(&mut self) {
        self.lists.iter_mut().for_each(|(list, _)| list.clear());
    }

    /// Every obstacle where it will be at `tick`.
    pub(super) fn at(&self, tick: u64) -> impl Iterator<Item = Obstacle> {
        self.lists.iter().flat_map(move |(list, at)| {
            let seconds = tick.saturating_sub(*at) as f64 * self.period_s;
            let seconds = seconds.min(PREDICTED_MAX_S);
            list.iter().map(move |obstacle| obstacle.after(seconds))
        })
    }
}
