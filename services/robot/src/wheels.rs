//! Where the wheels are and how they roll: the `[wheels]` of a robot file.
//!
//! A wheel at (x, y) rolls in the direction β. Its rollers turn freely about an axis at the angle γ
//! to its own. A body velocity v turns it with the rim speed J v, where
//!
//! ```text
//! J = [c − t s,  s + t c,  x (s + t c) − y (c − t s)],   c = cos β,  s = sin β,  t = tan γ
//! ```
//!
//! γ = 0 is an omni wheel, γ = ±45° a mecanum wheel. Reference: Lynch and Park, *Modern Robotics*,
//! 2017, section 13.2.1. Mecanum wheels in a rectangle have J of eqs. 4–9 of Wu, Tang, Xu 2023:
//!
//! ```text
//!     ⎡1  1  L⎤
//! J = ⎢1 −1 −L⎥   L = a + b, front-right, front-left, rear-left, rear-right
//!     ⎢1  1 −L⎥
//!     ⎣1 −1  L⎦
//! ```
//!
//! The paper's frame is x right, y forward: its (`v_x`, `v_y`) are our (−`v_y`, `v_x`). All signs
//! of its eq. 3 are +, which is wrong; its eq. 4 is right.

mod layout;

pub use layout::{Layout, Mecanum, Omni, Rollers, Twist, Wheel, WheelList};

use crate::{AXES, Velocity};
use layout::Contact;
use serde::{Deserialize, Serialize};

/// Most wheels that a robot can have.
pub const WHEELS_MAX: usize = 8;

/// One number per wheel; unused places are 0.
pub type PerWheel = [f64; WHEELS_MAX];

/// Smallest isotropy 27 det(S)/tr(S)³ of wheels that can drive a robot, with S = Jᵀ J in metres per
/// second on all axes. 1 is a robot that its wheels drive equally well in all directions, 0 one
/// that they cannot drive in one of them.
const ISOTROPY_MIN: f64 = 0.01;

/// Wheels that no robot can have. Each text names the key in `[wheels]` first.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImpossibleWheels {
    /// A number out of its range.
    #[error("{key}: expected {expected}, not {value}")]
    Value {
        /// The key.
        key: String,
        /// Its value.
        value: f64,
        /// Values that it can have.
        expected: &'static str,
    },
    /// Too few or too many.
    #[error("{key}: expected 3 to 8 wheels, not {count}")]
    Count {
        /// The key.
        key: &'static str,
        /// Number of wheels.
        count: usize,
    },
    /// None, or several that contradict each other.
    #[error("wheels: expected one of mecanum, omni, list and twist, not {}", joined(.0))]
    Kinds(Vec<&'static str>),
    /// They cannot drive the robot in every direction.
    #[error(
        "{kind}: expected wheels that drive the robot in every direction: 27 det(JᵀJ)/tr(JᵀJ)³ is \
        {isotropy:.4}, and at least {ISOTROPY_MIN} is needed; J has the rows {rows:?}"
    )]
    Rank {
        /// The key.
        kind: &'static str,
        /// Isotropy.
        isotropy: f64,
        /// J.
        rows: Vec<Velocity>,
    },
}

fn joined(kinds: &[&str]) -> String {
    if kinds.is_empty() { "none of them".to_owned() } else { kinds.join(" and ") }
}

/// The wheels of one robot, and the kinematics between wheels and body. Constant.
///
/// ```
/// use robot::Wheels;
/// let wheels = Wheels::mecanum(0.05, 0.25, 0.3)?;
/// assert_eq!(wheels.speeds([1.0, 0.0, 0.0])[..4], [20.0; 4]);
/// let [forward, left, yaw] = wheels.body(&wheels.speeds([1.0, 0.5, 2.0]));
/// assert!((forward - 1.0).abs() < 1e-12 && (left - 0.5).abs() < 1e-12);
/// assert!((yaw - 2.0).abs() < 1e-12);
/// # Ok::<(), robot::ImpossibleWheels>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Layout", into = "Layout")]
pub struct Wheels {
    layout: Layout,
    count: usize,
    /// J.
    rows: [Velocity; WHEELS_MAX],
    radius_m: PerWheel,
    position_m: [[f64; 2]; WHEELS_MAX],
    direction_rad: PerWheel,
    /// (Jᵀ J)⁻¹.
    inverse: [Velocity; AXES],
}

impl TryFrom<Layout> for Wheels {
    type Error = ImpossibleWheels;

    fn try_from(layout: Layout) -> Result<Self, ImpossibleWheels> {
        let mut this = Self::assembled(&layout, &layout.contacts()?);
        if this.count > 0 {
            this.inverse = this.inverse_of_normal_matrix()?;
        }
        Ok(this)
    }
}

impl From<Wheels> for Layout {
    fn from(wheels: Wheels) -> Self {
        wheels.layout
    }
}

impl Wheels {
    /// Four mecanum wheels in a rectangle, with rollers that form an O.
    ///
    /// # Errors
    /// [`ImpossibleWheels`].
    pub fn mecanum(
        radius_m: f64,
        wheelbase_m: f64,
        track_m: f64,
    ) -> Result<Self, ImpossibleWheels> {
        Layout::Mecanum(Mecanum { radius_m, wheelbase_m, track_m, rollers: Rollers::O }).try_into()
    }

    /// The wheels of the paper's base.
    pub(crate) fn example() -> Self {
        let mecanum =
            Mecanum { radius_m: 0.05, wheelbase_m: 0.25, track_m: 0.3, rollers: Rollers::O };
        let mut this = Self::assembled(&Layout::Mecanum(mecanum), &mecanum.places());
        this.inverse = this.inverse_of_normal_matrix().unwrap_or_default();
        this
    }

    /// These wheels, without the inverse.
    fn assembled(layout: &Layout, wheels: &[Contact]) -> Self {
        let mut this = Self {
            layout: *layout,
            count: wheels.len(),
            rows: Default::default(),
            radius_m: Default::default(),
            position_m: Default::default(),
            direction_rad: Default::default(),
            inverse: Default::default(),
        };
        for (place, wheel) in wheels.iter().enumerate().take(WHEELS_MAX) {
            this.rows[place] = wheel.row;
            this.radius_m[place] = wheel.radius_m;
            this.position_m[place] = wheel.position_m;
            this.direction_rad[place] = wheel.direction_rad;
        }
        this
    }

    /// The layout, as in the robot file.
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Number of wheels; 0 if they are not known.
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Rows of J: rim speed of each wheel per body velocity \[1, 1, m\].
    pub fn rows(&self) -> &[Velocity] {
        self.rows.get(..self.count).unwrap_or_default()
    }

    /// r of each wheel \[m\].
    pub fn radii_m(&self) -> &[f64] {
        self.radius_m.get(..self.count).unwrap_or_default()
    }

    /// Contact of each wheel with the floor, forward and left of the centre \[m\].
    pub fn positions_m(&self) -> &[[f64; 2]] {
        self.position_m.get(..self.count).unwrap_or_default()
    }

    /// Direction in which each wheel rolls, counter-clockwise from forward \[rad\].
    pub fn directions_rad(&self) -> &[f64] {
        self.direction_rad.get(..self.count).unwrap_or_default()
    }

    /// Rows of J, each times the `factor` of its wheel's radius \[m\]. Unused rows are 0.
    pub fn scaled_rows(&self, factor: impl Fn(f64) -> f64) -> [Velocity; WHEELS_MAX] {
        let mut scaled = [[0.0; AXES]; WHEELS_MAX];
        for ((to, row), radius) in scaled.iter_mut().zip(self.rows()).zip(self.radii_m()) {
            let factor = factor(*radius);
            *to = row.map(|value| value * factor);
        }
        scaled
    }

    /// Wheel speeds J v / r of a body velocity \[rad/s\].
    pub fn speeds(&self, velocity: Velocity) -> PerWheel {
        let mut speeds = [0.0; WHEELS_MAX];
        for ((speed, row), radius) in speeds.iter_mut().zip(self.rows()).zip(self.radii_m()) {
            *speed = (row[0] * velocity[0] + row[1] * velocity[1] + row[2] * velocity[2]) / radius;
        }
        speeds
    }

    /// Body velocity of wheel speeds, (JᵀJ)⁻¹ Jᵀ r ω \[m/s, m/s, rad/s\]: the least-squares
    /// solution if they contradict each other.
    pub fn body(&self, speeds: &PerWheel) -> Velocity {
        let mut sums = [0.0; AXES];
        for ((row, radius), speed) in self.rows().iter().zip(self.radii_m()).zip(speeds) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += value * radius * speed;
            }
        }
        self.inverse.map(|row| row[0] * sums[0] + row[1] * sums[1] + row[2] * sums[2])
    }

    /// Largest body velocity on an axis while no rim is faster than 1 m/s \[m/s or rad/s\].
    pub fn largest_body(&self, axis: usize) -> f64 {
        let of = &self.inverse[axis];
        let shares = self.rows().iter().map(|row| of[0] * row[0] + of[1] * row[1] + of[2] * row[2]);
        shares.map(f64::abs).sum()
    }

    /// Mean of r \[m\].
    pub fn radius_m(&self) -> f64 {
        pairwise_sum(self.radii_m()) / self.count as f64
    }

    /// Sum of the squares of each column of J r̄/r, with r̄ the mean radius \[1, 1, m²\].
    pub fn square_sums(&self) -> Velocity {
        let mean = self.radius_m();
        std::array::from_fn(|axis| {
            let squares = self.rows().iter().zip(self.radii_m());
            let squares: Vec<f64> =
                squares.map(|(row, radius)| (row[axis] * (mean / radius)).powi(2)).collect();
            pairwise_sum(&squares)
        })
    }

    /// L: rim speed per yaw rate, root mean square over the wheels; a + b of mecanum wheels in a
    /// rectangle. Half of length and width for a base without known wheels \[m\].
    pub fn lever_m(&self) -> f64 {
        if let Layout::Twist(Twist { length_m, width_m }) = self.layout {
            return 0.5 * (length_m + width_m);
        }
        let squares: Vec<f64> = self.rows().iter().map(|row| row[2] * row[2]).collect();
        (pairwise_sum(&squares) / self.count as f64).sqrt()
    }

    /// Half of the extent forward and to the side: of the rectangle around all wheels, or of a base
    /// without known wheels \[m\].
    pub fn half_extent_m(&self) -> [f64; 2] {
        if let Layout::Twist(Twist { length_m, width_m }) = self.layout {
            return [0.5 * length_m, 0.5 * width_m];
        }
        let largest = |axis: usize| {
            self.positions_m().iter().map(|place| place[axis].abs()).fold(0.0, f64::max)
        };
        [largest(0), largest(1)]
    }

    /// Means of the squares of the wheels' x and y \[m², m²\].
    pub fn mean_squares_m2(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            let squares: Vec<f64> =
                self.positions_m().iter().map(|place| place[axis] * place[axis]).collect();
            pairwise_sum(&squares) / self.count as f64
        })
    }

    /// Name of a wheel for people.
    pub const fn name(&self, wheel: usize) -> &'static str {
        let names = match self.layout {
            Layout::Mecanum(_) => {
                ["front-right", "front-left", "rear-left", "rear-right", "-", "-", "-", "-"]
            }
            _ => [
                "wheel 1", "wheel 2", "wheel 3", "wheel 4", "wheel 5", "wheel 6", "wheel 7",
                "wheel 8",
            ],
        };
        if wheel < WHEELS_MAX { names[wheel] } else { "-" }
    }

    /// (Jᵀ J)⁻¹, if the wheels can drive the robot in every direction.
    fn inverse_of_normal_matrix(&self) -> Result<[Velocity; AXES], ImpossibleWheels> {
        let entry = |i: usize, j: usize| {
            let products: Vec<f64> = self.rows().iter().map(|row| row[i] * row[j]).collect();
            pairwise_sum(&products)
        };
        let [a, b, c, d, e, f] =
            [entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)];
        let adjugate = [
            [d * f - e * e, c * e - b * f, b * e - c * d],
            [c * e - b * f, a * f - c * c, b * c - a * e],
            [b * e - c * d, b * c - a * e, a * d - b * b],
        ];
        let determinant = a * adjugate[0][0] + b * adjugate[0][1] + c * adjugate[0][2];
        // A yaw rate counts as the speed at the wheels' root-mean-square distance.
        let square: f64 = self.mean_squares_m2().iter().sum();
        let trace = a + d + f / square;
        let isotropy = 27.0 * determinant / square / trace.powi(3);
        if isotropy >= ISOTROPY_MIN {
            Ok(adjugate.map(|row| row.map(|value| value / determinant)))
        } else {
            let (kind, rows) = (self.layout.kind(), self.rows().to_vec());
            Err(ImpossibleWheels::Rank { kind, isotropy, rows })
        }
    }
}

/// Sum in pairs: exact for four equal numbers.
fn pairwise_sum(values: &[f64]) -> f64 {
    match values {
        [] => 0.0,
        [value] => *value,
        _ => {
            let (low, high) = values.split_at(values.len().div_ceil(2));
            pairwise_sum(low) + pairwise_sum(high)
        }
    }
}

#[cfg(test)]
mod tests;
