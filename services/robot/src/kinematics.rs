//! Wheel speeds from body velocity and back (eqs. 4–9 and 34, in our frame).
//!
//! ```text
//!     ⎡1  1  L⎤                ⎡ 1    1    1    1 ⎤
//! J = ⎢1 −1 −L⎥    J⁺ = ¼ ·    ⎢ 1   −1    1   −1 ⎥    wheel speed = J v / r
//!     ⎢1  1 −L⎥                ⎣1/L −1/L −1/L  1/L⎦    v = r J⁺ wheel speed
//!     ⎣1 −1  L⎦
//! ```
//! The paper's frame is x right, y forward: its (`v_x`, `v_y`) are our (−`v_y`, `v_x`). All signs
//! of its eq. 3 are +, which is wrong; its eq. 4 is right.

use crate::Geometry;
use crate::Velocity;

/// Signs of the columns forward, left and yaw of J, per wheel.
const SIGNS: [[f64; 3]; 4] =
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]];

/// Rows of J: rim speed of each wheel per body velocity \[1, 1, m\].
pub fn jacobian(geometry: &Geometry) -> [[f64; 3]; 4] {
    let lever = geometry.lever_m();
    SIGNS.map(|[forward, left, yaw]| [forward, left, yaw * lever])
}

/// Wheel angular speeds J v / r \[rad/s\].
///
/// ```
/// use robot::{Geometry, kinematics};
/// let geometry = Geometry { wheel_radius_m: 0.05, half_wheelbase_m: 0.125, half_track_m: 0.15 };
/// assert_eq!(kinematics::wheels_from_body(&geometry, [1.0, 0.0, 0.0]), [20.0; 4]);
/// ```
pub fn wheels_from_body(geometry: &Geometry, velocity: Velocity) -> [f64; 4] {
    jacobian(geometry).map(|row| {
        (row[0] * velocity[0] + row[1] * velocity[1] + row[2] * velocity[2])
            / geometry.wheel_radius_m
    })
}

/// Body velocity r J⁺ ω of four wheel speeds \[m/s, m/s, rad/s\]. If the wheel speeds contradict
/// each other, it is the least-squares solution.
pub fn body_from_wheels(geometry: &Geometry, wheels: [f64; 4]) -> Velocity {
    let mut sums = [0.0; 3];
    for (signs, wheel) in SIGNS.iter().zip(wheels) {
        for (sum, sign) in sums.iter_mut().zip(signs) {
            *sum += sign * wheel;
        }
    }
    let quarter = geometry.wheel_radius_m / 4.0;
    [quarter * sums[0], quarter * sums[1], quarter * sums[2] / geometry.lever_m()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GEOMETRY: Geometry =
        Geometry { wheel_radius_m: 0.05, half_wheelbase_m: 0.125, half_track_m: 0.15 };

    proptest! {
        #[test]
        fn wheel_speeds_convert_back_to_the_same_velocity(
            velocity in prop::array::uniform3(-5.0..5.0)
        ) {
            let back = body_from_wheels(&GEOMETRY, wheels_from_body(&GEOMETRY, velocity));
            for (a, b) in back.iter().zip(velocity) {
                prop_assert!((a - b).abs() < 1e-12);
            }
        }

        #[test]
        fn equation_4_of_the_paper_holds_in_the_rotated_frame(
            right in -3.0..3.0_f64,
            ahead in -3.0..3.0_f64,
            yaw in -3.0..3.0_f64,
        ) {
            let lever = GEOMETRY.lever_m();
            let paper = [
                -right + ahead + yaw * lever,
                right + ahead - yaw * lever,
                -right + ahead - yaw * lever,
                right + ahead + yaw * lever,
            ];
            let ours = wheels_from_body(&GEOMETRY, [ahead, -right, yaw]);
            for (a, b) in ours.iter().zip(paper) {
                prop_assert!((a * GEOMETRY.wheel_radius_m - b).abs() < 1e-12);
            }
        }
    }
}
