//! Dynamics of the base in its wheel speeds (eqs. 10–21, corrected).
//!
//! M ω̇ = p `K_T` i − f ω, with the inertia of eqs. 19 and 20. Corrections of the paper:
//! - M multiplies the wheels' angular *acceleration* (eqs. 18, 21).
//! - The torque p `K_T` i drives and friction opposes (eq. 16).
//! - The inertia that assumption 2 drops is kept, as in eq. 10.
//!
//! Rolling friction (eq. 14) and the Coriolis terms that eqs. 10–12 lose belong to the residual.
//!
//! The columns of J are eigenvectors of M, so the three body axes do not mix:
//!
//! | axis          | λ                    |
//! |---------------|----------------------|
//! | forward, left | m r²/4 + `I_ω`       |
//! | yaw           | `I_z` r²/(4 L²) + `I_ω` |

use crate::Velocity;
use robot::Robot;

/// M of eqs. 19 and 20 \[kg m²\].
pub fn inertia(robot: &Robot) -> [[f64; 4]; 4] {
    let radius = robot.geometry.wheel_radius_m;
    let lever = robot.geometry.lever_m();
    let a = robot.body.mass_kg * radius * radius / 8.0;
    let b = robot.body.yaw_inertia_kg_m2 * radius * radius / (16.0 * lever * lever);
    let c = a + b + robot.body.wheel_inertia_kg_m2;
    let d = a - b;
    [[c, -b, d, b], [-b, c, b, d], [d, b, c, -b], [b, d, -b, c]]
}

/// λ: eigenvalue of M along each column of J \[kg m²\]. It is the inertia that one body axis shows
/// to the motors.
pub fn axis_inertia(robot: &Robot) -> Velocity {
    let radius = robot.geometry.wheel_radius_m;
    let lever = robot.geometry.lever_m();
    let planar = robot.body.mass_kg * radius * radius / 4.0 + robot.body.wheel_inertia_kg_m2;
    let yaw = robot.body.yaw_inertia_kg_m2 * radius * radius / (4.0 * lever * lever)
        + robot.body.wheel_inertia_kg_m2;
    [planar, planar, yaw]
}

/// κ = p `K_T` `k_p`: torque of the speed loop per speed error \[N m s\].
pub fn speed_loop_stiffness(robot: &Robot) -> f64 {
    robot.drive.pole_pairs
        * robot.drive.torque_constant_nm_per_a
        * robot.drive.speed_loop_gain_a_s_per_rad
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::kinematics;

    #[test]
    fn the_columns_of_j_are_eigenvectors_of_the_inertia() {
        let robot = Robot::example();
        let inertia = inertia(&robot);
        let columns = kinematics::jacobian(&robot.geometry);
        for (axis, lambda) in axis_inertia(&robot).into_iter().enumerate() {
            for (row, of_wheel) in inertia.iter().zip(&columns) {
                let product: f64 =
                    row.iter().zip(&columns).map(|(m, column)| m * column[axis]).sum();
                assert!(
                    (product - lambda * of_wheel[axis]).abs() < 1e-15,
                    "axis {axis}: {product} is not {lambda} times the column"
                );
            }
        }
    }

    #[test]
    fn a_robot_without_mass_is_refused_by_name() {
        let mut robot = Robot::example();
        robot.body.mass_kg = 0.0;
        assert_eq!(robot.check().map_err(|e| e.key), Err("body.mass_kg"));
    }
}
