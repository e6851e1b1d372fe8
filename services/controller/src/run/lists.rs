//! Lists of obstacles for the control thread.

use crate::control::Controller;
use gate::list::{self, ImpossibleList};
use protocol::message::{OBSTACLES_MAX, Obstacles};
use robot::Obstacle;
use transport::{OpenError, Ports, ReceiveError, Since, Source, Tally};

/// Receives lists of obstacles. Does not allocate after set-up.
pub(super) struct Lists {
    source: Source<Obstacles>,
    read: Vec<Obstacle>,
    /// Epoch and tick of the newest list.
    newest: Option<(u64, u64)>,
}

impl Lists {
    pub(super) fn open(ports: &Ports, since: Since) -> Result<Self, OpenError> {
        let read = Vec::with_capacity(OBSTACLES_MAX);
        Ok(Self { source: ports.source(since)?, read, newest: None })
    }

    /// Gives all new lists to `controller`. Returns the error of the last one that is impossible.
    pub(super) fn take(
        &mut self,
        controller: &mut Controller,
    ) -> Result<Option<ImpossibleList>, ReceiveError> {
        let mut impossible = None;
        while let Some(list) = self.source.next()? {
            self.newest = self.newest.max(Some((list.plant_epoch, list.stamp.tick)));
            match list::read(&list, &mut self.read) {
                Ok(()) => controller.see_obstacles(list.source(), &self.read, list.stamp.tick),
                Err(error) => impossible = Some(error),
            }
        }
        Ok(impossible)
    }

    /// Whether the list of this plant epoch and tick has arrived.
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
