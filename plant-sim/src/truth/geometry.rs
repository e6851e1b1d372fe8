//! Kinematics between wheels and body, and the places of the wheels.
//!
//! | here                      | in the equations                            | size  |
//! |---------------------------|---------------------------------------------|-------|
//! | `rim_speed_from_velocity` | J                                           | W × 3 |
//! | `arm_m`                   | L: rim speed per yaw rate, root mean square |       |
//!
//! Reference: Wu, Tang, Xu 2023, eqs. 4–9, in the frame x forward, y left; the rows of other wheels
//! are those of [`Wheels`].

use nalgebra::{SMatrix, SVector, Vector2, Vector3};
use robot::Wheels;

/// The shape of a robot with W wheels, fixed for a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Geometry<const W: usize> {
    /// r of each wheel \[m\].
    pub(super) radii_m: SVector<f64, W>,
    /// r̄: their mean \[m\].
    pub(super) mean_radius_m: f64,
    /// L \[m\].
    pub(super) arm_m: f64,
    /// J: rim speeds \[m/s\] of a body velocity (forward, left, yaw).
    pub(super) rim_speed_from_velocity: SMatrix<f64, W, 3>,
    /// J r̄/r.
    pub(super) rim_speed_at_mean_radius: SMatrix<f64, W, 3>,
    /// Sums of the squares of its columns forward and left.
    pub(super) planar_squares: Vector2<f64>,
    /// Share of a roller's force that turns its wheel: cosine of the angle between the roller's
    /// axis and the rim.
    pub(super) along_rim: SVector<f64, W>,
    /// Contact point of each wheel with the floor, in the body frame \[m\].
    pub(super) contacts_m: [Vector2<f64>; W],
    /// Means of the squares of their x and y \[m²\].
    pub(super) mean_squares_m2: Vector2<f64>,
}

impl<const W: usize> Geometry<W> {
    /// The shape of a robot with these wheels, W in number.
    pub(super) fn new(wheels: &Wheels) -> Self {
        let (rows, radii, mean) = (wheels.rows(), wheels.radii_m(), wheels.radius_m());
        let [forward, left, _] = wheels.square_sums();
        Self {
            radii_m: SVector::from_fn(|wheel, _| radii[wheel]),
            mean_radius_m: mean,
            arm_m: wheels.lever_m(),
            rim_speed_from_velocity: SMatrix::from_fn(|wheel, axis| rows[wheel][axis]),
            rim_speed_at_mean_radius: SMatrix::from_fn(|wheel, axis| {
                rows[wheel][axis] * (mean / radii[wheel])
            }),
            planar_squares: Vector2::new(forward, left),
            along_rim: SVector::from_fn(|wheel, _| {
                let [forward, left, _] = rows[wheel];
                (1.0 / (forward * forward + left * left)).sqrt()
            }),
            contacts_m: std::array::from_fn(|wheel| Vector2::from(wheels.positions_m()[wheel])),
            mean_squares_m2: Vector2::from(wheels.mean_squares_m2()),
        }
    }

    /// ω = J v / r: the wheel speeds \[rad/s\] of a body velocity, without slip.
    pub(super) fn wheel_speed(&self, velocity: &Vector3<f64>) -> SVector<f64, W> {
        (self.rim_speed_from_velocity * velocity).component_div(&self.radii_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Matrix4x3, Rotation2};
    use robot::{ImpossibleWheels, Layout, Omni, Robot};

    fn paper() -> Geometry<4> {
        Geometry::new(&Robot::example().wheels)
    }

    fn omni() -> Result<Geometry<3>, ImpossibleWheels> {
        let omni = Omni { radius_m: 0.05, centre_to_wheel_m: 0.2, count: 3 };
        Ok(Geometry::new(&Layout::Omni(omni).try_into()?))
    }

    #[test]
    fn the_papers_rim_speeds_hold_in_the_rotated_frame() {
        // Eq. 5 has x to the right and y forward: its (v_x, v_y) are our (−v_y, v_x).
        let g = paper();
        let l = g.arm_m;
        let of_paper = Matrix4x3::new(-1.0, 1.0, l, 1.0, 1.0, -l, -1.0, 1.0, -l, 1.0, 1.0, l);
        let paper_from_ours = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        assert!((of_paper * paper_from_ours - g.rim_speed_from_velocity).amax() < 1e-15);
    }

    #[test]
    fn a_rim_speed_is_the_body_velocity_at_the_contact_point() -> Result<(), ImpossibleWheels> {
        let v = Vector3::new(0.7, -0.4, 1.3);
        let turned = Rotation2::new(core::f64::consts::FRAC_PI_2);
        // Rollers at ±45°: a wheel measures forward ± left velocity of the point above its contact.
        let rims = paper().rim_speed_from_velocity * v;
        for (wheel, contact) in paper().contacts_m.iter().enumerate() {
            let at_contact = v.xy() + v.z * (turned * contact);
            let roller = if wheel % 2 == 0 { 1.0 } else { -1.0 };
            assert!((at_contact.x + roller * at_contact.y - rims[wheel]).abs() < 1e-15);
        }
        // An omni wheel measures the velocity around the centre.
        let omni = omni()?;
        let rims = omni.rim_speed_from_velocity * v;
        for (wheel, contact) in omni.contacts_m.iter().enumerate() {
            let left_of_contact = turned * contact;
            let at_contact = v.xy() + v.z * left_of_contact;
            let measured = at_contact.dot(&left_of_contact.normalize());
            assert!((measured - rims[wheel]).abs() < 1e-15);
        }
        Ok(())
    }
}
