//! Implausible measurements: not finite, or constant while the robot drives.
//!
//! | constant, bit for bit | evidence that it should change                                      |
//! |-----------------------|---------------------------------------------------------------------|
//! | position              | the measured velocity, which would have moved it by 0.1 m           |
//! | heading               | the measured yaw rate, which would have turned it by 0.1 rad        |
//! | everything            | the input, whose effect exceeds any error of the main model         |
//! | velocity              | a changed input, and a position 0.1 m off this velocity's path      |
//! | yaw rate              | a changed input, and a heading 0.1 rad off the one of this rate     |
//!
//! The evidence must last for at least 3 periods. A velocity may well be constant, so it must last
//! for as many more periods as a command may be under way. A robot at rest is never suspected,
//! however coarse its sensors are. The same holds for a robot that creeps at a speed that a biased
//! or noisy sensor may report at rest. A stuck sensor counts as stuck until it moves again: the
//! robot brakes, and then only the sensor itself can show that it works.

use model::delay::DELAY_MAX;
use model::main_model::MainModel;
use model::residual::residual;
use model::{AXES, State, Velocity, wrap};
use protocol::message::{PlantState, WHEELS_MAX};

/// Periods without a change before a sensor counts as stuck.
const PERIODS: u32 = 3;
/// The same for the commanded input: it may be under way for this long before it acts.
const COMMANDED_PERIODS: u32 = PERIODS + DELAY_MAX as u32;
/// At a lower measured speed the robot may be at rest \[m/s\].
const SPEED: f64 = 0.2;
/// At a lower measured yaw rate the robot may not turn \[rad/s\].
const RATE: f64 = 0.2;
/// Distance that the velocity must cover while the position is constant \[m\].
const TRAVEL: f64 = 0.1;
/// Angle that the yaw rate must cover while the heading is constant \[rad\].
const TURN: f64 = 0.1;

/// A fault of the measurements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorFault {
    /// Pose or velocity is not a number.
    NotFinite,
    /// The position is constant although the velocity is not zero.
    Position,
    /// The heading is constant although the yaw rate is not zero.
    Heading,
    /// Everything is constant although the robot is driven.
    Everything,
    /// The velocity is constant although the input changes, and the position leaves its path.
    Velocity,
    /// The yaw rate is constant although the input changes, and the heading leaves its path.
    YawRate,
}

impl SensorFault {
    /// Text for an operator, short enough for a [`Health`](protocol::message::Health).
    pub const fn text(self) -> &'static str {
        match self {
            Self::NotFinite => "the measured state is not a number: the robot brakes",
            Self::Position => {
                "the position has not changed for periods although the robot drives: a stuck \
                 sensor, the robot brakes"
            }
            Self::Heading => {
                "the heading has not changed for periods although the robot turns: a stuck \
                 sensor, the robot brakes"
            }
            Self::Everything => {
                "nothing measured has changed for periods although the robot is driven: stuck \
                 sensors, the robot brakes"
            }
            Self::Velocity => {
                "the velocity has not changed for periods, and the position contradicts it: a \
                 stuck sensor, the robot brakes"
            }
            Self::YawRate => {
                "the yaw rate has not changed for periods, and the heading contradicts it: a \
                 stuck sensor, the robot brakes"
            }
        }
    }
}

/// Measurements of one tick.
#[derive(Debug, Clone, Copy)]
struct Readings {
    tick: u64,
    pose: [f64; 3],
    velocity: Velocity,
    wheel_speed: [f64; WHEELS_MAX],
}

/// Inputs of the past period.
#[derive(Debug, Clone, Copy)]
pub struct Driven {
    /// The input that acted, as the driver reports \[m/s, m/s, rad/s\].
    pub acted: Velocity,
    /// The command, if the gate played it.
    pub commanded: Option<Velocity>,
}

/// A measurement that may be stuck: how long it has been constant although it should change, and
/// how far it should have moved.
#[derive(Debug, Clone, Copy, Default)]
struct Still {
    periods: u32,
    moved: [f64; 2],
    stuck: bool,
}

impl Still {
    /// Processes one more period. `by` is the distance that it should have moved, if there is no
    /// doubt.
    fn update(&mut self, changed: bool, by: Option<[f64; 2]>, enough: impl Fn(u32, f64) -> bool) {
        match by {
            _ if changed => *self = Self::default(),
            Some([x, y]) => {
                self.periods = self.periods.saturating_add(1);
                self.moved = [self.moved[0] + x, self.moved[1] + y];
                self.stuck |= enough(self.periods, self.moved[0].hypot(self.moved[1]));
            }
            None => *self = Self { stuck: self.stuck, ..Self::default() },
        }
    }
}

/// A velocity that may be stuck: the robot's distance from the path of this velocity since its last
/// change, and the range of inputs.
#[derive(Debug, Clone, Copy)]
struct Frozen {
    periods: u32,
    astray: [f64; 2],
    inputs: [(f64, f64); 2],
    stuck: bool,
}

impl Frozen {
    const NEVER: Self = Self {
        periods: 0,
        astray: [0.0; 2],
        inputs: [(f64::INFINITY, f64::NEG_INFINITY); 2],
        stuck: false,
    };

    /// Processes one more period, in which `input` acted, and which ended at the distance `from`
    /// off the velocity's path.
    fn update(&mut self, changed: bool, from: [f64; 2], input: [f64; 2], change: f64, far: f64) {
        if changed {
            *self = Self::NEVER;
            return;
        }
        self.periods = self.periods.saturating_add(1);
        for axis in 0..2 {
            self.astray[axis] += from[axis];
            let (least, most) = &mut self.inputs[axis];
            (*least, *most) = (least.min(input[axis]), most.max(input[axis]));
        }
        let driven = self.inputs.iter().any(|(least, most)| most - least > change);
        self.stuck |= driven
            && self.periods >= COMMANDED_PERIODS
            && self.astray[0].hypot(self.astray[1]) > far;
    }
}

/// Watches the measurements from period to period. Does not allocate.
#[derive(Debug)]
pub struct Watch {
    main: MainModel,
    /// Largest plausible |g|.
    bound: Velocity,
    last: Option<Readings>,
    finite: bool,
    position: Still,
    heading: Still,
    /// Judged by the acting input, and by the commanded input.
    everything: [Still; 2],
    velocity: Frozen,
    yaw_rate: Frozen,
}

impl Watch {
    /// A watch without measurements yet. A residual beyond `bound` is implausible.
    pub fn new(main: MainModel, bound: Velocity) -> Self {
        let (still, frozen) = (Still::default(), Frozen::NEVER);
        let everything = [still; 2];
        Self {
            main,
            bound,
            last: None,
            finite: true,
            position: still,
            heading: still,
            everything,
            velocity: frozen,
            yaw_rate: frozen,
        }
    }

    /// Resets: another robot, or the same one moved to another place.
    pub fn reset(&mut self) {
        *self = Self::new(self.main, self.bound);
    }

    /// The present fault.
    pub fn fault(&self) -> Option<SensorFault> {
        let stuck = self.everything.iter().any(|still| still.stuck);
        [
            (!self.finite, SensorFault::NotFinite),
            (stuck, SensorFault::Everything),
            (self.position.stuck, SensorFault::Position),
            (self.heading.stuck, SensorFault::Heading),
            (self.velocity.stuck, SensorFault::Velocity),
            (self.yaw_rate.stuck, SensorFault::YawRate),
        ]
        .into_iter()
        .find_map(|(is_so, fault)| is_so.then_some(fault))
    }

    /// Processes the measurements at the end of a period in which the robot was `driven`.
    pub fn look(&mut self, state: &PlantState, driven: &Driven) -> Option<SensorFault> {
        let now = Readings {
            tick: state.stamp.tick,
            pose: state.pose,
            velocity: state.velocity,
            wheel_speed: state.wheel_speed,
        };
        self.finite =
            State { pose: now.pose, velocity: now.velocity, acted: [0.0; AXES] }.is_finite();
        if self.finite {
            if let Some(last) = self.last.filter(|last| last.tick + 1 == now.tick) {
                self.compare(&last, &now, driven);
            }
            self.last = Some(now);
        }
        self.fault()
    }

    fn compare(&mut self, last: &Readings, now: &Readings, driven: &Driven) {
        let period = self.main.period;
        let [x, y, yaw] = last.pose;
        let [forward, left, rate] = now.velocity;
        let (sin, cos) = yaw.sin_cos();
        let moved = !same(&[x, y], &now.pose[..2]);
        let turned = !same(&[yaw], &now.pose[2..]);
        let travel = [period * (cos * forward - sin * left), period * (sin * forward + cos * left)];
        self.position.update(
            moved,
            (forward.hypot(left) > SPEED).then_some(travel),
            |periods, far| periods >= PERIODS && far > TRAVEL,
        );
        self.heading.update(
            turned,
            (rate.abs() > RATE).then_some([period * rate, 0.0]),
            |periods, far| periods >= PERIODS && far > TURN,
        );

        let frozen =
            |axes: std::ops::Range<usize>| same(&last.velocity[axes.clone()], &now.velocity[axes]);
        let [along, across, about] = driven.acted;
        // A constant pose is no evidence: the robot may be at rest.
        let astray = if moved {
            [now.pose[0] - x - travel[0], now.pose[1] - y - travel[1]]
        } else {
            [0.0; 2]
        };
        let turned_astray = if turned { wrap(now.pose[2] - yaw) - period * rate } else { 0.0 };
        self.velocity.update(!frozen(0..2), astray, [along, across], SPEED, TRAVEL);
        self.yaw_rate.update(!frozen(2..3), [turned_astray, 0.0], [about, about], RATE, TURN);

        let changed = moved
            || turned
            || !same(&last.velocity, &now.velocity)
            || !same(&last.wheel_speed, &now.wheel_speed);
        let (acted, commanded) = (Some(driven.acted), driven.commanded);
        for (index, (input, least)) in
            [(acted, PERIODS), (commanded, COMMANDED_PERIODS)].into_iter().enumerate()
        {
            let contradicts = input.is_some_and(|input| self.contradicts(last, now, &input));
            self.everything[index].update(
                changed,
                contradicts.then_some([0.0; 2]),
                |periods, _| periods >= least,
            );
        }
    }

    /// Whether this input cannot explain the velocity, however wrong the main model is.
    fn contradicts(&self, last: &Readings, now: &Readings, input: &Velocity) -> bool {
        let residual = residual(&self.main, &last.velocity, input, &now.velocity);
        residual.iter().zip(self.bound).any(|(value, bound)| value.abs() > bound)
    }
}

/// Whether two readings have the same bits.
fn same(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

#[cfg(test)]
mod tests;
