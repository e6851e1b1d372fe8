//! Dynamics of the base in its wheel speeds (eqs. 10–21, corrected).
//!
//! M ω̇ = p `K_T` i − f ω, with the inertia of eqs. 19 and 20. Corrections of the paper:
//! - M multiplies the wheels' angular *acceleration* (eqs. 18, 21).
//! - The torque p `K_T` i drives and friction opposes (eq. 16).
//! - The inertia that assumption 2 drops is kept, as in eq. 10.
//!
//! Rolling friction (eq. 14) and the Coriolis terms that eqs. 10–12 lose belong to the residual.
//!
//! For mecanum wheels in a rectangle the columns of J are eigenvectors of M, so the three body axes
//! do not mix:
//!
//! | axis          | λ                       |
//! |---------------|-------------------------|
//! | forward, left | m r²/4 + `I_ω`          |
//! | yaw           | `I_z` r²/(4 L²) + `I_ω` |

use crate::Velocity;
use robot::{Body, Drive, Robot};

/// λ of each velocity axis \[kg m²\]: the inertia that it shows to the motors of `robot`.
///
/// D/Σ(J r̄/r)² r̄² + `I_ω`, with D the mass or the yaw inertia and the sum over the wheels. Where
/// the columns of J are not perpendicular, the axes mix. That belongs to the residual.
pub fn axis_inertia(robot: &Robot, body: &Body) -> Velocity {
    let radius = robot.wheels.radius_m();
    let squares = robot.wheels.square_sums();
    let inertia = [body.mass_kg, body.mass_kg, body.yaw_inertia_kg_m2];
    std::array::from_fn(|axis| {
        inertia[axis] * radius * radius / squares[axis] + body.wheel_inertia_kg_m2
    })
}

/// κ = p `K_T` `k_p`: torque of the speed loop per speed error \[N m s\].
pub fn speed_loop_stiffness(drive: &Drive) -> f64 {
    drive.pole_pairs * drive.torque_constant_nm_per_a * drive.speed_loop_gain_a_s_per_rad
}

#[cfg(test)]
mod tests {
    use super::*;

    /// M of eqs. 19 and 20 \[kg m²\].
    fn inertia(body: &Body, radius: f64, lever: f64) -> [[f64; 4]; 4] {
        let a = body.mass_kg * radius * radius / 8.0;
        let b = body.yaw_inertia_kg_m2 * radius * radius / (16.0 * lever * lever);
        let c = a + b + body.wheel_inertia_kg_m2;
        let d = a - b;
        [[c, -b, d, b], [-b, c, b, d], [d, b, c, -b], [b, d, -b, c]]
    }

    #[test]
    fn the_columns_of_j_are_eigenvectors_of_the_inertia() -> Result<(), &'static str> {
        let robot = Robot::example();
        let body = robot.body.ok_or("no body")?;
        let wheels = robot.wheels;
        let inertia = inertia(&body, wheels.radius_m(), wheels.lever_m());
        for (axis, lambda) in axis_inertia(&robot, &body).into_iter().enumerate() {
            for (row, of_wheel) in inertia.iter().zip(wheels.rows()) {
                let product: f64 =
                    row.iter().zip(wheels.rows()).map(|(m, column)| m * column[axis]).sum();
                assert!(
                    (product - lambda * of_wheel[axis]).abs() < 1e-15,
                    "axis {axis}: {product} is not {lambda} times the column"
                );
            }
        }
        Ok(())
    }

    #[test]
    fn a_robot_without_mass_is_refused_by_name() {
        let mut robot = Robot::example();
        robot.body = robot.body.map(|body| Body { mass_kg: 0.0, ..body });
        assert_eq!(robot.check().map_err(|e| e.key), Err("body.mass_kg"));
    }
}
