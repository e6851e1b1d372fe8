//! Protective stop: the largest share of a twist with which the footprint still stops in time.
//!
//! | here           | in the equations | meaning                                            |
//! |----------------|------------------|----------------------------------------------------|
//! | `share`        | s                | factor of the whole twist, 0 to 1                  |
//! | `velocity_mps` | v                | planar part of the full twist, in the world        |
//! | `yaw_radps`    | ω                | its yaw rate                                       |
//! | `stop_m`       | q                | way of its braking ramp, in the world              |
//! | `arms_m`       | r                | from the origin of the body to a corner            |
//! | `left_over`    | v₀, ω₀           | motion that the robot may still have               |
//! | `distance_m`   | d                | of a straight border that parts robot and obstacle |
//! | `normal`       | n                | of this border                                     |
//! | `approach_mps` | w                | own speed of the obstacle along −n, at least 0     |
//! | `response_s`   | τ                | response time of the robot                         |
//! | `period_s`     | T                | control period                                     |
//!
//! Two convex shapes that do not touch lie on two sides of a straight border. As long as no corner
//! of the footprint has moved by more than d along n, they do not touch. So it is sufficient that
//! the motion from now to standstill is shorter than d along n. It has these parts:
//!
//! ```text
//! until the next state       s v T         turned by    s ω T
//! braking ramp, per axis     s² q          turned by    s² ω²/2α      q = (vₓ|vₓ|, v_y|v_y|)/2a
//! rest of an earlier motion  τ v₀          turned by    τ ω₀
//! ```
//! The last line is exact for a robot that follows its input with one lag θ ≤ τ: the way still to
//! go is the way of the inputs, plus θ times the present velocity. At a constant twist v₀ is s v.
//! So the rest is bounded by the larger of both.
//!
//! The sum φ of the turns bounds how far any of these vectors turns on the way. A vector x, turned
//! by at most φ, moves by at most
//!
//! ```text
//! ⟨x⟩ = ‖x‖ cos(max(0, ∠(x, n) − φ))
//! ```
//! along n. A corner moves by ⟨v⟩ and by ⟨ω × r⟩ of the farthest corner: k = ⟨v⟩ + maxᵣ ⟨ω × r⟩.
//! The ramp bends the way where one axis stands before the other. Before it turns back from n it
//! has moved by at most ⟨v⟩ t₁/2 along n, where t₁ is the time of the shorter ramp. So the ramp
//! moves a corner by b = max(0, ⟨q⟩, ⟨v⟩ t₁/2) + max(0, ω²/2α maxᵣ ⟨ω/‖ω‖ × r⟩).
//! With t for the length of the ramp, k₀ for v₀, ω₀, and k⁺ = max(0, k), the conditions are
//!
//! ```text
//! s k⁺ (T + τ)     + s² b + w (T + τ + s t) ≤ d         the next states can still slow the robot
//! s k⁺ T/10 + τ k₀ + s² b + w (T/10 + τ + s t) ≤ d      a stop from now on is in time
//! ```
//! The first one keeps the approach smooth. The second one holds after a change of the direction.
//! A twist leads away if k ≤ 0 and s k T/10 + s² ⟨q⟩ ≤ 0, with the ramp of the turn in ⟨q⟩. It
//! only waits for the rest of an earlier motion, τ k₀ ≤ max(d, 0.01 m): n may be another one where
//! that motion ends.
//!
//! At the border of a zone the planar speed is at most its limit u. The path to the border is at
//! least d ‖v‖/k, and the ramp slows the robot by at least a:
//!
//! ```text
//! (s ‖v‖)² + 2 a (s ‖v‖ T + max(s ‖v‖, ‖v₀‖) τ) ≤ u² + 2 a d ‖v‖/k
//! ```
//! Constant memory; no clock. One check costs O(corners).

use robot::{CORNERS_MAX, Point, Robot, Shape, Velocity};
use std::f64::consts::PI;

/// Part of a period until the next decision of a gate, at most.
const DECISION_PERIODS: f64 = 0.1;
/// Rest of an earlier motion towards a border that does not keep a robot from leaving it \[m\].
const AT_REST_M: f64 = 0.01;
/// Halvings of the interval of the share: it is exact to 1e-6.
const HALVINGS: usize = 20;

/// How one robot stops. Constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Braking {
    /// a: deceleration of the ramp, per planar axis \[m/s²\].
    pub brake_mps2: f64,
    /// α: deceleration of its yaw rate \[rad/s²\].
    pub yaw_brake_radps2: f64,
    /// τ: dead time and lag of the robot \[s\].
    pub response_s: f64,
    /// T: control period \[s\].
    pub period_s: f64,
}

impl Braking {
    /// That of `robot`.
    pub fn new(robot: &Robot, period_nanos: u64) -> Self {
        Self {
            brake_mps2: robot.limits.brake_mps2,
            yaw_brake_radps2: robot.limits.yaw_brake_radps2,
            response_s: robot.response_time_s(),
            period_s: period_nanos as f64 * 1e-9,
        }
    }
}

/// A straight border between the footprint and something else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Border {
    /// From the footprint to the border; negative beyond it \[m\].
    pub distance_m: f64,
    /// Unit vector from the footprint to the border, in the world.
    pub normal: Point,
    /// Speed with which the border comes towards the footprint, at least 0 \[m/s\].
    pub approach_mps: f64,
}

/// A planar velocity in the world and a yaw rate \[m/s, rad/s\].
type Motion = (Point, f64);

/// The way to standstill of one twist at one pose.
#[derive(Debug, Clone, Copy)]
pub struct Stopping<'a> {
    braking: &'a Braking,
    arms_m: [Point; CORNERS_MAX],
    corners: usize,
    /// Longest arm \[m\].
    radius_m: f64,
    velocity_mps: Point,
    speed_mps: f64,
    yaw_radps: f64,
    stop_m: Point,
    ramp_s: f64,
    /// Time of the ramp of the planar axis that stands first \[s\].
    short_ramp_s: f64,
    left_over: [Motion; 2],
}

impl<'a> Stopping<'a> {
    /// For a `footprint` in the body frame at `pose`, and the full `twist`. `left_over` are body
    /// velocities that the robot may still have: the measured one, and the last input.
    pub fn new(
        braking: &'a Braking,
        footprint: &Shape,
        pose: &[f64; 3],
        twist: &Velocity,
        left_over: &[Velocity; 2],
    ) -> Self {
        let (sin, cos) = pose[2].sin_cos();
        let turned = |[x, y]: Point| [cos * x - sin * y, sin * x + cos * y];
        let mut arms_m = [[0.0; 2]; CORNERS_MAX];
        for (arm, corner) in arms_m.iter_mut().zip(footprint.corners()) {
            *arm = turned(*corner);
        }
        let [ahead, left, yaw_radps] = *twist;
        let way = |speed: f64| 0.5 * speed * speed.abs() / braking.brake_mps2;
        Self {
            braking,
            arms_m,
            corners: footprint.corners().len(),
            radius_m: arms_m.iter().map(|arm| length(*arm)).fold(0.0, f64::max),
            velocity_mps: turned([ahead, left]),
            speed_mps: ahead.hypot(left),
            yaw_radps,
            stop_m: turned([way(ahead), way(left)]),
            ramp_s: (ahead.abs().max(left.abs()) / braking.brake_mps2)
                .max(yaw_radps.abs() / braking.yaw_brake_radps2),
            short_ramp_s: ahead.abs().min(left.abs()) / braking.brake_mps2,
            left_over: left_over.map(|[ahead, left, yaw]| (turned([ahead, left]), yaw)),
        }
    }

    /// Distance beyond which nothing bounds the twist, if it comes with at most `approach_mps`
    /// \[m\].
    pub fn reach_m(&self, approach_mps: f64) -> f64 {
        let Braking { brake_mps2, response_s, period_s, .. } = *self.braking;
        let wait = response_s + period_s;
        let top = self.speed_mps + self.radius_m * self.yaw_radps.abs();
        let rest = self
            .left_over
            .iter()
            .map(|(velocity, yaw)| length(*velocity) + self.radius_m * yaw.abs())
            .fold(0.0, f64::max);
        let crest = 0.5 * self.short_ramp_s * self.speed_mps;
        let ramp = length(self.stop_m).max(crest) + self.radius_m * self.ramp_rad();
        let zone = top * 0.5 * self.speed_mps / brake_mps2;
        top * wait + rest * response_s + ramp.max(zone) + approach_mps * (wait + self.ramp_s)
    }

    /// The largest share, up to `most`, that fulfils `condition`; 0 if none does.
    pub fn largest_share(most: f64, condition: impl Fn(f64) -> bool) -> f64 {
        if condition(most) {
            return most;
        }
        let (mut least, mut most) = (0.0, most);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (least + most);
            if condition(middle) {
                least = middle;
            } else {
                most = middle;
            }
        }
        least
    }

    /// Whether the robot with this `share` of its twist stops before `border`, or moves away.
    pub fn stops_before(&self, border: &Border, share: f64) -> bool {
        let Braking { response_s, period_s, .. } = *self.braking;
        let turn = self.turn(share);
        let [arm, back] = [1.0, -1.0].map(|sign| self.arm(sign, border.normal, &turn));
        let swept = |yaw: f64| yaw.abs() * if yaw < 0.0 { back } else { arm };
        let closing = |(velocity, yaw): Motion| turn.most(velocity, border.normal) + swept(yaw);
        let speed = share * closing((self.velocity_mps, self.yaw_radps));
        let ramp_yaw = self.ramp_rad().copysign(self.yaw_radps);
        let straight = turn.most(self.stop_m, border.normal);
        let crest = 0.5 * self.short_ramp_s * turn.most(self.velocity_mps, border.normal);
        let squared = share * share;
        let soon = DECISION_PERIODS * period_s;
        let rest = self.left_over.iter().map(|motion| closing(*motion)).fold(0.0, f64::max);
        if speed <= 0.0 && speed * soon + squared * (straight + swept(ramp_yaw)) <= 0.0 {
            return rest * response_s <= border.distance_m.max(AT_REST_M);
        }
        let ramp = squared * (straight.max(crest).max(0.0) + swept(ramp_yaw).max(0.0));
        let speed = speed.max(0.0);
        let needs = |wait: f64, way: f64| {
            way + ramp + border.approach_mps * (wait + response_s + share * self.ramp_s)
        };
        needs(period_s, speed * (period_s + response_s)) <= border.distance_m
            && needs(soon, speed * soon + rest * response_s) <= border.distance_m
    }

    /// Whether the robot with this `share` of its twist drives with at most `limit_mps` from
    /// `border` on.
    pub fn slows_before(&self, border: &Border, limit_mps: f64, share: f64) -> bool {
        let Braking { brake_mps2, response_s, period_s, .. } = *self.braking;
        let speed = share * self.speed_mps;
        if speed <= limit_mps {
            return true;
        }
        let turn = self.turn(share);
        let sign = self.yaw_radps.signum();
        let closing = turn.most(self.velocity_mps, border.normal)
            + self.yaw_radps.abs() * self.arm(sign, border.normal, &turn);
        if border.distance_m <= 0.0 || closing <= 0.0 {
            return border.distance_m > 0.0;
        }
        let path = border.distance_m * self.speed_mps / closing;
        let rest = self.left_over.iter().map(|(velocity, _)| length(*velocity));
        let wait = speed * period_s + rest.fold(speed, f64::max) * response_s;
        speed * speed + 2.0 * brake_mps2 * wait <= limit_mps * limit_mps + 2.0 * brake_mps2 * path
    }

    /// Whether the planar speed of this `share` of the twist is at most `limit_mps`.
    pub fn keeps(&self, limit_mps: f64, share: f64) -> bool {
        share * self.speed_mps <= limit_mps
    }

    /// Angle of the ramp from the full yaw rate, ω²/2α \[rad\].
    fn ramp_rad(&self) -> f64 {
        0.5 * self.yaw_radps * self.yaw_radps / self.braking.yaw_brake_radps2
    }

    /// φ: the angle that the body can still turn.
    fn turn(&self, share: f64) -> Turn {
        let yaw = share * self.yaw_radps.abs();
        let rest = self.left_over.iter().map(|(_, yaw)| yaw.abs()).fold(yaw, f64::max);
        let Braking { response_s, period_s, .. } = *self.braking;
        let angle = yaw * period_s + rest * response_s + share * share * self.ramp_rad();
        let (sin, cos) = angle.sin_cos();
        Turn { whole: angle >= PI, sin, cos }
    }

    /// maxᵣ ⟨ω × r⟩ at a yaw rate of `sign` \[m\].
    fn arm(&self, sign: f64, normal: Point, turn: &Turn) -> f64 {
        self.arms_m[..self.corners]
            .iter()
            .map(|[x, y]| turn.most([-sign * y, sign * x], normal))
            .fold(f64::NEG_INFINITY, f64::max)
    }
}

/// A turn by at most an angle, to either side.
#[derive(Debug, Clone, Copy)]
struct Turn {
    /// The angle is π or more.
    whole: bool,
    sin: f64,
    cos: f64,
}

impl Turn {
    /// ⟨x⟩: largest part of `vector` along `normal` while it turns.
    fn most(&self, vector: Point, normal: Point) -> f64 {
        let along = vector[0] * normal[0] + vector[1] * normal[1];
        let across = (vector[0] * normal[1] - vector[1] * normal[0]).abs();
        let long = along.hypot(across);
        if self.whole || along >= self.cos * long {
            return long;
        }
        along * self.cos + across * self.sin
    }
}

fn length(a: Point) -> f64 {
    a[0].hypot(a[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    const BRAKING: Braking =
        Braking { brake_mps2: 2.0, yaw_brake_radps2: 4.0, response_s: 0.3, period_s: 0.1 };

    fn ahead(distance_m: f64) -> Border {
        Border { distance_m, normal: [1.0, 0.0], approach_mps: 0.0 }
    }

    fn share(twist: Velocity, border: &Border) -> f64 {
        let footprint = Shape::rectangle(0.6, 0.4);
        let stopping = Stopping::new(&BRAKING, &footprint, &[0.0; 3], &twist, &[[0.0; 3]; 2]);
        Stopping::largest_share(1.0, |share| stopping.stops_before(border, share))
    }

    #[test]
    fn straight_on_the_share_is_that_of_response_and_ramp() {
        // 1 m/s needs 0.4 s and 0.25 m.
        assert_eq!(share([1.0, 0.0, 0.0], &ahead(0.651)), 1.0);
        let half = share([1.0, 0.0, 0.0], &ahead(0.5 * 0.4 + 0.25 * 0.25));
        assert!((half - 0.5).abs() < 1e-5, "{half}");
        assert_eq!(share([1.0, 0.0, 0.0], &ahead(0.0)), 0.0);
        assert_eq!(share([1.0, 0.0, 0.0], &ahead(-0.1)), 0.0);
    }

    #[test]
    fn a_twist_that_leads_away_has_no_bound() {
        for distance in [0.5, 0.0, -0.1] {
            assert_eq!(share([-1.0, 0.0, 0.0], &ahead(distance)), 1.0);
            assert_eq!(share([0.0, 1.0, 0.0], &ahead(distance)), 1.0);
        }
    }

    #[test]
    fn a_corner_that_turns_towards_the_border_slows_the_turn() {
        let turning = share([0.0, 0.0, 2.0], &ahead(0.02));
        assert!(turning > 0.0 && turning < 0.2, "{turning}");
    }

    #[test]
    fn an_obstacle_that_comes_closer_needs_more_distance() {
        let coming = Border { approach_mps: 0.5, ..ahead(0.651) };
        let share = share([1.0, 0.0, 0.0], &coming);
        assert!(share > 0.3 && share < 0.8, "{share}");
    }

    #[test]
    fn nothing_beyond_the_reach_bounds_the_twist() {
        let footprint = Shape::rectangle(0.6, 0.4);
        let earlier = [[0.5, 0.5, 1.0], [0.0, 0.0, -2.0]];
        for twist in [[1.0, 0.5, 3.0], [0.0, 0.0, 6.0], [2.0, 0.0, 0.0]] {
            let stopping = Stopping::new(&BRAKING, &footprint, &[0.0, 0.0, 0.4], &twist, &earlier);
            let border = Border { approach_mps: 0.3, ..ahead(stopping.reach_m(0.3)) };
            assert!(stopping.stops_before(&border, 1.0), "{twist:?}");
            assert!(stopping.slows_before(&border, 0.0, 1.0), "{twist:?}");
        }
    }

    #[test]
    fn the_speed_at_the_border_of_a_zone_is_its_limit() {
        let footprint = Shape::rectangle(0.6, 0.4);
        let stopping =
            Stopping::new(&BRAKING, &footprint, &[0.0; 3], &[1.0, 0.0, 0.0], &[[0.0; 3]; 2]);
        let share = |distance| {
            Stopping::largest_share(1.0, |share| {
                stopping.slows_before(&ahead(distance), 0.5, share)
            })
        };
        // From 1 m/s to 0.5 m/s: 0.4 s and 0.1875 m.
        assert_eq!(share(0.588), 1.0);
        assert!(share(0.58) < 1.0);
        assert!((share(0.0) - 0.5).abs() < 1e-5);
        assert!((share(-0.1) - 0.5).abs() < 1e-5);
    }
}
