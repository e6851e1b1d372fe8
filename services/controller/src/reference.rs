//! The reference trajectory: a table of pose and velocity, one row per tick, made before the run.
//!
//! Every row holds the pose in the world and the velocity in the reference's own heading. After the
//! end of the table, the robot stands at the last pose.

mod path;
mod points;

pub use points::PointsError;

use model::{Pose, Velocity, wrap};
use path::Path;
use serde::{Deserialize, Serialize};
use settings::Impossible;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Largest distance from the world's origin \[m\], and largest yaw \[rad\].
pub const PLACE_MAX: f64 = 1e6;

// Ranges of path parameters: wide enough for every robot, and such that every number on the path is
// finite.
const METRES: RangeInclusive<f64> = 1e-3..=PLACE_MAX;
const METRES_PER_SECOND: RangeInclusive<f64> = 1e-3..=100.0;
const METRES_PER_SECOND_SQUARED: RangeInclusive<f64> = 1e-3..=1e4;
const SECONDS: RangeInclusive<f64> = 1e-3..=1e4;
const SPEED_FACTORS: RangeInclusive<f64> = 1e-3..=1e3;

/// Settings of the reference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceSettings {
    /// The path over time.
    pub path: PathSettings,
    /// Heading along the path.
    pub heading: Heading,
    /// Time in which the path's own clock accelerates from standstill to its full rate \[s\]. With
    /// 0 the robot must move from the first tick on.
    #[serde(default)]
    pub ramp_s: f64,
    /// Rate of the path's own clock: less than 1 for a slower robot on the same path \[1\].
    #[serde(default = "unchanged")]
    pub speed_factor: f64,
}

fn unchanged() -> f64 {
    1.0
}

/// Heading along the path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Heading {
    /// Along the path.
    Tangent,
    /// Always the same yaw \[rad\].
    FixedRad(f64),
    /// From the path itself: for points with a yaw, and point to point.
    Given,
}

/// A path over time. All begin at the world's origin, unless stated otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum PathSettings {
    /// The paper's curve y = −½ x sin(x/20).
    PaperCurve {
        /// Speed along it \[m/s\].
        speed_mps: f64,
    },
    /// A circle around (0, `radius_m`), counter-clockwise.
    Circle {
        /// Its radius \[m\].
        radius_m: f64,
        /// Speed along it \[m/s\].
        speed_mps: f64,
    },
    /// A horizontal figure eight: x = ½ length sin(2π t/lap), y = ½ width sin(4π t/lap).
    FigureEight {
        /// Its extent in x \[m\].
        length_m: f64,
        /// Its extent in y \[m\].
        width_m: f64,
        /// Time of one lap \[s\].
        lap_s: f64,
    },
    /// A square, counter-clockwise, whose corners are not rounded.
    Square {
        /// Its side \[m\].
        side_m: f64,
        /// Speed along it \[m/s\].
        speed_mps: f64,
    },
    /// Straight ahead to a stop, repeatedly.
    StopAndGo {
        /// Length of one stretch \[m\].
        stretch_m: f64,
        /// Speed in its middle \[m/s\].
        speed_mps: f64,
        /// Acceleration and deceleration \[m/s²\].
        acceleration_mps2: f64,
        /// Time at rest \[s\].
        pause_s: f64,
    },
    /// In a straight line from the start to a pose, and stay there.
    PointToPoint {
        /// The pose (x, y, yaw) \[m, m, rad\].
        to: [f64; 3],
        /// Speed on the way \[m/s\].
        speed_mps: f64,
        /// Acceleration and deceleration \[m/s²\].
        acceleration_mps2: f64,
    },
    /// Points from a CSV file with the columns `time_s,x_m,y_m,yaw_rad`, straight lines in between.
    Points {
        /// The file, relative to the working directory.
        file: PathBuf,
    },
}

/// Pose and velocity at one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReferencePoint {
    /// Pose in the world; yaw is continuous along the table.
    pub pose: Pose,
    /// Velocity in the reference's own heading.
    pub velocity: Velocity,
    /// Direction of motion in the world; at rest the previous direction \[rad\].
    pub course: f64,
}

impl ReferencePoint {
    /// Distance of a position to the left of the reference, across its course \[m\].
    pub fn lateral(&self, pose: &Pose) -> f64 {
        let [x, y] = self.leftwards();
        x * (pose[0] - self.pose[0]) + y * (pose[1] - self.pose[1])
    }

    /// The direction across its course, to the left, in the world.
    pub fn leftwards(&self) -> [f64; 2] {
        let (sin, cos) = self.course.sin_cos();
        [-sin, cos]
    }
}

/// The table. Constant during a run.
#[derive(Debug, Clone, Default)]
pub struct Reference {
    points: Vec<ReferencePoint>,
    /// Tick of the first point.
    first_tick: u64,
}

impl ReferenceSettings {
    /// Checks that the path exists.
    ///
    /// # Errors
    /// [`Impossible`] names the first impossible setting.
    pub fn check(&self) -> Result<(), Impossible> {
        self.path.check()?;
        if !(0.0..=*SECONDS.end()).contains(&self.ramp_s) {
            return Err(Impossible::new("ramp_s", format!("0 to {} s", SECONDS.end())));
        }
        if !SPEED_FACTORS.contains(&self.speed_factor) {
            let (least, most) = (SPEED_FACTORS.start(), SPEED_FACTORS.end());
            return Err(Impossible::new(
                "speed_factor",
                format!("a factor from {least} to {most}"),
            ));
        }
        match self.heading {
            Heading::FixedRad(yaw) if yaw.is_nan() || yaw.abs() > PLACE_MAX => {
                Err(Impossible::new(
                    "heading.fixed-rad",
                    format!("an angle in radians of at most {PLACE_MAX}, either way"),
                ))
            }
            Heading::Given
                if !matches!(
                    self.path,
                    PathSettings::Points { .. } | PathSettings::PointToPoint { .. }
                ) =>
            {
                Err(Impossible {
                    key: "heading".into(),
                    expected: "\"tangent\" or { fixed-rad = … }: this path gives no heading".into(),
                })
            }
            _ => Ok(()),
        }
    }
}

impl ReferenceSettings {
    /// Time of one lap \[s\]; `None` of a path that does not come back.
    pub fn lap_s(&self) -> Option<f64> {
        Some(self.path.lap_s()? / self.speed_factor)
    }
}

impl PathSettings {
    /// Time of one lap by the path's own clock \[s\].
    fn lap_s(&self) -> Option<f64> {
        match *self {
            Self::Circle { radius_m, speed_mps } => {
                Some(std::f64::consts::TAU * radius_m / speed_mps)
            }
            Self::FigureEight { lap_s, .. } => Some(lap_s),
            Self::Square { side_m, speed_mps } => Some(4.0 * side_m / speed_mps),
            Self::PaperCurve { .. }
            | Self::StopAndGo { .. }
            | Self::PointToPoint { .. }
            | Self::Points { .. } => None,
        }
    }

    fn check(&self) -> Result<(), Impossible> {
        let speed = |speed: f64| ("speed_mps", speed, METRES_PER_SECOND);
        let acceleration =
            |acceleration: f64| ("acceleration_mps2", acceleration, METRES_PER_SECOND_SQUARED);
        let (kind, numbers) = match *self {
            Self::PaperCurve { speed_mps } => ("paper-curve", vec![speed(speed_mps)]),
            Self::Circle { radius_m, speed_mps } => {
                ("circle", vec![("radius_m", radius_m, METRES), speed(speed_mps)])
            }
            Self::FigureEight { length_m, width_m, lap_s } => (
                "figure-eight",
                vec![
                    ("length_m", length_m, METRES),
                    ("width_m", width_m, METRES),
                    ("lap_s", lap_s, SECONDS),
                ],
            ),
            Self::Square { side_m, speed_mps } => {
                ("square", vec![("side_m", side_m, METRES), speed(speed_mps)])
            }
            Self::StopAndGo { stretch_m, speed_mps, acceleration_mps2, pause_s } => (
                "stop-and-go",
                vec![
                    ("stretch_m", stretch_m, METRES),
                    speed(speed_mps),
                    acceleration(acceleration_mps2),
                    ("pause_s", pause_s, SECONDS),
                ],
            ),
            Self::PointToPoint { speed_mps, acceleration_mps2, .. } => {
                ("point-to-point", vec![speed(speed_mps), acceleration(acceleration_mps2)])
            }
            Self::Points { .. } => ("points", Vec::new()),
        };
        for (key, value, range) in numbers {
            if !range.contains(&value) {
                return Err(Impossible::new(
                    format!("path.{kind}.{key}"),
                    format!("a number from {} to {}", range.start(), range.end()),
                ));
            }
        }
        match self {
            Self::PointToPoint { to, .. } if !is_place(to) => Err(Impossible::new(
                "path.point-to-point.to",
                format!("three numbers x, y, yaw of at most {PLACE_MAX}, either way"),
            )),
            _ => Ok(()),
        }
    }
}

/// Whether a robot can be at `pose`.
pub fn is_place(pose: &Pose) -> bool {
    pose.iter().all(|value| value.abs() <= PLACE_MAX)
}

impl ReferenceSettings {
    /// Time on the path's own clock at `time` \[s\], and the clock's rate. The rate grows linearly
    /// during the ramp, and is constant afterwards.
    fn path_time(&self, time: f64) -> (f64, f64) {
        if time < self.ramp_s {
            let factor = self.speed_factor;
            (factor * (0.5 * time * time / self.ramp_s), factor * (time / self.ramp_s))
        } else {
            (self.speed_factor * (time - 0.5 * self.ramp_s), self.speed_factor)
        }
    }
}

impl Reference {
    /// The table for `ticks` ticks of `period` \[s\], for a robot that starts at `start`.
    ///
    /// # Errors
    /// [`PointsError`] if a file of points cannot be used.
    pub fn new(
        settings: &ReferenceSettings,
        start: &Pose,
        period: f64,
        ticks: usize,
    ) -> Result<Self, PointsError> {
        let mut path = Path::new(&settings.path, start)?;
        let (mut yaw_before, mut course_before) = (None, None);
        let points = (0..=ticks)
            .map(|tick| {
                let (time, pace) = settings.path_time(tick as f64 * period);
                let at = path.at(time);
                let (yaw, rate) = match settings.heading {
                    Heading::FixedRad(yaw) => (yaw, 0.0),
                    Heading::Given => (at.yaw, pace * at.yaw_rate),
                    Heading::Tangent => {
                        let (yaw, rate) = at.tangent(yaw_before);
                        (yaw, pace * rate)
                    }
                };
                let yaw = yaw_before.map_or(yaw, |before| before + wrap(yaw - before));
                yaw_before = Some(yaw);
                let (course, _) = at.tangent(course_before);
                course_before = Some(course);
                let (sin, cos) = yaw.sin_cos();
                let [vx, vy] = at.velocity.map(|velocity| pace * velocity);
                let velocity = [cos * vx + sin * vy, cos * vy - sin * vx, rate];
                ReferencePoint { pose: [at.position[0], at.position[1], yaw], velocity, course }
            })
            .collect();
        Ok(Self { points, first_tick: 0 })
    }

    /// The table of these points, the first one for `first_tick`.
    pub fn of_points(points: Vec<ReferencePoint>, first_tick: u64) -> Self {
        Self { points, first_tick }
    }

    /// The reference at a tick. Does not allocate.
    pub fn at(&self, tick: u64) -> ReferencePoint {
        let index = usize::try_from(tick.saturating_sub(self.first_tick)).unwrap_or(usize::MAX);
        let behind_the_end = || {
            self.points.last().map_or_else(ReferencePoint::default, |last| ReferencePoint {
                velocity: [0.0; 3],
                ..*last
            })
        };
        self.points.get(index).copied().unwrap_or_else(behind_the_end)
    }
}

#[cfg(test)]
mod tests;
