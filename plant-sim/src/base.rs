//! The simulated world as a driver's base.

use crate::truth::World;
use driver::{Base, BaseError, Sensors, TrueState};

impl Base for World {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        let measured = self.measure();
        Ok(Sensors {
            pose: measured.pose,
            velocity: measured.velocity,
            wheel_speed: Some(measured.wheel_speed),
            current: Some(measured.current),
            input_delay_s: self.reported_delay_s(),
            estop: self.is_emergency_stop_pressed(),
        })
    }

    fn drive(&mut self, velocity: [f64; 3], nanos: u64) -> Result<(), BaseError> {
        self.advance(nanos, velocity);
        Ok(())
    }

    fn truth(&self) -> Option<TrueState> {
        let now = self.state();
        Some(TrueState { pose: now.pose, velocity: now.velocity, force: now.force })
    }

    fn acting(&self) -> Option<[f64; 3]> {
        Some(self.input_applied())
    }
}
