//! plant → controller: what is in the robot's way.

use super::ObstacleSource;
use super::define::message;

/// Most obstacles of one list.
pub const OBSTACLES_MAX: usize = 64;
/// Numbers of one obstacle: velocity, radius, and x and y of its corners.
pub const OBSTACLE_NUMBERS: usize = 19;

message! {
    /// All obstacles that one source knows now. Each list replaces the one before of its source.
    Obstacles = 10 {
        /// Epoch of the plant whose ticks count.
        plant_epoch: u64,
        /// Age of the measurement when the list was sent \[s\].
        age_s: f64,
        /// Time after its arrival from which the list is too old: then the robot slows down \[s\].
        valid_s: f64,
        /// [`ObstacleSource`] of the list.
        source: u32 = code(ObstacleSource),
        /// Number of obstacles.
        count: u32 = length(OBSTACLES_MAX),
        /// One row per obstacle, in the world frame: velocity in x and y, radius, then x and y of
        /// eight corners. The obstacle is the hull of its corners, grown by the radius. Unused
        /// corners repeat the last one: a disc is eight equal corners \[m/s, m/s, m, m, m, …\].
        obstacles: [[f64; OBSTACLE_NUMBERS]; OBSTACLES_MAX] = rows(count),
    }
}

impl Obstacles {
    /// Source of the list.
    pub fn source(&self) -> ObstacleSource {
        ObstacleSource::try_from(self.source).unwrap_or(ObstacleSource::Robot)
    }

    /// The rows that count.
    pub fn rows(&self) -> &[[f64; OBSTACLE_NUMBERS]] {
        self.obstacles.get(..self.count as usize).unwrap_or_default()
    }
}
