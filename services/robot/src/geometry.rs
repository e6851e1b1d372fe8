//! Where the wheels are.

use serde::{Deserialize, Serialize};

/// Wheel radius and wheel positions of a mecanum base in O-rectangular layout.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Geometry {
    /// r \[m\].
    pub wheel_radius_m: f64,
    /// Centre to front axle (the paper's b) \[m\].
    pub half_wheelbase_m: f64,
    /// Centre to wheel plane (the paper's a) \[m\].
    pub half_track_m: f64,
}

impl Geometry {
    /// L = a + b: rim speed per yaw rate \[m\].
    pub fn lever_m(&self) -> f64 {
        self.half_wheelbase_m + self.half_track_m
    }
}
