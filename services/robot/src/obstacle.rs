//! What the robot must not touch: a shape in the world that may move.

use crate::{Point, Shape};

/// A shape in the world, with a constant velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obstacle {
    /// Where it is now.
    pub shape: Shape,
    /// Its velocity in the world \[m/s, m/s\].
    pub velocity_mps: Point,
}

impl Obstacle {
    /// An obstacle that stands.
    pub fn standing(shape: Shape) -> Self {
        Self { shape, velocity_mps: [0.0; 2] }
    }

    /// Its place after `seconds` \[s\].
    #[must_use]
    pub fn after(&self, seconds: f64) -> Self {
        let by = self.velocity_mps.map(|velocity| velocity * seconds);
        Self { shape: self.shape.moved(by), ..*self }
    }
}
