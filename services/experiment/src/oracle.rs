//! The oracle: the simulator's own dynamics as a controller's model.

use model::foresight::Foresight;
use model::{State, Velocity};
use plant_sim::truth::{Preview, Truth};

/// Knows the world as it is, but neither random disturbances nor future changes.
#[derive(Debug)]
pub struct Oracle {
    preview: Preview,
    period_nanos: u64,
}

impl Oracle {
    /// The oracle of this world, for controllers of this period \[ns\].
    pub fn new(truth: &Truth, period_nanos: u64) -> Self {
        Self { preview: Preview::new(truth), period_nanos }
    }
}

impl Foresight for Oracle {
    fn look(&mut self, tick: u64) {
        self.preview.look(tick * self.period_nanos);
    }

    fn predict(&self, state: &State, input: &Velocity) -> State {
        let (pose, velocity) =
            self.preview.after(self.period_nanos, state.pose, state.velocity, *input);
        State { pose, velocity, acted: *input }
    }
}
