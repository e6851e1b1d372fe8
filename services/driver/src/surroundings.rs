//! What the robot's sensors see of its surroundings, as lists for the controller and the gate.

use crate::Base;
use crate::gated::GatedBase;
use gate::list;
use protocol::message::{ObstacleSource, Obstacles};
use transport::{OpenError, Ports, SendError, Sink};

/// Time after which a list of the robot's own sensors is too old \[periods\].
const VALID_PERIODS: f64 = 10.0;

/// Publishes the obstacles that the sensors of one base see.
pub(crate) struct Seen {
    sink: Sink<Obstacles>,
    list: Box<Obstacles>,
    /// Whether the last list had no room for all obstacles.
    pub(crate) overflows: bool,
}

impl Seen {
    pub(crate) fn open(
        ports: &Ports,
        plant_epoch: u64,
        period_nanos: u64,
    ) -> Result<Self, OpenError> {
        let mut list: Box<Obstacles> = Box::new(bytemuck::Zeroable::zeroed());
        list.plant_epoch = plant_epoch;
        list.valid_s = VALID_PERIODS * period_nanos as f64 * 1e-9;
        list.source = ObstacleSource::Robot.code();
        Ok(Self { sink: ports.sink()?, list, overflows: false })
    }

    /// Publishes what `robot` sees at the begin of the period of `tick`, if it has such sensors.
    pub(crate) fn publish(
        &mut self,
        robot: &mut GatedBase<impl Base>,
        tick: u64,
        now: u64,
    ) -> Result<(), SendError> {
        let valid_nanos = (self.list.valid_s * 1e9) as u64;
        let Some(obstacles) = robot.look_around(now, valid_nanos) else { return Ok(()) };
        self.overflows = list::write(obstacles, &mut self.list) > 0;
        self.list.stamp.tick = tick;
        self.sink.send(&mut self.list)
    }

    pub(crate) fn sink(&self) -> &Sink<Obstacles> {
        &self.sink
    }
}
