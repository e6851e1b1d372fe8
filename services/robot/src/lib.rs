//! The believed parameters of a mecanum base: wheel positions, kinematics and limits.
//!
//! | module         | what it holds                                                    |
//! |----------------|------------------------------------------------------------------|
//! | `robot`        | [`Robot`]: the content of a robot file, and its checks           |
//! | `tracking_limit` | [`TrackingLimit`]: a number, `"none"` or the default           |
//! | `geometry`     | [`Geometry`]: where the wheels are                               |
//! | [`kinematics`] | wheel speeds from body velocity and back                         |
//!
//! Frame: x forward, y left, yaw counter-clockwise (REP-103). SI units. Wheels in the order
//! front-right, front-left, rear-left, rear-right.

mod geometry;
pub mod kinematics;
mod robot;
mod tracking_limit;

pub use geometry::Geometry;
pub use robot::{Body, Drive, Impossible, Limits, Robot};
pub use tracking_limit::TrackingLimit;

/// Velocity axes of the body: forward, left, yaw.
pub const AXES: usize = 3;

/// Forward, left and yaw: a body velocity \[m/s, m/s, rad/s\], or one number per velocity axis.
pub type Velocity = [f64; AXES];
