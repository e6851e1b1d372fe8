//! The response that is identified, and its simulation.
//!
//! Axis i follows the inputs u, delayed by its dead time, as a body of first order:
//!
//! ```text
//! v̇_i = (Σ_j K_ij u_j(t − d_i) − v_i + z_i − Σ_{j≠i} C_ij v_j − f_i − D |v_xy| v_i + b_i)/τ_i
//!        + s (ω v_y, −ω v_x, 0)_i
//! ż_i = ρ_i (K_ii u_i(t − d_i) − v_i)
//! f_i(v) = Σ_w J_wi (c_i + e_i exp(−((J v)_w/v_b)²)) tanh((J v)_w/v_s) / Σ_w |J_wi|
//! ```
//!
//! | symbol | parameter                                                                          |
//! |--------|------------------------------------------------------------------------------------|
//! | K      | steady velocity per input; K_ij and C_ij with i ≠ j couple the axes                |
//! | τ, d   | time constant and dead time                                                        |
//! | ρ      | integral part of the speed loops; 0 where they are proportional                    |
//! | c, v_s | dry friction as the velocity that it costs, and the speed at which it is full      |
//! | e, v_b | more friction near standstill (stiction), as such a velocity; v_b is 0.1 m/s       |
//! | D      | drag of the planar axes, in planar velocity lost per squared speed; 0 for yaw      |
//! | b      | constant offset: slope, or a sensor's bias; 0 on an axis with an integral part     |
//! | s      | share of the turning frame's acceleration (Coriolis); 0 where wheels hold the body |
//!
//! Friction acts at each wheel, so its direction follows from J. Where the wheels are not known,
//! each axis has its own friction. The acceleration of an axis may be limited, separately for
//! speeding up and slowing down.
//!
//! The drive of a wheel saturates where its rim is behind its command, with the integral part, by
//! more than l. Then u is replaced by v − z + J⁺ sat(J (u − v + z), l), which is u itself where no
//! wheel saturates. The integral part of a wheel that saturates does not grow.
//!
//! Friction, drag and turning frame as in eqs. 10–16 of Wu, Tang, Xu 2023, corrected as in
//! `plant-sim`; the dead time acts on the input, piecewise constant over the periods.

use crate::log::Sample;
use robot::{AXES, Velocity, Wheels};

/// Longest step of the integration \[s\].
const STEP_MAX_S: f64 = 0.01;
/// v_b: speed at the rim from which on stiction is gone, but for 1/e of it \[m/s\].
const STICTION_SPEED_MPS: f64 = 0.1;

/// All parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// K.
    pub gain: [Velocity; AXES],
    /// C; its diagonal is not used.
    pub cross: [Velocity; AXES],
    /// τ \[s\].
    pub time_constant_s: Velocity,
    /// d \[s\]. An estimate may be a little below 0.
    pub dead_time_s: Velocity,
    /// ρ \[1/s\].
    pub integral_per_s: Velocity,
    /// c \[m/s, m/s, rad/s\].
    pub friction: Velocity,
    /// e \[m/s, m/s, rad/s\].
    pub stiction: Velocity,
    /// v_s, at the rim \[m/s\].
    pub friction_speed_mps: f64,
    /// D \[s/m\].
    pub drag_s_per_m: f64,
    /// b \[m/s, m/s, rad/s\].
    pub offset: Velocity,
    /// s.
    pub turning: f64,
    /// Largest acceleration \[m/s², m/s², rad/s²\]; infinite if it was not reached.
    pub acceleration: Velocity,
    /// Largest deceleration.
    pub braking: Velocity,
    /// l \[m/s\]; infinite if no drive saturated, or if the wheels are not known.
    pub saturation_mps: f64,
}

impl Default for Response {
    fn default() -> Self {
        let mut gain = [[0.0; AXES]; AXES];
        (0..AXES).for_each(|axis| gain[axis][axis] = 1.0);
        Self {
            gain,
            cross: [[0.0; AXES]; AXES],
            time_constant_s: [0.2; AXES],
            dead_time_s: [0.0; AXES],
            integral_per_s: [0.0; AXES],
            friction: [0.0; AXES],
            stiction: [0.0; AXES],
            friction_speed_mps: 0.02,
            drag_s_per_m: 0.0,
            offset: [0.0; AXES],
            turning: 0.0,
            acceleration: [f64::INFINITY; AXES],
            braking: [f64::INFINITY; AXES],
            saturation_mps: f64::INFINITY,
        }
    }
}

impl Response {
    /// Whether an axis has an integral part.
    pub fn has_integral(&self) -> bool {
        self.integral_per_s.iter().any(|&integral| integral != 0.0)
    }

    /// Most dry friction at any speed of one axis, as the velocity that it costs
    /// \[m/s, m/s, rad/s\]: an axis at rest drives off once K u is larger.
    pub fn breakaway(&self) -> Velocity {
        let of = |rim: f64, axis: usize| {
            let slow = (-(rim / STICTION_SPEED_MPS).powi(2)).exp();
            (self.friction[axis] + self.stiction[axis] * slow)
                * (rim / self.friction_speed_mps).tanh()
        };
        let speeds = (0..1000).map(|step| f64::from(step) * 1e-3);
        std::array::from_fn(|axis| speeds.clone().map(|rim| of(rim, axis)).fold(0.0, f64::max))
    }

    /// The same without limits of the acceleration and stiction.
    #[must_use]
    pub fn plain(&self) -> Self {
        let unlimited = [f64::INFINITY; AXES];
        let stiction = [0.0; AXES];
        let saturation_mps = f64::INFINITY;
        Self { acceleration: unlimited, braking: unlimited, saturation_mps, stiction, ..*self }
    }
}

/// State of a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Velocity in the body \[m/s, m/s, rad/s\].
    pub velocity: Velocity,
    /// z \[m/s, m/s, rad/s\].
    pub integral: Velocity,
}

/// A step of a simulation: its length, and the share of the way to a constant target that each axis
/// covers in it, 1 − exp(−length/τ).
#[derive(Debug, Clone, Copy)]
struct Step {
    length_s: f64,
    share: Velocity,
}

impl Step {
    fn of(response: &Response, length_s: f64) -> Self {
        Self {
            length_s,
            share: response.time_constant_s.map(|constant| 1.0 - (-length_s / constant).exp()),
        }
    }

    /// Mean inputs of a step, of the integrals at its begin and at its end.
    fn inputs(&self, begin: &[Velocity; AXES], end: &[Velocity; AXES]) -> [Velocity; AXES] {
        let mean = |axis: usize, of: usize| (end[axis][of] - begin[axis][of]) / self.length_s;
        std::array::from_fn(|axis| std::array::from_fn(|of| mean(axis, of)))
    }
}

/// What saturated drives make of an input.
struct Driven {
    /// The input that unsaturated drives would follow as these follow theirs \[m/s, m/s, rad/s\].
    input: Velocity,
    /// K u − v, as the integral parts see it.
    behind: Velocity,
}

/// Simulates responses on one stretch of a log.
#[derive(Debug)]
pub struct Simulation<'a> {
    wheels: &'a Wheels,
    samples: &'a [Sample],
    period_s: f64,
    /// Integral of the input from the first sample to each \[m, m, rad\].
    integral: Vec<Velocity>,
    /// Σ_w |J_wi|.
    column_sums: Velocity,
}

impl<'a> Simulation<'a> {
    /// Of `samples`, one per period of `period_s` \[s\].
    pub fn new(wheels: &'a Wheels, samples: &'a [Sample], period_s: f64) -> Self {
        let mut sum = [0.0; AXES];
        let integral = samples
            .iter()
            .enumerate()
            .map(|(number, sample)| {
                if number > 0 {
                    (0..AXES).for_each(|axis| sum[axis] += sample.input[axis] * period_s);
                }
                sum
            })
            .collect();
        let column = |axis: usize| wheels.rows().iter().map(|row| row[axis].abs()).sum();
        let column_sums = if wheels.count() == 0 {
            [1.0, 1.0, wheels.lever_m()]
        } else {
            std::array::from_fn(column)
        };
        Self { wheels, samples, period_s, integral, column_sums }
    }

    /// Period of the samples \[s\].
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The samples.
    pub fn samples(&self) -> &'a [Sample] {
        self.samples
    }

    /// The whole stretch, beginning with the measured velocity: the motion one period after each
    /// sample but the last.
    pub fn whole(&self, response: &Response) -> Vec<Motion> {
        let velocity = self.samples.first().map_or([0.0; AXES], |sample| sample.velocity);
        self.run(response, Motion { velocity, ..Motion::default() }, 0, self.samples.len())
    }

    /// The motion from `begin` at sample `from` on, one item per period, for at most this number of
    /// `periods`.
    pub fn run(
        &self,
        response: &Response,
        begin: Motion,
        from: usize,
        periods: usize,
    ) -> Vec<Motion> {
        let parts = (self.period_s / STEP_MAX_S).ceil().max(1.0);
        let step_s = self.period_s / parts;
        let steps = [0.5 * step_s, step_s].map(|step_s| Step::of(response, step_s));
        let last = self.samples.len().saturating_sub(1);
        let begin_s = from as f64 * self.period_s;
        let mut motion = begin;
        let mut received = self.received(response, begin_s);
        (from..last.min(from + periods))
            .map(|number| {
                for part in 0..parts as usize {
                    let time = number as f64 * self.period_s + part as f64 * step_s;
                    let later = steps.map(|step| self.received(response, time + step.length_s));
                    motion = self.step(response, motion, &steps, &[received, later[0], later[1]]);
                    received = later[1];
                }
                motion
            })
            .collect()
    }

    /// One step by the midpoint rule: what couples the axes is taken from the motion half a step
    /// later. Each axis by itself is an exact exponential. `received` at the begin, in the middle
    /// and at the end.
    fn step(
        &self,
        response: &Response,
        motion: Motion,
        [half, whole]: &[Step; 2],
        received: &[[Velocity; AXES]; 3],
    ) -> Motion {
        let [begin, middle, end] = received;
        let to_middle = half.inputs(begin, middle);
        let at_middle = self.after(response, motion, motion, half, &to_middle);
        self.after(response, motion, at_middle, whole, &whole.inputs(begin, end))
    }

    /// The motion a `step` after `motion`, with what couples the axes taken at `middle`, and with
    /// the inputs that reach each axis.
    fn after(
        &self,
        response: &Response,
        motion: Motion,
        middle: Motion,
        step: &Step,
        inputs: &[Velocity; AXES],
    ) -> Motion {
        let at = middle.velocity;
        let (friction, stiffness) = self.friction(response, &at);
        let [ahead, side, turn] = at;
        let frame = [turn * side, -turn * ahead, 0.0];
        let drag = response.drag_s_per_m * ahead.hypot(side);
        let drag = [drag * ahead, drag * side, 0.0];
        let mut next = motion;
        for axis in 0..AXES {
            let Driven { input, behind } =
                self.driven(response, &inputs[axis], &at, &middle.integral);
            // As an input that would accelerate the axis as much.
            let turning = response.turning * response.time_constant_s[axis] * frame[axis];
            let mut target = response.offset[axis] - friction[axis] - drag[axis]
                + middle.integral[axis]
                + turning;
            for other in 0..AXES {
                target += response.gain[axis][other] * input[other];
                if other != axis {
                    target -= response.cross[axis][other] * at[other];
                }
            }
            let before = motion.velocity[axis];
            // The friction may be far stiffer than the axis: it is linearised, and its mean over
            // the step is that at its middle.
            let share = step.share[axis];
            let ahead = stiffness[axis] * (at[axis] - before);
            let change = share * (target - before + ahead) / (1.0 + 0.5 * share * stiffness[axis]);
            let speeds_up = change * before >= 0.0;
            let limit = if speeds_up { &response.acceleration } else { &response.braking };
            let most = limit[axis] * step.length_s;
            next.velocity[axis] = before + change.clamp(-most, most);
            next.integral[axis] += response.integral_per_s[axis] * step.length_s * behind[axis];
        }
        next
    }

    /// What drives that follow `asked` at the velocity `at` do, with the integral part `held`.
    fn driven(
        &self,
        response: &Response,
        asked: &Velocity,
        at: &Velocity,
        held: &Velocity,
    ) -> Driven {
        let error = std::array::from_fn(|axis| response.gain[axis][axis] * asked[axis] - at[axis]);
        if response.saturation_mps.is_infinite() {
            return Driven { input: *asked, behind: error };
        }
        let demand = std::array::from_fn(|axis| asked[axis] - at[axis] + held[axis]);
        let (mut demands, mut errors) = (self.wheels.speeds(demand), self.wheels.speeds(error));
        for ((demand, error), radius) in
            demands.iter_mut().zip(&mut errors).zip(self.wheels.radii_m())
        {
            let most = response.saturation_mps / radius;
            if demand.abs() > most && *demand * *error > 0.0 {
                *error = 0.0;
            }
            *demand = demand.clamp(-most, most);
        }
        let driven = self.wheels.body(&demands);
        Driven {
            input: std::array::from_fn(|axis| at[axis] - held[axis] + driven[axis]),
            behind: self.wheels.body(&errors),
        }
    }

    /// How far a rim is behind its command at most, with the integral part \[m/s\].
    pub fn most_behind_mps(&self, response: &Response) -> f64 {
        let period = Step::of(response, self.period_s);
        let mut most: f64 = 0.0;
        for (number, motion) in self.whole(response).iter().enumerate() {
            let [from, to] = [number + 1, number + 2]
                .map(|number| self.received(response, number as f64 * self.period_s));
            let asked = period.inputs(&from, &to);
            let behind: Velocity = std::array::from_fn(|axis| {
                asked[axis][axis] - motion.velocity[axis] + motion.integral[axis]
            });
            let speeds = self.wheels.speeds(behind);
            for (speed, radius) in speeds.iter().zip(self.wheels.radii_m()) {
                most = most.max(speed.abs() * radius);
            }
        }
        most
    }

    /// f(v), and its derivative by the velocity of each axis.
    fn friction(&self, response: &Response, velocity: &Velocity) -> (Velocity, Velocity) {
        let scale = response.friction_speed_mps;
        let (mut sums, mut slopes) = ([0.0; AXES], [0.0; AXES]);
        let sticks = response.stiction != [0.0; AXES];
        let mut roll = |row: &Velocity| {
            let rim = row[0] * velocity[0] + row[1] * velocity[1] + row[2] * velocity[2];
            let share = (rim / scale).tanh();
            let slow = if sticks { (-(rim / STICTION_SPEED_MPS).powi(2)).exp() } else { 0.0 };
            for axis in 0..AXES {
                let most = response.friction[axis] + response.stiction[axis] * slow;
                sums[axis] += row[axis] * most * share;
                // Where stiction ends, friction falls with the speed: that is not stiff.
                slopes[axis] += row[axis] * row[axis] * most * (1.0 - share * share) / scale;
            }
        };
        if self.wheels.count() == 0 {
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, self.column_sums[2]]]
                .iter()
                .for_each(roll);
        } else {
            self.wheels.rows().iter().for_each(&mut roll);
        }
        (
            std::array::from_fn(|axis| sums[axis] / self.column_sums[axis]),
            std::array::from_fn(|axis| slopes[axis] / self.column_sums[axis]),
        )
    }

    /// Integral of the inputs that have reached each axis at `time` \[s\] since the first sample.
    fn received(&self, response: &Response, time: f64) -> [Velocity; AXES] {
        response.dead_time_s.map(|dead_time_s| self.integral_at(time - dead_time_s))
    }

    /// Integral of the input from the first sample to `time` \[m, m, rad\]. Before the first sample
    /// and after the last one the input is that of the nearest period.
    fn integral_at(&self, time: f64) -> Velocity {
        let place = time / self.period_s;
        let last = self.samples.len().saturating_sub(2);
        let period = (place.floor().max(0.0) as usize).min(last);
        let share = place - period as f64;
        let (Some(from), Some(to)) = (self.integral.get(period), self.integral.get(period + 1))
        else {
            return [0.0; AXES];
        };
        std::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis]))
    }
}

#[cfg(test)]
mod tests;
