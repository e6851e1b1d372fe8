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

    /// A circle around it: its centre and radius \[m\]. A cheap bound of its distance.
    pub fn encircled(self) -> Encircled {
        let (centre, radius_m) = self.shape.circle();
        Encircled { obstacle: self, centre, radius_m }
    }

    /// Its place after `seconds` \[s\].
    #[must_use]
    pub fn after(&self, seconds: f64) -> Self {
        let by = self.velocity_mps.map(|velocity| velocity * seconds);
        Self { shape: self.shape.moved(by), ..*self }
    }
}

/// An obstacle, and a circle around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Encircled {
    /// The obstacle.
    pub obstacle: Obstacle,
    /// Centre of the circle \[m\].
    pub centre: Point,
    /// Its radius \[m\].
    pub radius_m: f64,
}
