//! A motion that tells the parameters apart: steps and sines of velocity, on one axis and on all
//! together, within a rectangle. Forward, then left, then yaw:
//!
//! | share of the time | motion                                                            |
//! |-------------------|-------------------------------------------------------------------|
//! | 15 %              | steps                                                             |
//! | 5 %               | a sum of five sines                                               |
//! | 13 %              | steps on all axes at once                                         |
//!
//! So each part of a drive shows a little of everything. It begins and ends at rest. A step is as
//! steep as the acceleration allows, and lasts 0.3 to 1.2 s longer, so that a robot reaches its
//! steady speed in some and not in others. A step that would leave the rectangle is replaced by one
//! towards its middle.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use robot::{AXES, Velocity};
use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Where the robot may drive, and how fast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Room {
    /// Length of the rectangle in x and width in y, around the start \[m, m\].
    pub size_m: [f64; 2],
    /// Largest planar speed \[m/s\].
    pub speed_mps: f64,
    /// Largest yaw rate \[rad/s\].
    pub yaw_rate_radps: f64,
    /// Largest acceleration: forward, left, yaw \[m/s², m/s², rad/s²\].
    pub acceleration: Velocity,
}

/// Where the robot is to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Time \[s\].
    pub time_s: f64,
    /// x, y, yaw from the start \[m, m, rad\].
    pub pose: [f64; AXES],
}

/// Share of the rectangle that the motion uses. The robot is late by its dead time and overshoots.
const USED: f64 = 1.0 - UNUSED;
/// Share that it keeps free.
pub const UNUSED: f64 = 0.3;
/// Largest yaw from the start \[rad\].
const YAW_MAX: f64 = 1.5;
/// Shortest and longest step \[s\].
const HOLD_S: [f64; 2] = [0.3, 1.2];
/// Length of a step to full speed, and of the one that reverses it \[s\]: it ends where it began.
const FULL_S: f64 = 0.6;
/// Speeds of the other steps, as shares of the full speed.
const LEVELS: [f64; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];
/// Rest at both ends \[s\].
const REST_S: f64 = 1.0;
/// Frequencies of the sines \[Hz\].
const SINES_HZ: [f64; 5] = [0.4, 0.7, 1.1, 1.9, 3.1];
/// Tries until a step goes towards the middle instead.
const TRIES: usize = 12;

/// The motion in `room`, one point per period of `period_s` for `duration_s` \[s\].
pub fn motion(room: &Room, duration_s: f64, period_s: f64, seed: u64) -> Vec<Point> {
    let mut plan = Plan {
        room,
        period_s,
        random: Pcg64Mcg::seed_from_u64(seed),
        points: vec![Point { time_s: 0.0, pose: [0.0; AXES] }],
        velocity: [0.0; AXES],
    };
    let moving = (duration_s - 2.0 * REST_S).max(0.0);
    plan.hold([0.0; AXES], REST_S);
    for axis in 0..AXES {
        plan.steps(std::array::from_fn(|other| other == axis), 0.15 * moving);
        plan.sines(axis, 0.05 * moving);
        plan.steps([true; AXES], 0.4 / AXES as f64 * moving);
    }
    plan.hold([0.0; AXES], REST_S);
    plan.points
}

struct Plan<'a> {
    room: &'a Room,
    period_s: f64,
    random: Pcg64Mcg,
    points: Vec<Point>,
    /// At the last point.
    velocity: Velocity,
}

impl Plan<'_> {
    fn pose(&self) -> [f64; AXES] {
        self.points.last().map_or([0.0; AXES], |point| point.pose)
    }

    fn largest(&self) -> Velocity {
        // Both planar axes together stay below the speed.
        let planar = self.room.speed_mps;
        [planar, planar, self.room.yaw_rate_radps]
    }

    /// Steps on `axes` for `time` \[s\], and then rest. The first step is to full speed, and the
    /// second one reverses it: nothing asks more of the drives.
    fn steps(&mut self, axes: [bool; AXES], time: f64) {
        let mut left = time - self.ramp_s();
        let planar = if axes[0] && axes[1] { FRAC_1_SQRT_2 } else { 1.0 };
        let mut number = 0;
        let mut velocity = [0.0; AXES];
        while left > HOLD_S[0] {
            let hold =
                if number < 2 { FULL_S } else { self.random.random_range(HOLD_S[0]..HOLD_S[1]) };
            let hold = (hold + self.ramp_s()).min(left);
            let tried: Vec<Velocity> = match number {
                0 => self.full_steps(axes, planar),
                1 => vec![velocity.map(|speed| -speed)],
                _ => (0..TRIES).map(|_| self.step(axes, planar)).collect(),
            };
            let fits = tried.into_iter().find(|&velocity| self.stays(velocity, hold));
            velocity = fits.unwrap_or_else(|| self.inwards(axes, planar, hold));
            self.hold(velocity, hold);
            left -= hold;
            number += 1;
        }
        self.hold([0.0; AXES], left.max(0.0) + self.ramp_s());
    }

    /// Longest time from rest to the largest speed \[s\].
    fn ramp_s(&self) -> f64 {
        let times = (0..AXES).map(|axis| self.largest()[axis] / self.room.acceleration[axis]);
        times.fold(0.0, f64::max)
    }

    /// Full speed on `axes`, in each direction, from a random one on.
    fn full_steps(&mut self, axes: [bool; AXES], planar: f64) -> Vec<Velocity> {
        let first = self.random.random_range(0..1 << AXES);
        let signs = (0..1 << AXES).map(|number| first ^ number);
        let level = |signs: usize, axis: usize| if signs >> axis & 1 == 0 { 1.0 } else { -1.0 };
        signs
            .map(|signs| {
                self.velocity_of(std::array::from_fn(|axis| level(signs, axis)), axes, planar)
            })
            .collect()
    }

    /// A random step: half or full speed, either way, or rest.
    fn step(&mut self, axes: [bool; AXES], planar: f64) -> Velocity {
        let levels = [(); AXES].map(|()| LEVELS[self.random.random_range(0..LEVELS.len())]);
        self.velocity_of(levels, axes, planar)
    }

    /// These shares of the full speed on `axes`.
    fn velocity_of(&self, levels: Velocity, axes: [bool; AXES], planar: f64) -> Velocity {
        let largest = self.largest();
        std::array::from_fn(|axis| {
            let factor = if axis < 2 { planar } else { 1.0 };
            if axes[axis] { levels[axis] * factor * largest[axis] } else { 0.0 }
        })
    }

    /// The velocity on `axes` that goes back towards the start within `hold` \[s\].
    fn inwards(&self, axes: [bool; AXES], planar: f64, hold: f64) -> Velocity {
        let [x, y, yaw] = self.pose();
        let (sin, cos) = yaw.sin_cos();
        let back = [-(cos * x + sin * y), -(cos * y - sin * x), -yaw];
        let largest = self.largest();
        std::array::from_fn(|axis| {
            let most = largest[axis] * if axis < 2 { planar } else { 1.0 };
            if axes[axis] { (back[axis] / hold).clamp(-most, most) } else { 0.0 }
        })
    }

    /// Five sines on `axis` for `time` \[s\], as fast as the rectangle allows; rest where there is
    /// no room for any.
    fn sines(&mut self, axis: usize, time: f64) {
        let mut share = self.largest()[axis] / SINES_HZ.len() as f64;
        let begin = (self.points.len(), self.velocity);
        for _ in 0..TRIES {
            for _ in 0..TRIES {
                let phases = SINES_HZ.map(|_| self.random.random_range(0.0..TAU));
                self.sum_of_sines(axis, time, share, phases);
                let made = self.points.iter().skip(begin.0);
                if made.into_iter().all(|point| self.is_inside(&point.pose)) {
                    return;
                }
                self.points.truncate(begin.0);
                self.velocity = begin.1;
            }
            share *= 0.7;
        }
        self.hold([0.0; AXES], time);
    }

    fn sum_of_sines(&mut self, axis: usize, time: f64, share: f64, phases: [f64; 5]) {
        let count = (time / self.period_s) as usize;
        for number in 0..count {
            let now = number as f64 * self.period_s;
            let sines = SINES_HZ
                .iter()
                .zip(phases)
                .map(|(hertz, phase)| share * (TAU * hertz * now + phase).sin());
            let mut velocity = [0.0; AXES];
            velocity[axis] = sines.sum();
            self.advance(velocity);
        }
        self.hold([0.0; AXES], self.ramp_s());
    }

    fn hold(&mut self, velocity: Velocity, time: f64) {
        for _ in 0..(time / self.period_s).round() as usize {
            self.advance(velocity);
        }
    }

    fn advance(&mut self, velocity: Velocity) {
        let time_s = self.points.len() as f64 * self.period_s;
        self.velocity = self.towards(self.velocity, velocity, self.period_s);
        let pose = moved(self.pose(), self.velocity, self.period_s);
        self.points.push(Point { time_s, pose });
    }

    /// The velocity `time` \[s\] later, on the way to another one.
    fn towards(&self, from: Velocity, to: Velocity, time: f64) -> Velocity {
        std::array::from_fn(|axis| {
            let most = self.room.acceleration[axis] * time;
            from[axis] + (to[axis] - from[axis]).clamp(-most, most)
        })
    }

    /// Whether the robot stays within the rectangle for `hold` \[s\], and until it stands then.
    fn stays(&self, velocity: Velocity, hold: f64) -> bool {
        let part = 0.05;
        let (mut pose, mut now) = (self.pose(), self.velocity);
        let parts = ((hold + self.ramp_s()) / part).ceil() as usize;
        (0..parts).all(|number| {
            let to = if (number as f64) * part < hold { velocity } else { [0.0; AXES] };
            now = self.towards(now, to, part);
            pose = moved(pose, now, part);
            self.is_inside(&pose)
        })
    }

    fn is_inside(&self, pose: &[f64; AXES]) -> bool {
        let [length, width] = self.room.size_m;
        pose[0].abs() <= 0.5 * USED * length
            && pose[1].abs() <= 0.5 * USED * width
            && pose[2].abs() <= YAW_MAX
    }
}

/// The pose after `time` \[s\] with a constant body velocity, by the heading in the middle.
fn moved([x, y, yaw]: [f64; AXES], velocity: Velocity, time: f64) -> [f64; AXES] {
    let (sin, cos) = (yaw + 0.5 * time * velocity[2]).sin_cos();
    [
        x + time * (cos * velocity[0] - sin * velocity[1]),
        y + time * (sin * velocity[0] + cos * velocity[1]),
        yaw + time * velocity[2],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_at_the_edge_of_its_room_rests_where_sines_have_no_room() {
        let room = Room {
            size_m: [1.0, 1.0],
            speed_mps: 0.5,
            yaw_rate_radps: 1.0,
            acceleration: [1e3; AXES],
        };
        let at_edge = Point { time_s: 0.0, pose: [0.36, 0.0, 0.0] };
        let mut plan = Plan {
            room: &room,
            period_s: 0.02,
            random: Pcg64Mcg::seed_from_u64(1),
            points: vec![at_edge],
            velocity: [0.0; AXES],
        };
        plan.sines(0, 3.0);
        assert_eq!(plan.pose(), at_edge.pose);
        assert!(plan.points.len() > 140, "{}", plan.points.len());
    }

    #[test]
    fn the_motion_stays_in_its_room_and_moves_every_axis() {
        for (seed, acceleration) in (1..20).zip([1.0, 1e3].into_iter().cycle()) {
            let room = Room {
                size_m: [2.0, 1.5],
                speed_mps: 0.6,
                yaw_rate_radps: 1.0,
                acceleration: [acceleration; AXES],
            };
            let points = motion(&room, 60.0, 0.02, seed);
            let mut fastest = [0.0_f64; AXES];
            for pair in points.windows(2) {
                let [x, y, yaw] = pair[1].pose;
                // Steps are predicted with a coarser time than they are made.
                let inside = x.abs() <= 0.72 && y.abs() <= 0.55 && yaw.abs() <= 1.55;
                assert!(inside, "{:?}", pair[1]);
                let [from, to] = [pair[0].pose, pair[1].pose];
                let [dx, dy, turn] = [0, 1, 2].map(|axis| (to[axis] - from[axis]) / 0.02);
                let (sin, cos) = (0.5 * (from[2] + to[2])).sin_cos();
                for (axis, speed) in
                    [cos * dx + sin * dy, cos * dy - sin * dx, turn].iter().enumerate()
                {
                    fastest[axis] = fastest[axis].max(speed.abs());
                }
            }
            // A slow robot has no room for its full speed in every direction.
            let least = if acceleration > 10.0 { 0.5 } else { 0.29 };
            assert!(fastest[0] > least && fastest[1] > least && fastest[2] > least, "{fastest:?}");
            assert!(fastest[0] < 0.62 && fastest[1] < 0.62 && fastest[2] < 1.01, "{fastest:?}");
        }
    }
}
