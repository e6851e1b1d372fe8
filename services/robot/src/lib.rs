//! The believed parameters of an omnidirectional base: wheels, response and limits.
//!
//! | module           | what it holds                                                            |
//! |------------------|--------------------------------------------------------------------------|
//! | `map`            | [`Map`]: known obstacles, zones and the border of the area               |
//! | `obstacle`       | [`Obstacle`]: a shape that moves                                         |
//! | `robot`          | [`Robot`]: the content of a robot file, and its checks                   |
//! | `shape`          | [`Shape`]: footprints and obstacles, and the distance between them       |
//! | `tracking_limit` | [`TrackingLimit`]: a number, `"none"` or the default                     |
//! | `wheels`         | [`Wheels`]: where they are, and wheel speeds from body velocity and back |
//!
//! Frame: x forward, y left, yaw counter-clockwise (REP-103). SI units. The wheels have the order
//! of the robot file.

mod map;
mod obstacle;
mod robot;
mod shape;
mod tracking_limit;
mod wheels;

pub use map::{ImpossibleMap, MAP_MAX, Map, Outline, Surroundings, Zone};
pub use obstacle::{Encircled, Obstacle};
pub use robot::{Body, Drive, Footprint, Impossible, Limits, Response, Robot};
pub use shape::{CORNERS_MAX, ImpossibleShape, Point, Separation, Shape};
pub use tracking_limit::TrackingLimit;
pub use wheels::{
    ImpossibleWheels, Layout, Mecanum, Omni, PerWheel, Rollers, Twist, WHEELS_MAX, Wheel,
    WheelList, Wheels,
};

/// Velocity axes of the body: forward, left, yaw.
pub const AXES: usize = 3;

/// Forward, left and yaw: a body velocity \[m/s, m/s, rad/s\], or one number per velocity axis.
pub type Velocity = [f64; AXES];
