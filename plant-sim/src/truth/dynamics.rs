//! The equations of motion of the true robot.
//!
//! | here            | in the equations | unit                  |
//! |-----------------|------------------|-----------------------|
//! | `velocity`      | v                | m/s, m/s, rad/s, body |
//! | `wheel_speed`   | ω                | rad/s                 |
//! | `current`       | i                | A                     |
//! | `torque`        | τ                | N m                   |
//! | `traction`      | t                | N, along the rim      |
//! | `force`         | F                | N, N, N m, body       |
//!
//! The speed loop of each wheel requests a current. The current follows with a first-order lag and
//! drives the wheel, of load N and motor gain γ, with the torque τ:
//!
//! ```text
//! i = sat(k_p (u_m − ω) + z),   ż = k_i (u_m − ω),   u_m = J u / r
//! τ = γ p K_T i − f ω − μ N r tanh(ω/ω_s)
//! ```
//!
//! **Without slip** the wheels turn as the body moves, ω = J v / r, and only v is dynamic. With M
//! from eqs. 19–20, M ω̇ = τ + r J⁺ᵀF is four equations for three degrees of freedom. The columns
//! of J are eigenvectors of M. So the part of the equations along J is exactly the first line
//! below. The part across J, wheels that work against each other, is held by the floor. Products of
//! different columns of J, which only odd arrangements of wheels have, are left out.
//!
//! **With slip** the wheels have speeds of their own, and their grip limits their force on the
//! floor. The largest force along the roller's axis is c N. That axis stands at γ to the rim, 45°
//! for mecanum wheels:
//!
//! ```text
//! (D + diag(Jᵀ J) I_ω/r²) v̇ = Jᵀτ/r + F
//!
//! D v̇ = Jᵀt + F,   I_ω ω̇ = τ − r t,   t = c N cos γ tanh((r ω − J v)/v_s)
//!
//!     ⎡  m    0  −S_y ⎤
//! D = ⎢  0    m   S_x ⎥,   F = (m (v_y, −v_x) ω_z + ω_z² S, −ω_z S·v)
//!     ⎣−S_y  S_x  I_z ⎦        + drag + slope + push + random force
//! ```
//! with S the mass times the position of its centre, and `I_z` about the middle between the wheels.
//! A wheel at (x, y) of n bears N = m g/n (1 + x S_x/(m x̄²) + y S_y/(m ȳ²)), with the mean squares
//! of the places.
//!
//! The first term of F comes from eq. 12 in the turning frame of the body; the paper's eq. 21 lacks
//! it.
//!
//! Reference: Wu, Tang, Xu 2023, eqs. 10–21, with sign(ω) in eq. 14 and ω̇ in eq. 18.

use core::ops::{Add, Mul};

use nalgebra::{Rotation2, SVector, Vector2, Vector3};

use super::geometry::Geometry;
use super::parameters::{Truth, WheelSlip};
use super::schedule::Conditions;

/// Standard gravity \[m/s²\].
pub(super) const GRAVITY: f64 = 9.806_65;

/// The state of the equations for W wheels, or its rate of change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct State<const W: usize> {
    /// x, y and heading in the world; the heading is not wrapped.
    pub(super) pose: Vector3<f64>,
    /// Body velocity.
    pub(super) velocity: Vector3<f64>,
    /// Wheel speeds: J v / r without slip.
    pub(super) wheel_speed: SVector<f64, W>,
    /// Motor currents; without lag, the currents that the speed loop requests.
    pub(super) current: SVector<f64, W>,
    /// z: integral part of the speed loop \[A\].
    pub(super) integral: SVector<f64, W>,
}

impl<const W: usize> Add for State<W> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            pose: self.pose + other.pose,
            velocity: self.velocity + other.velocity,
            wheel_speed: self.wheel_speed + other.wheel_speed,
            current: self.current + other.current,
            integral: self.integral + other.integral,
        }
    }
}

impl<const W: usize> Mul<f64> for State<W> {
    type Output = Self;

    fn mul(self, by: f64) -> Self {
        Self {
            pose: self.pose * by,
            velocity: self.velocity * by,
            wheel_speed: self.wheel_speed * by,
            current: self.current * by,
            integral: self.integral * by,
        }
    }
}

/// Properties of the floor below each wheel, as multiples of those elsewhere.
struct Floor<const W: usize> {
    friction: SVector<f64, W>,
    grip: SVector<f64, W>,
}

/// The robot and its world, fixed for a run.
#[derive(Debug, Clone)]
pub(super) struct Dynamics<const W: usize> {
    truth: Truth,
    geometry: Geometry<W>,
    /// Component of the weight that pulls down the slope, in the world.
    down: Vector2<f64>,
    /// Component of the weight that loads the wheels.
    level: f64,
}

impl<const W: usize> Dynamics<W> {
    /// The robot and the world that the settings describe.
    pub(super) fn new(truth: &Truth) -> Self {
        let (angle, direction) =
            truth.slope.map_or((0.0, 0.0), |slope| (slope.angle_rad, slope.direction_rad));
        Self {
            truth: truth.clone(),
            geometry: Geometry::new(&truth.wheels),
            down: angle.sin() * Vector2::new(direction.cos(), direction.sin()),
            level: angle.cos(),
        }
    }

    /// The state's rate of change. Does not allocate.
    pub(super) fn rate(&self, state: &State<W>, given: &Conditions) -> State<W> {
        let truth = &self.truth;
        let wheel_speed = self.wheel_speed(state);
        let error = self.speed_error(&wheel_speed, given);
        let demand = self.current_demand(&error, &state.integral);
        let current = if truth.current_lag_s > 0.0 { state.current } else { demand };
        let floor = self.floor(&state.pose);
        let load_n = self.load_n(given);

        let torque = SVector::from_fn(|wheel, _| {
            let speed = wheel_speed[wheel];
            let drive = given.motor_gain[wheel]
                * truth.pole_pairs
                * truth.torque_constant_nm_per_a
                * current[wheel];
            let viscous = truth.wheel_viscous_friction_nms * speed;
            let stuck = (truth.breakaway_factor - 1.0)
                * (-(speed / truth.breakaway_speed_radps).powi(2)).exp();
            let rolling = truth.rolling_friction
                * (1.0 + stuck)
                * floor.friction[wheel]
                * load_n[wheel]
                * self.geometry.radii_m[wheel];
            drive - viscous - rolling * (speed / truth.rolling_friction_speed_scale_radps).tanh()
        });
        let force = self.force(state, given);
        let (velocity, wheel_speed) = match &truth.wheel_slip {
            None => self.rolling(&torque, &force, given),
            Some(slip) => {
                let traction = self.traction(
                    state,
                    &(floor.grip.component_mul(&load_n) * slip.grip * given.grip),
                    slip,
                );
                self.slipping(&torque, &traction, &force, given)
            }
        };
        State {
            pose: world_from_body(state.pose.z, &state.velocity),
            velocity,
            wheel_speed,
            current: if truth.current_lag_s > 0.0 {
                (demand - state.current) / truth.current_lag_s
            } else {
                SVector::zeros()
            },
            integral: self.integral_rate(&error, &state.integral),
        }
    }

    /// Wheel speeds of this body velocity, without slip.
    pub(super) fn wheels_at(&self, velocity: &Vector3<f64>) -> SVector<f64, W> {
        self.geometry.wheel_speed(velocity)
    }

    /// The state of wheels that roll as the body moves. Currents and integrals are those of steady
    /// motion without load.
    pub(super) fn at_steady_rolling(&self, state: &State<W>, given: &Conditions) -> State<W> {
        let wheel_speed = self.geometry.wheel_speed(&state.velocity);
        let current = self.current_demand(&self.speed_error(&wheel_speed, given), &state.integral);
        State { wheel_speed, current, ..*state }
    }

    /// The state with its dependent parts recomputed: wheel speeds without slip and currents
    /// without lag.
    pub(super) fn consistent(&self, state: &State<W>, given: &Conditions) -> State<W> {
        let wheel_speed = self.wheel_speed(state);
        let mut fitting = State { wheel_speed, ..*state };
        if self.truth.current_lag_s <= 0.0 {
            fitting.current =
                self.current_demand(&self.speed_error(&wheel_speed, given), &state.integral);
        }
        fitting
    }

    /// F: all forces on the body except those of its wheels \[N, N, N m\], in the body frame.
    pub(super) fn force(&self, state: &State<W>, given: &Conditions) -> Vector3<f64> {
        let v = &state.velocity;
        let drag = self.truth.drag_n_s2_per_m2 * v.xy().norm();
        let down =
            world_from_body(-state.pose.z, &Vector3::new(self.down.x, self.down.y, 0.0)) * GRAVITY;
        let weight = Vector3::new(
            given.mass_kg * down.x,
            given.mass_kg * down.y,
            given.mass_moment.perp(&down.xy()),
        );
        world_from_body(-state.pose.z, &given.push_in_world) + weight + turning_frame(given, v)
            - Vector3::new(drag * v.x, drag * v.y, 0.0)
            + given.random_force
    }

    /// N: load of each wheel \[N\].
    fn load_n(&self, given: &Conditions) -> SVector<f64, W> {
        let centre = given.mass_moment / given.mass_kg;
        let squares = self.geometry.mean_squares_m2;
        let mean = given.mass_kg * GRAVITY * self.level / W as f64;
        SVector::from_fn(|wheel, _| {
            let place = self.geometry.contacts_m[wheel];
            let lean = 1.0 + centre.x * place.x / squares.x + centre.y * place.y / squares.y;
            (mean * lean).max(0.0)
        })
    }

    fn wheel_speed(&self, state: &State<W>) -> SVector<f64, W> {
        if self.truth.wheel_slip.is_some() {
            state.wheel_speed
        } else {
            self.geometry.wheel_speed(&state.velocity)
        }
    }

    /// `u_m − ω`, without its deadband.
    fn speed_error(&self, wheel_speed: &SVector<f64, W>, given: &Conditions) -> SVector<f64, W> {
        let (limit, deadband) = (self.truth.wheel_speed_limit_radps, self.truth.deadband_radps);
        self.geometry.wheel_speed(&given.command).zip_map(wheel_speed, |target, speed| {
            let error = target.clamp(-limit, limit) - speed;
            error - error.clamp(-deadband, deadband)
        })
    }

    fn current_demand(
        &self,
        error: &SVector<f64, W>,
        integral: &SVector<f64, W>,
    ) -> SVector<f64, W> {
        let limit = self.truth.current_limit_a;
        (error * self.truth.speed_loop_gain_a_s_per_rad + integral)
            .map(|current| current.clamp(-limit, limit))
    }

    /// ż; a loop at its limit has an anti-windup.
    fn integral_rate(
        &self,
        error: &SVector<f64, W>,
        integral: &SVector<f64, W>,
    ) -> SVector<f64, W> {
        let truth = &self.truth;
        error.zip_map(integral, |error, integral| {
            let demand = truth.speed_loop_gain_a_s_per_rad * error + integral;
            let winds_up = demand.abs() >= truth.current_limit_a && demand * error > 0.0;
            if winds_up { 0.0 } else { truth.speed_loop_integral_a_per_rad * error }
        })
    }

    /// v̇ and ω̇ of wheels that never slip.
    fn rolling(
        &self,
        torque: &SVector<f64, W>,
        force: &Vector3<f64>,
        given: &Conditions,
    ) -> (Vector3<f64>, SVector<f64, W>) {
        let g = &self.geometry;
        let drive = g.rim_speed_at_mean_radius.tr_mul(torque) / g.mean_radius_m;
        let wheel = self.truth.wheel_inertia_kg_m2 / (g.mean_radius_m * g.mean_radius_m);
        let planar = wheel * g.planar_squares;
        let turning = wheel * W as f64 * g.arm_m * g.arm_m;
        let acceleration =
            accelerated(given, &Vector3::new(planar.x, planar.y, turning), &(drive + force));
        (acceleration, g.wheel_speed(&acceleration))
    }

    /// t of wheels that grip the floor up to `grip_n` along their rollers' axes.
    fn traction(
        &self,
        state: &State<W>,
        grip_n: &SVector<f64, W>,
        slip: &WheelSlip,
    ) -> SVector<f64, W> {
        let g = &self.geometry;
        let slide = state.wheel_speed.component_mul(&g.radii_m)
            - g.rim_speed_from_velocity * state.velocity;
        SVector::from_fn(|wheel, _| {
            let share = (slide[wheel] / slip.slip_speed_scale_mps).tanh();
            grip_n[wheel] * g.along_rim[wheel] * share
        })
    }

    /// v̇ and ω̇ of wheels whose traction on the floor is `traction`.
    fn slipping(
        &self,
        torque: &SVector<f64, W>,
        traction: &SVector<f64, W>,
        force: &Vector3<f64>,
        given: &Conditions,
    ) -> (Vector3<f64>, SVector<f64, W>) {
        let g = &self.geometry;
        (
            accelerated(
                given,
                &Vector3::zeros(),
                &(g.rim_speed_from_velocity.tr_mul(traction) + force),
            ),
            (torque - traction.component_mul(&g.radii_m)) / self.truth.wheel_inertia_kg_m2,
        )
    }

    /// The floor below each wheel.
    fn floor(&self, pose: &Vector3<f64>) -> Floor<W> {
        let mut floor = Floor { friction: SVector::repeat(1.0), grip: SVector::repeat(1.0) };
        if self.truth.patches.is_empty() {
            return floor;
        }
        let turn = Rotation2::new(pose.z);
        for (wheel, contact) in self.geometry.contacts_m.iter().enumerate() {
            let at = pose.xy() + turn * contact;
            let below = self.truth.patches.iter().find(|patch| {
                let [from_x, from_y] = patch.from_m;
                let [to_x, to_y] = patch.to_m;
                (from_x..=to_x).contains(&at.x) && (from_y..=to_y).contains(&at.y)
            });
            if let Some(patch) = below {
                floor.friction[wheel] = patch.friction_factor;
                floor.grip[wheel] = patch.grip_factor;
            }
        }
        floor
    }
}

/// v̇ of the body under a force. `wheels` is the inertia of the wheels that turn with it. With a
/// centred mass the axes are independent.
fn accelerated(given: &Conditions, wheels: &Vector3<f64>, force: &Vector3<f64>) -> Vector3<f64> {
    let (straight, turn, moment) =
        (given.mass_kg + wheels.x, given.yaw_inertia_kg_m2 + wheels.z, given.mass_moment);
    let yaw =
        (force.z - moment.perp(&force.xy()) / straight) / (turn - moment.norm_squared() / straight);
    Vector3::new((force.x + moment.y * yaw) / straight, (force.y - moment.x * yaw) / straight, yaw)
}

/// The terms of the turning body frame: `m (v_y, −v_x) ω_z + ω_z² S` and `−ω_z S·v`. They do no
/// work.
fn turning_frame(given: &Conditions, velocity: &Vector3<f64>) -> Vector3<f64> {
    let (rate, moment) = (velocity.z, given.mass_moment);
    let straight =
        given.mass_kg * rate * Vector2::new(velocity.y, -velocity.x) + rate * rate * moment;
    Vector3::new(straight.x, straight.y, -rate * moment.dot(&velocity.xy()))
}

/// Rotates a velocity or force (x, y, yaw) from the body frame to the world frame; by −`heading`,
/// from the world frame to the body frame.
fn world_from_body(heading: f64, body: &Vector3<f64>) -> Vector3<f64> {
    let (sin, cos) = heading.sin_cos();
    Vector3::new(cos * body.x - sin * body.y, sin * body.x + cos * body.y, body.z)
}

#[cfg(test)]
mod tests;
