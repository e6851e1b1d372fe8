//! Wheel positions, and the kinematics between wheels and body.
//!
//! | here                       | in the equations | size  |
//! |----------------------------|------------------|-------|
//! | `rim_speed_from_velocity`  | J                | 4 × 3 |
//! | `velocity_from_rim_speed`  | J⁺               | 3 × 4 |
//! | `arm_m`                    | L = a + b        |       |
//!
//! Reference: Wu, Tang, Xu 2023, eqs. 4–9, in the frame x forward, y left.

use nalgebra::{Matrix3x4, Matrix4x3, Vector2, Vector3, Vector4};

use super::parameters::Truth;

/// The robot's shape, fixed for a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Geometry {
    /// r: wheel radius \[m\].
    pub(super) wheel_radius_m: f64,
    /// L: lever of a wheel's rim speed about the centre \[m\].
    pub(super) arm_m: f64,
    /// J: rim speeds \[m/s\] of a body velocity (forward, left, yaw).
    pub(super) rim_speed_from_velocity: Matrix4x3<f64>,
    /// J⁺: body velocity of rim speeds.
    pub(super) velocity_from_rim_speed: Matrix3x4<f64>,
    /// Contact point of each wheel with the floor, in the body frame \[m\].
    pub(super) contacts_m: [Vector2<f64>; 4],
}

impl Geometry {
    /// The shape that the settings describe.
    pub(super) fn new(truth: &Truth) -> Self {
        let (side, ahead) = (truth.half_track_m, truth.half_wheelbase_m);
        let arm = side + ahead;
        let turn = 1.0 / arm;
        Self {
            wheel_radius_m: truth.wheel_radius_m,
            arm_m: arm,
            #[rustfmt::skip]
            rim_speed_from_velocity: Matrix4x3::new(
                1.0,  1.0,  arm,
                1.0, -1.0, -arm,
                1.0,  1.0, -arm,
                1.0, -1.0,  arm,
            ),
            #[rustfmt::skip]
            velocity_from_rim_speed: 0.25 * Matrix3x4::new(
                1.0,   1.0,   1.0,  1.0,
                1.0,  -1.0,   1.0, -1.0,
                turn, -turn, -turn, turn,
            ),
            contacts_m: [
                Vector2::new(ahead, -side),
                Vector2::new(ahead, side),
                Vector2::new(-ahead, side),
                Vector2::new(-ahead, -side),
            ],
        }
    }

    /// ω = J v / r: the wheel speeds \[rad/s\] of a body velocity, without slip.
    pub(super) fn wheel_speed(&self, velocity: &Vector3<f64>) -> Vector4<f64> {
        self.rim_speed_from_velocity * velocity / self.wheel_radius_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Rotation2};

    fn geometry() -> Geometry {
        Geometry::new(&Truth::default())
    }

    #[test]
    fn rim_speeds_convert_back_to_the_same_body_velocity() {
        let g = geometry();
        let error = g.velocity_from_rim_speed * g.rim_speed_from_velocity - Matrix3::identity();
        assert!(error.amax() < 1e-15, "{error}");
    }

    #[test]
    fn the_papers_rim_speeds_hold_in_the_rotated_frame() {
        // Eq. 5 has x to the right and y forward: its (v_x, v_y) are our (−v_y, v_x).
        let g = geometry();
        let l = g.arm_m;
        let paper = Matrix4x3::new(-1.0, 1.0, l, 1.0, 1.0, -l, -1.0, 1.0, -l, 1.0, 1.0, l);
        let paper_from_ours = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        assert!((paper * paper_from_ours - g.rim_speed_from_velocity).amax() < 1e-15);
    }

    #[test]
    fn a_rim_speed_is_the_body_velocity_at_the_contact_point() {
        // Rollers at ±45°: a wheel measures forward ± left velocity of the point above its contact.
        let g = geometry();
        let v = Vector3::new(0.7, -0.4, 1.3);
        let rims = g.rim_speed_from_velocity * v;
        for (wheel, contact) in g.contacts_m.iter().enumerate() {
            let left_of_contact = Rotation2::new(core::f64::consts::FRAC_PI_2) * contact;
            let at_contact = Vector2::new(v.x, v.y) + v.z * left_of_contact;
            let roller = if wheel % 2 == 0 { 1.0 } else { -1.0 };
            assert!((at_contact.x + roller * at_contact.y - rims[wheel]).abs() < 1e-15);
        }
    }
}
