//! Lists of obstacles for the control thread.

use crate::control::Controller;
use gate::list::{self, ImpossibleList};
use protocol::message::{OBSTACLES_MAX, ObstacleSource, Obstacles};
use robot::Obstacle;
use transport::{OpenError, Ports, ReceiveError, Since, Source, Tally};

/// Receives lists of obstacles. Does not allocate after set-up.
pub(super) struct Lists {
    source: Source<Obstacles>,
    read: Vec<Obstacle>,
    /// Epoch and tick of the newest list of the robot itself.
    newest: Option<(u64, u64)>,
}

impl Lists {
    pub(super) fn open(ports: &Ports, since: Since) -> Result<Self, OpenError> {
        let read = Vec::with_capacity(OBSTACLES_MAX);
        Ok(Self { source: ports.source(since)?, read, newest: None })
    }

    /// Gives the next list to `controller`; `None` if there is none. A list that is impossible is
    /// dropped, and its error returned.
    pub(super) fn take(
        &mut self,
        controller: &mut Controller,
    ) -> Result<Option<Result<(), ImpossibleList>>, ReceiveError> {
        let Some(list) = self.source.next()? else { return Ok(None) };
        if list.source() == ObstacleSource::Robot {
            self.newest = self.newest.max(Some((list.plant_epoch, list.stamp.tick)));
        }
        let read = list::read(&list, &mut self.read);
        if read.is_ok() {
            controller.see_obstacles(list.source(), &self.read, list.stamp.tick);
        }
        Ok(Some(read))
    }

    /// Whether the robot's own list of this plant epoch and tick has arrived. The plant sends it
    /// behind that of a planner.
    pub(super) fn has(&self, plant_epoch: u64, tick: u64) -> bool {
        self.newest >= Some((plant_epoch, tick))
    }

    pub(super) fn wait(&mut self, patience: std::time::Duration) -> Result<bool, ReceiveError> {
        self.source.wait(patience)
    }

    pub(super) fn tally(&self) -> Tally {
        self.source.tally()
    }
}
