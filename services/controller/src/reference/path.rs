//! The shapes: position and velocity in the world as functions of time.

use super::PathSettings;
use super::points::{Points, PointsError};
use model::{Pose, wrap};
use std::f64::consts::TAU;

/// One moment on a path.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Moment {
    /// x, y \[m\].
    pub(super) position: [f64; 2],
    /// ẋ, ẏ \[m/s\].
    pub(super) velocity: [f64; 2],
    /// ẍ, ÿ \[m/s²\].
    pub(super) acceleration: [f64; 2],
    /// Heading, where the path gives one \[rad\].
    pub(super) yaw: f64,
    /// Its rate \[rad/s\].
    pub(super) yaw_rate: f64,
}

impl Moment {
    /// Direction of motion and its rate; at rest the previous direction.
    pub(super) fn tangent(&self, before: Option<f64>) -> (f64, f64) {
        let ([vx, vy], [ax, ay]) = (self.velocity, self.acceleration);
        let speed_squared = vx * vx + vy * vy;
        if speed_squared < 1e-12 {
            return (before.unwrap_or(0.0), 0.0);
        }
        (vy.atan2(vx), (vx * ay - vy * ax) / speed_squared)
    }
}

/// A path that can be sampled in the order of time.
#[derive(Debug)]
pub(super) enum Path {
    PaperCurve { speed: f64, cursor: Cursor },
    Circle { radius: f64, speed: f64 },
    FigureEight { length: f64, width: f64, lap: f64 },
    Square { side: f64, speed: f64 },
    StopAndGo { profile: Profile, pause: f64 },
    PointToPoint { from: Pose, to: Pose, profile: Profile },
    Points(Points),
}

impl Path {
    pub(super) fn new(settings: &PathSettings, start: &Pose) -> Result<Self, PointsError> {
        Ok(match *settings {
            PathSettings::PaperCurve { speed_mps } => {
                Self::PaperCurve { speed: speed_mps, cursor: Cursor::default() }
            }
            PathSettings::Circle { radius_m, speed_mps } => {
                Self::Circle { radius: radius_m, speed: speed_mps }
            }
            PathSettings::FigureEight { length_m, width_m, lap_s } => {
                Self::FigureEight { length: length_m, width: width_m, lap: lap_s }
            }
            PathSettings::Square { side_m, speed_mps } => {
                Self::Square { side: side_m, speed: speed_mps }
            }
            PathSettings::StopAndGo { stretch_m, speed_mps, acceleration_mps2, pause_s } => {
                Self::StopAndGo {
                    profile: Profile::new(stretch_m, speed_mps, acceleration_mps2),
                    pause: pause_s,
                }
            }
            PathSettings::PointToPoint { to, speed_mps, acceleration_mps2 } => {
                let distance = (to[0] - start[0]).hypot(to[1] - start[1]);
                Self::PointToPoint {
                    from: *start,
                    to,
                    profile: Profile::new(distance, speed_mps, acceleration_mps2),
                }
            }
            PathSettings::Points { ref file } => Self::Points(Points::read(file)?),
        })
    }

    /// The moment at `time`. Times must not decrease from call to call.
    pub(super) fn at(&mut self, time: f64) -> Moment {
        match self {
            Self::PaperCurve { speed, cursor } => paper_curve(cursor.follow(*speed * time), *speed),
            &mut Self::Circle { radius, speed } => {
                let rate = speed / radius;
                let (sin, cos) = (rate * time).sin_cos();
                Moment {
                    position: [radius * sin, radius * (1.0 - cos)],
                    velocity: [speed * cos, speed * sin],
                    acceleration: [-speed * rate * sin, speed * rate * cos],
                    ..Moment::default()
                }
            }
            &mut Self::FigureEight { length, width, lap } => {
                let rate = TAU / lap;
                let ((s1, c1), (s2, c2)) = ((rate * time).sin_cos(), (2.0 * rate * time).sin_cos());
                let (a, b) = (0.5 * length, 0.5 * width);
                Moment {
                    position: [a * s1, b * s2],
                    velocity: [a * rate * c1, 2.0 * b * rate * c2],
                    acceleration: [-a * rate * rate * s1, -4.0 * b * rate * rate * s2],
                    ..Moment::default()
                }
            }
            &mut Self::Square { side, speed } => square(side, speed, time),
            Self::StopAndGo { profile, pause } => {
                let cycle = profile.duration() + *pause;
                let (round, within) = ((time / cycle).floor(), time % cycle);
                let (distance, speed, acceleration) = profile.at(within);
                Moment {
                    position: [round * profile.distance + distance, 0.0],
                    velocity: [speed, 0.0],
                    acceleration: [acceleration, 0.0],
                    ..Moment::default()
                }
            }
            Self::PointToPoint { from, to, profile } => point_to_point(from, to, profile, time),
            Self::Points(points) => points.at(time),
        }
    }
}

/// Progress along the paper's curve.
#[derive(Debug, Default)]
pub(super) struct Cursor {
    along: f64,
    x: f64,
}

/// Slope of y = −½ x sin(x/20).
fn paper_slope(x: f64) -> f64 {
    -0.5 * (x / 20.0).sin() - x / 40.0 * (x / 20.0).cos()
}

impl Cursor {
    /// x at the arc length `along`, which must not be smaller than in the previous call.
    ///
    /// Runge–Kutta of dx/ds = 1/√(1 + y'²) in steps of at most 10 cm: exact to 1e-10 m over 70 m.
    fn follow(&mut self, along: f64) -> f64 {
        let rate = |x: f64| 1.0 / (1.0 + paper_slope(x).powi(2)).sqrt();
        let steps = ((along - self.along) / 0.1).ceil().max(0.0);
        let h = (along - self.along) / steps.max(1.0);
        for _ in 0..steps as usize {
            let k1 = rate(self.x);
            let k2 = rate(self.x + 0.5 * h * k1);
            let k3 = rate(self.x + 0.5 * h * k2);
            let k4 = rate(self.x + h * k3);
            self.x += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
        }
        self.along = self.along.max(along);
        self.x
    }
}

/// y = −½ x sin(x/20) at x.
fn paper_curve(x: f64, speed: f64) -> Moment {
    let bend = -0.05 * (x / 20.0).cos() + x / 800.0 * (x / 20.0).sin();
    let dy = paper_slope(x);
    let dx = 1.0 / (1.0 + dy * dy).sqrt();
    let turn = speed * speed * bend * dx.powi(4);
    Moment {
        position: [x, -0.5 * x * (x / 20.0).sin()],
        velocity: [speed * dx, speed * dx * dy],
        acceleration: [-turn * dy, turn],
        ..Moment::default()
    }
}

fn square(side: f64, speed: f64, time: f64) -> Moment {
    let along = (speed * time) % (4.0 * side);
    let edge = (along / side).floor();
    let rest = along - edge * side;
    let (position, direction) = match edge as usize {
        0 => ([rest, 0.0], [1.0, 0.0]),
        1 => ([side, rest], [0.0, 1.0]),
        2 => ([side - rest, side], [-1.0, 0.0]),
        _ => ([0.0, side - rest], [0.0, -1.0]),
    };
    Moment { position, velocity: direction.map(|d| d * speed), ..Moment::default() }
}

fn point_to_point(from: &Pose, to: &Pose, profile: &Profile, time: f64) -> Moment {
    let (distance, speed, acceleration) = profile.at(time);
    if profile.distance <= 0.0 {
        return Moment { position: [to[0], to[1]], yaw: to[2], ..Moment::default() };
    }
    let share = distance / profile.distance;
    let turn = wrap(to[2] - from[2]);
    let direction = [(to[0] - from[0]) / profile.distance, (to[1] - from[1]) / profile.distance];
    Moment {
        position: [from[0] + distance * direction[0], from[1] + distance * direction[1]],
        velocity: direction.map(|d| d * speed),
        acceleration: direction.map(|d| d * acceleration),
        yaw: from[2] + share * turn,
        yaw_rate: turn * speed / profile.distance,
    }
}

/// A trapezoidal speed profile over a distance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Profile {
    distance: f64,
    acceleration: f64,
    /// Speed in the middle; lower than requested if the distance is too short.
    peak: f64,
}

impl Profile {
    fn new(distance: f64, speed: f64, acceleration: f64) -> Self {
        Self { distance, acceleration, peak: speed.min((distance * acceleration).sqrt()) }
    }

    fn duration(&self) -> f64 {
        if self.peak > 0.0 {
            self.distance / self.peak + self.peak / self.acceleration
        } else {
            0.0
        }
    }

    /// Distance, speed and acceleration at a time.
    fn at(&self, time: f64) -> (f64, f64, f64) {
        let ramp = self.peak / self.acceleration;
        let left = self.duration() - time;
        if time < ramp {
            (0.5 * self.acceleration * time * time, self.acceleration * time, self.acceleration)
        } else if left > ramp {
            (self.peak * (time - 0.5 * ramp), self.peak, 0.0)
        } else if left > 0.0 {
            (
                self.distance - 0.5 * self.acceleration * left * left,
                self.acceleration * left,
                -self.acceleration,
            )
        } else {
            (self.distance, 0.0, 0.0)
        }
    }
}
