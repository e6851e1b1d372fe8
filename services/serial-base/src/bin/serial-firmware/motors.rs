//! The simulated robot: velocity lines and time in, odometry out.

use serial_base::line::{VelocityLine, millionths};

/// Time constant of each axis \[s\].
const TIME_CONSTANT_S: f64 = 0.05;
/// Longest step of the simulation \[s\]: the world stands still while its process does not run.
const STEP_MAX_S: f64 = 0.02;

/// Motors with their watchdog.
#[derive(Debug, Default)]
pub(crate) struct Motors {
    /// The last velocity line, and its time \[ns\].
    last: Option<(VelocityLine, u64)>,
    /// Velocity that the motors are to reach \[m/s, m/s, rad/s\].
    target: [f64; 3],
    velocity: [f64; 3],
    pose: [f64; 3],
    advanced: Option<u64>,
}

impl Motors {
    /// Obeys a velocity line that has arrived at `now` \[ns\].
    pub(crate) fn command(&mut self, now: u64, line: &VelocityLine) {
        self.last = Some((*line, now));
    }

    /// Moves until `now` \[ns\].
    pub(crate) fn advance(&mut self, now: u64) {
        let line = self.last.filter(|_| !self.is_overdue(now)).map(|(line, _)| line);
        let velocity = line.unwrap_or_default().velocity;
        self.target = velocity.map(|value| f64::from(value) * 1e-6);
        let before = self.advanced.replace(now).unwrap_or(now);
        self.integrate(STEP_MAX_S.min((now - before) as f64 * 1e-9));
    }

    fn integrate(&mut self, seconds: f64) {
        let share = 1.0 - (-seconds / TIME_CONSTANT_S).exp();
        for (velocity, target) in self.velocity.iter_mut().zip(self.target) {
            *velocity += share * (target - *velocity);
        }
        let [forward, left, yaw] = self.velocity;
        let (sin, cos) = self.pose[2].sin_cos();
        let rates = [cos * forward - sin * left, sin * forward + cos * left, yaw];
        for (place, rate) in self.pose.iter_mut().zip(rates) {
            *place += rate * seconds;
        }
    }

    /// Whether no velocity line has come for the time for which the last one is valid.
    fn is_overdue(&self, now: u64) -> bool {
        self.last.is_none_or(|(line, at)| now - at >= u64::from(line.valid_millis) * 1_000_000)
    }

    /// Whether its watchdog has stopped it.
    pub(crate) fn stopped_by_watchdog(&self) -> bool {
        self.advanced.is_none_or(|now| self.is_overdue(now))
    }

    /// The last velocity line, and its time \[ns\].
    pub(crate) fn last(&self) -> Option<(VelocityLine, u64)> {
        self.last
    }

    /// Velocity that the motors are to reach \[m/s, m/s, rad/s\].
    pub(crate) fn target(&self) -> [f64; 3] {
        self.target
    }

    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub(crate) fn velocity(&self) -> [f64; 3] {
        self.velocity
    }

    /// The same in millionths.
    pub(crate) fn velocity_micro(&self) -> [i32; 3] {
        self.velocity.map(millionths)
    }

    /// x, y and heading since the start, in millionths of m and rad.
    pub(crate) fn pose_micro(&self) -> [i64; 3] {
        self.pose.map(|value| (value * 1e6).round() as i64)
    }
}
