//! The grip of the floor, from wheels that slide and from the currents of their motors.
//!
//! The force of a wheel that slides is that of the floor, and its motor's current shows it. So the
//! floor bounds what the motors can do, as i_max does: |i| ≤ g i_max, with
//!
//! ```text
//! slides: |r ω − J v| > max(0.12 m/s, 0.1 |J v|), |i| < 0.95 i_max, for 0.06 s
//! rolls:  |r ω − J v| < half of it
//! g ← g + (T/0.1 s) (s − g)   s: largest |i|/i_max of the wheels that slide
//! g ← g + (s − g)/2           s: largest |i|/i_max of those that roll, if it exceeds 1.1 g
//! ```
//! Three wheels that do not slide determine the motion of a body. Then the floor holds it, even if
//! another wheel slides because it is worn or in the air. So g falls only while there are fewer
//! than three of them, and no rolling one carries a current that comes near that of the sliding
//! ones. In such a period the body slides. The force is then that of the floor, whatever the input
//! is, so it is no sample for the learner.

use model::Velocity;
use robot::{PerWheel, Robot, WHEELS_MAX, Wheels};

/// From this difference between the rim of a wheel and the floor on, a wheel slides \[m/s\].
const SLIDES_MPS: f64 = 0.12;
/// The same as a share of the speed of the floor. A wrong radius of the wheels makes such a
/// difference too, of up to 0.05.
const SLIDES_SHARE: f64 = 0.1;
/// Time for which a wheel must slide until it counts \[s\]. The play of a gear opens and closes
/// sooner.
const LASTS_S: f64 = 0.06;
/// Below this share of that difference, a wheel rolls.
const ROLLS: f64 = 0.5;
/// From this share of its limit on, a motor is at it, whatever the floor does.
const AT_LIMIT: f64 = 0.95;
/// Number of wheels that determine the motion of a body.
const DETERMINE: usize = 3;
/// From this share of the current of sliding wheels on, that of a rolling wheel comes near it.
const NEAR: f64 = 0.8;
/// From this multiple of g on, a rolling wheel contradicts it. Plans keep to the same multiple.
const MARGIN: f64 = 1.1;
/// Time constant with which g falls \[s\].
const FALLS_S: f64 = 0.1;
/// Share of the difference by which g changes in a period, at most.
const CHANGE_MAX: f64 = 0.5;
/// Smallest g.
const LEAST: f64 = 0.15;

/// Identifies g. Does not allocate.
#[derive(Debug, Clone)]
pub struct Grip {
    wheels: Wheels,
    limit_a: Option<f64>,
    falls: f64,
    /// Number of periods for which a wheel must slide, and for which each one has.
    lasts: u32,
    slid: [u32; WHEELS_MAX],
    /// Whether too few wheels hold the body.
    slides: bool,
    share: f64,
}

impl Grip {
    /// A floor of which nothing is known yet, under `robot`, for periods of `period` \[s\].
    pub fn new(robot: &Robot, period: f64) -> Self {
        Self {
            wheels: robot.wheels,
            limit_a: robot.current_limit_a(),
            falls: (period / FALLS_S).min(CHANGE_MAX),
            lasts: (LASTS_S / period).ceil() as u32,
            slid: [0; WHEELS_MAX],
            slides: false,
            share: 1.0,
        }
    }

    /// Forgets the floor.
    pub fn reset(&mut self) {
        (self.slid, self.slides, self.share) = ([0; WHEELS_MAX], false, 1.0);
    }

    /// g; 1 if the motors are weaker than the floor.
    pub fn held(&self) -> f64 {
        self.share
    }

    /// Whether the body slides: its motion then says little of its inputs.
    pub fn slides(&self) -> bool {
        self.slides
    }

    /// What plans keep to.
    pub fn bound(&self) -> f64 {
        (MARGIN * self.share).min(1.0)
    }

    /// Processes the measurements of one moment: speeds of all wheels \[rad/s\], currents of their
    /// motors \[A\], and the velocity of the body \[m/s, m/s, rad/s\]. Ignores numbers that are not
    /// finite.
    pub fn look(&mut self, wheel_speed: &PerWheel, current: &[f64], body: &Velocity) {
        self.slides = false;
        let Some(limit_a) = self.limit_a.filter(|_| current.len() >= self.wheels.count()) else {
            return;
        };
        let floor = self.wheels.speeds(*body);
        let (mut rolling, mut sliding) = (Currents::default(), Currents::default());
        for (wheel, radius) in self.wheels.radii_m().iter().enumerate() {
            let slip = radius * (wheel_speed[wheel] - floor[wheel]).abs();
            let slides = SLIDES_MPS.max(SLIDES_SHARE * radius * floor[wheel].abs());
            let share = current[wheel].abs() / limit_a;
            if !(slip + share).is_finite() {
                return;
            }
            if slip <= slides || share >= AT_LIMIT {
                self.slid[wheel] = 0;
                if slip < ROLLS * slides {
                    rolling.add(share);
                }
                continue;
            }
            self.slid[wheel] = self.slid[wheel].saturating_add(1);
            if self.slid[wheel] >= self.lasts {
                sliding.add(share);
            }
        }
        self.slides = self.wheels.count() - sliding.wheels < DETERMINE;
        if rolling.largest > MARGIN * self.share {
            self.share += CHANGE_MAX * (rolling.largest.min(1.0) - self.share);
        } else if self.slides && rolling.largest < NEAR * sliding.mean() {
            self.share += self.falls * (sliding.largest.max(LEAST) - self.share);
        }
    }
}

/// Currents of some wheels, as shares of their limit.
#[derive(Debug, Clone, Copy, Default)]
struct Currents {
    wheels: usize,
    sum: f64,
    largest: f64,
}

impl Currents {
    fn add(&mut self, share: f64) {
        self.wheels += 1;
        self.sum += share;
        self.largest = self.largest.max(share);
    }

    fn mean(&self) -> f64 {
        self.sum / self.wheels.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Velocity of the body \[m/s, m/s, rad/s\].
    const BODY: Velocity = [1.5, -0.3, 0.4];

    /// Looks at the same for this number of seconds: the slip of each wheel \[m/s\], and the
    /// current of its motor as a share of the limit.
    fn looked(mut grip: Grip, seconds: f64, slips: [f64; 4], shares: [f64; 4]) -> Grip {
        let robot = Robot::example();
        let mut speeds = robot.wheels.speeds(BODY);
        for (wheel, radius) in robot.wheels.radii_m().iter().enumerate() {
            speeds[wheel] += slips[wheel] / radius;
        }
        let limit = robot.current_limit_a().unwrap_or_default();
        for _ in 0..(seconds / 0.02) as usize {
            grip.look(&speeds, &shares.map(|share| share * limit), &BODY);
        }
        grip
    }

    fn unknown() -> Grip {
        Grip::new(&Robot::example(), 0.02)
    }

    #[test]
    fn a_floor_on_which_wheels_slide_bounds_the_currents_by_theirs() {
        let grip = looked(unknown(), 0.5, [0.5, -0.6, 0.0, 0.02], [0.4, -0.38, 0.1, 0.0]);
        assert!((grip.held() - 0.4).abs() < 0.01, "{grip:?}");
        assert!((grip.bound() - 0.44).abs() < 0.01, "{grip:?}");
        assert!(grip.slides() && !looked(grip, 0.02, [0.0; 4], [0.1; 4]).slides());
    }

    #[test]
    fn nothing_is_known_of_a_floor_that_holds_the_body() {
        let all = [0.5; 4];
        for (slips, shares) in [
            ([0.0; 4], [0.3; 4]),                          // no wheel slides
            ([0.05, -0.05, 0.05, 0.05], [0.3; 4]),         // the radius is wrong by a little
            ([0.9, 0.0, 0.0, 0.0], [0.1, 0.5, 0.5, 0.5]),  // one wheel is in the air
            ([0.9, 0.9, 0.0, 0.0], [0.4, 0.4, 0.35, 0.1]), // a wheel with as much current rolls
            (all, [1.0; 4]),                               // the motors are at their limit
            (all, [0.3, 0.3, f64::NAN, 0.3]),
            ([0.5, f64::INFINITY, 0.5, 0.5], [0.3; 4]),
        ] {
            let grip = looked(unknown(), 5.0, slips, shares);
            assert_eq!(grip.bound(), 1.0, "{slips:?} {shares:?}");
            // Its wheels slide, but the floor may hold more.
            let slides = shares == [0.4, 0.4, 0.35, 0.1];
            assert_eq!(grip.slides(), slides, "{slips:?} {shares:?}");
        }
    }

    #[test]
    fn the_play_of_a_gear_that_closes_says_nothing() {
        let mut grip = unknown();
        for _ in 0..100 {
            grip = looked(grip, 0.04, [0.5; 4], [0.05; 4]);
            grip = looked(grip, 0.02, [0.0; 4], [0.3; 4]);
        }
        assert_eq!(grip.bound(), 1.0);
    }

    #[test]
    fn nothing_is_known_without_currents_or_without_their_limit() {
        let mut grip = unknown();
        let speeds = Robot::example().wheels.speeds([3.0, 0.0, 0.0]);
        grip.look(&speeds, &[], &[0.0; 3]);
        let robot = Robot { drive: None, ..Robot::example() };
        let mut without = Grip::new(&robot, 0.02);
        without.look(&speeds, &[0.1; WHEELS_MAX], &[0.0; 3]);
        assert_eq!([grip.bound(), without.bound()], [1.0; 2]);
    }

    #[test]
    fn a_wheel_that_rolls_with_more_current_shows_that_the_floor_holds_more() {
        let slippery = looked(unknown(), 1.0, [0.5; 4], [0.3; 4]);
        let better = looked(slippery.clone(), 0.2, [0.0; 4], [0.1, 0.6, 0.1, 0.1]);
        assert!((better.held() - 0.6).abs() < 0.05, "{better:?}");
        // Less current says nothing: the floor is not needed.
        let idle = looked(slippery.clone(), 5.0, [0.0; 4], [0.1; 4]);
        assert_eq!(idle.held(), slippery.held());
    }

    #[test]
    fn the_bound_has_a_least_value_and_is_gone_after_a_reset() {
        let mut grip = looked(unknown(), 5.0, [0.5; 4], [0.01; 4]);
        assert!((grip.held() - LEAST).abs() < 1e-6, "{grip:?}");
        grip.reset();
        assert_eq!(grip.bound(), 1.0);
    }
}
