//! What is in the robot's way, as lists for the controller and the gate: what its own sensors see,
//! and what planners send.

use crate::gated::GatedBase;
use crate::planner::{Planner, had_planner};
use crate::{Base, Settings};
use gate::list;
use protocol::message::{OBSTACLES_MAX, ObstacleSource, Obstacles};
use robot::Obstacle;
use transport::{OpenError, Ports, SendError, Sink, Tally};

/// Time after which a list of the robot's own sensors is too old \[periods\].
const VALID_PERIODS: f64 = 10.0;

/// Publishes the obstacles that the sensors of one base see, and those of planners.
pub(crate) struct Seen {
    sink: Sink<Obstacles>,
    list: Box<Obstacles>,
    planner: Planner,
    /// Obstacles of the planner's list.
    read: Vec<Obstacle>,
    had_planner: bool,
    /// Whether the last list had no room for all obstacles.
    pub(crate) overflows: bool,
}

impl Seen {
    pub(crate) fn open(
        ports: &Ports,
        plant_epoch: u64,
        settings: &Settings<'_>,
    ) -> Result<Self, OpenError> {
        let mut list: Box<Obstacles> = Box::new(bytemuck::Zeroable::zeroed());
        list.plant_epoch = plant_epoch;
        list.valid_s = VALID_PERIODS * settings.run.period_nanos as f64 * 1e-9;
        list.source = ObstacleSource::Robot.code();
        Ok(Self {
            sink: ports.sink()?,
            list,
            had_planner: had_planner(settings.run),
            planner: Planner::open(settings.run, settings.lists),
            read: Vec::with_capacity(OBSTACLES_MAX),
            overflows: false,
        })
    }

    /// Publishes the newest list of a planner, and what `robot` sees at the begin of the period of
    /// `tick`, if it has such sensors. Neither locks nor allocates.
    pub(crate) fn publish(
        &mut self,
        robot: &mut GatedBase<impl Base>,
        tick: u64,
        now: u64,
    ) -> Result<(), SendError> {
        if std::mem::take(&mut self.had_planner) {
            // Its list was lost with the plant before this one: until the next one the robot is
            // slow.
            robot.see_planned(&[], now, 0);
        }
        // Before the robot's own list: a controller that waits for that one has this one as well.
        if let Some(list) = self.planner.due(tick)
            && list::read(list, &mut self.read).is_ok()
        {
            robot.see_planned(&self.read, now, nanos(list.valid_s));
            (list.plant_epoch, list.stamp.tick) = (self.list.plant_epoch, tick);
            self.sink.send(list)?;
        }
        let valid_nanos = nanos(self.list.valid_s);
        let Some(obstacles) = robot.look_around(now, valid_nanos) else { return Ok(()) };
        self.overflows = list::write(obstacles, &mut self.list) > 0;
        self.list.stamp.tick = tick;
        self.sink.send(&mut self.list)
    }

    pub(crate) fn sink(&self) -> &Sink<Obstacles> {
        &self.sink
    }

    /// Numbers of accepted and rejected lists of planners.
    pub(crate) fn planned(&self) -> Tally {
        self.planner.tally()
    }
}

fn nanos(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}
