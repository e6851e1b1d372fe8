//! The limits: the wheels' own, all linear in (v, u), and soft bounds on the predicted state.
//!
//! Wheel rows stand for the periods whose input is free. Later inputs keep their distance from the target, and are clamped to what the
//! wheels can do when they are predicted.
//!
//! Every row is scaled so that its bound is 1, which keeps the program well scaled and lets one slack per period serve all its
//! soft rows: a slack of 0.1 allows each of them to be exceeded by a tenth. Only the corridor has a slack of its own: a robot that is far
//! outside must not be free to exceed the other limits as well.
//!
//! Under caution the bounds on the state are drawn in, at most to where the two sides meet.

use super::Outlook;
use super::condense::{Block, Condensed};
use super::qp::QuadraticProgram;
use crate::settings::StateLimits;
use model::Velocity;
use model::robot::{Robot, kinematics};
use nalgebra::SVector;

/// Price of a slack of 1, linear: greater than any multiplier of a soft row, so that slacks stay zero where they can.
const SLACK_PRICE: f64 = 1e3;
/// Curvature of that price: keeps the program strictly convex.
const SLACK_CURVATURE: f64 = 1.0;

/// What one row bounds. Each comes in both signs.
#[derive(Debug, Clone, Copy)]
enum Kind {
    /// |J u|/(r `ω_max`) of one wheel.
    WheelSpeed(usize),
    /// |u|/`u_max` of one axis.
    Input(usize),
    /// Change of u in one period, per axis.
    Change(usize),
    /// |`k_p` J (u − v)/r|/`i_max` of one wheel; soft.
    Current(usize),
    /// |θ|/`θ_max`; soft.
    Heading,
    /// |v|/`v_max` of one axis; soft.
    Speed(usize),
    /// Distance across the reference's course over the width to the left, or to the right where the sign is −1; soft.
    Corridor,
    /// s ≥ 0, of the corridor or of all others.
    Slack { corridor: bool },
}

/// One row: what, in which period (for state rows: at whose end), and with which sign.
#[derive(Debug, Clone, Copy)]
struct Row {
    kind: Kind,
    period: usize,
    sign: f64,
}

/// What inputs are held to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputLimits {
    /// Rows that are multiplied by u, each at most 1 either way: J/(r `ω_max`).
    pub wheel: [Velocity; 4],
    /// Rows that are multiplied by u − v, each at most 1 either way: `k_p` J/(r `i_max`), if the currents are limited.
    pub current: Option<[Velocity; 4]>,
    /// `u_max` \[m/s, m/s, rad/s\].
    pub input: Velocity,
    /// Largest change in one period, if there is one \[m/s, m/s, rad/s\].
    pub change: Option<Velocity>,
}

impl InputLimits {
    /// Those of `robot` for a period of `period` \[s\].
    pub fn of(robot: &Robot, period: f64) -> Self {
        let jacobian = kinematics::jacobian(&robot.geometry);
        let radius = robot.geometry.wheel_radius_m;
        let scaled = |by: f64| jacobian.map(|row| row.map(|value| value * by));
        let limits = &robot.limits;
        Self {
            wheel: scaled(1.0 / (radius * robot.drive.wheel_speed_limit_radps)),
            current: Some(scaled(robot.drive.speed_loop_gain_a_s_per_rad / (radius * robot.drive.current_limit_a))),
            input: [limits.input_mps, limits.input_mps, limits.yaw_input_radps],
            change: Some([limits.input_rate_mps2, limits.input_rate_mps2, limits.yaw_input_rate_radps2].map(|rate| rate * period)),
        }
    }
}

/// What the wheels can do and the state may be. Constant.
pub struct Limits {
    inputs: InputLimits,
    heading: Option<f64>,
    /// Per axis.
    speed: [Option<f64>; 3],
    /// Width to the left and to the right.
    corridor: [Option<f64>; 2],
    horizon: usize,
    blocks: usize,
    rows: Vec<Row>,
}

impl Limits {
    /// The limits for a horizon of `horizon` periods of which `blocks` have free inputs.
    pub fn new(inputs: &InputLimits, state: &StateLimits, horizon: usize, blocks: usize) -> Self {
        let mut this = Self {
            inputs: *inputs,
            heading: state.heading_rad,
            speed: [state.speed_mps, state.speed_mps, state.yaw_rate_radps],
            corridor: [state.corridor_left_m, state.corridor_right_m],
            horizon,
            blocks,
            rows: Vec::new(),
        };
        this.rows = this.all_rows();
        this
    }

    /// How many rows there are.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// How many slacks there are.
    pub fn slacks(&self) -> usize {
        if self.has_corridor() { 2 * self.horizon } else { self.horizon }
    }

    fn has_corridor(&self) -> bool {
        self.corridor.iter().any(Option::is_some)
    }

    /// Column of the slack of a row.
    fn slack(&self, row: &Row) -> usize {
        let of_corridor = matches!(row.kind, Kind::Corridor | Kind::Slack { corridor: true });
        3 * self.blocks + row.period + if of_corridor { self.horizon } else { 0 }
    }

    fn all_rows(&self) -> Vec<Row> {
        let mut rows = Vec::new();
        let mut both = |kind, period| rows.extend([1.0, -1.0].map(|sign| Row { kind, period, sign }));
        for period in 0..self.blocks {
            (0..4).for_each(|wheel| both(Kind::WheelSpeed(wheel), period));
            (0..3).for_each(|axis| both(Kind::Input(axis), period));
            if self.inputs.change.is_some() {
                (0..3).for_each(|axis| both(Kind::Change(axis), period));
            }
            if self.inputs.current.is_some() {
                (0..4).for_each(|wheel| both(Kind::Current(wheel), period));
            }
        }
        for period in 0..self.horizon {
            if self.heading.is_some() {
                both(Kind::Heading, period);
            }
            (0..3).filter(|&axis| self.speed[axis].is_some()).for_each(|axis| both(Kind::Speed(axis), period));
        }
        let slacks = |corridor| (0..self.horizon).map(move |period| Row { kind: Kind::Slack { corridor }, period, sign: -1.0 });
        rows.extend(slacks(false));
        if self.has_corridor() {
            let sides = || [1.0, -1.0].into_iter().zip(self.corridor).filter_map(|(sign, width)| width.map(|_| sign));
            rows.extend((0..self.horizon).flat_map(|period| sides().map(move |sign| Row { kind: Kind::Corridor, period, sign })));
            rows.extend(slacks(true));
        }
        rows
    }

    /// The nearest input in the same direction that the wheels can do; what is no number counts as 0.
    pub fn clamp(&self, input: &Velocity) -> Velocity {
        let boxed: Velocity = std::array::from_fn(|axis| {
            let wished = if input[axis].is_nan() { 0.0 } else { input[axis] };
            wished.clamp(-self.inputs.input[axis], self.inputs.input[axis])
        });
        let load = self.inputs.wheel.iter().map(|row| dot(row, &boxed).abs()).fold(1.0, f64::max);
        boxed.map(|value| value / load)
    }

    /// The nearest input to `wished` that can be reached from `last` in one period.
    pub fn reach(&self, wished: &Velocity, last: &Velocity) -> Velocity {
        let (wished, last) = (self.clamp(wished), self.clamp(last));
        let Some(change) = self.inputs.change else { return wished };
        let near: Velocity = std::array::from_fn(|axis| wished[axis].clamp(last[axis] - change[axis], last[axis] + change[axis]));
        self.clamp(&near)
    }

    /// Says where G may be other than zero.
    pub(super) fn mark_structure(&self, program: &mut QuadraticProgram) {
        let mut places = Vec::new();
        for (index, row) in self.rows.iter().enumerate() {
            let (first, last, soft) = match row.kind {
                Kind::WheelSpeed(_) | Kind::Input(_) => (row.period, row.period + 1, false),
                Kind::Change(_) => (row.period.saturating_sub(1), row.period + 1, false),
                Kind::Current(_) | Kind::Heading | Kind::Speed(_) | Kind::Corridor => (0, (row.period + 1).min(self.blocks), true),
                Kind::Slack { .. } => (0, 0, true),
            };
            places.extend((3 * first..3 * last).map(|column| (index, column)));
            if soft {
                places.push((index, self.slack(row)));
            }
        }
        program.set_structure(places);
        let mut slacks: Vec<_> = self.rows.iter().enumerate().filter(|(_, row)| matches!(row.kind, Kind::Slack { .. })).collect();
        slacks.sort_by_key(|(_, row)| self.slack(row));
        program.set_slack_rows(slacks.into_iter().map(|(index, _)| index).collect());
    }

    /// Writes every row and the price of the slacks, about the present plan. Does not allocate.
    pub(super) fn write(&self, outlook: &Outlook<'_>, program: &mut QuadraticProgram) {
        let Outlook { stages, condensed, last_input, .. } = *outlook;
        let InputLimits { wheel: of_wheel, current, input: largest, change } = &self.inputs;
        let (current, change) = (current.unwrap_or_default(), change.unwrap_or([f64::INFINITY; 3]));
        for (index, row) in self.rows.iter().enumerate() {
            let slack = self.slack(row);
            let Some(stage) = stages.get(row.period) else { continue };
            let after = outlook.state(row.period + 1);
            let used = match row.kind {
                Kind::WheelSpeed(wheel) => on_input(program, index, row, &of_wheel[wheel], &stage.input),
                Kind::Input(axis) => on_input(program, index, row, &unit(axis, largest[axis]), &stage.input),
                Kind::Change(axis) => {
                    let before = row.period.checked_sub(1).and_then(|k| stages.get(k)).map_or(last_input, |stage| &stage.input);
                    let coefficients = unit(axis, change[axis]);
                    if row.period > 0 {
                        put(program, index, 3 * (row.period - 1), &coefficients.map(|value| -row.sign * value));
                    }
                    on_input(program, index, row, &coefficients, &stage.input) - row.sign * dot(&coefficients, before)
                }
                Kind::Current(wheel) => {
                    let coefficients = current[wheel];
                    on_state(program, index, row.period, &coefficients.map(|value| -row.sign * value), 3, condensed);
                    program.rows[(index, slack)] = -1.0;
                    on_input(program, index, row, &coefficients, &stage.input) - row.sign * dot(&coefficients, &stage.state.velocity)
                }
                Kind::Heading => {
                    let coefficients = unit(2, self.heading.unwrap_or(f64::INFINITY)).map(|value| row.sign * value);
                    on_state(program, index, row.period + 1, &coefficients, 0, condensed);
                    program.rows[(index, slack)] = -1.0;
                    dot(&coefficients, &after.pose) + drawn_in(outlook, row, &coefficients, 0, 1.0)
                }
                Kind::Speed(axis) => {
                    let coefficients = unit(axis, self.speed[axis].unwrap_or(f64::INFINITY)).map(|value| row.sign * value);
                    on_state(program, index, row.period + 1, &coefficients, 3, condensed);
                    program.rows[(index, slack)] = -1.0;
                    dot(&coefficients, &after.velocity) + drawn_in(outlook, row, &coefficients, 3, 1.0)
                }
                Kind::Corridor => {
                    let Some(point) = outlook.reference.get(row.period + 1) else { continue };
                    let [left, right] = self.corridor.map(|width| width.unwrap_or(f64::INFINITY));
                    let width = if row.sign > 0.0 { left } else { right };
                    let [x, y] = point.leftwards().map(|value| row.sign * value / width);
                    let coefficients = [x, y, 0.0];
                    on_state(program, index, row.period + 1, &coefficients, 0, condensed);
                    program.rows[(index, slack)] = -1.0;
                    let middle = 0.5 * (left + right) / width;
                    row.sign * point.lateral(&after.pose) / width + drawn_in(outlook, row, &coefficients, 0, middle)
                }
                Kind::Slack { .. } => {
                    program.rows[(index, slack)] = -1.0;
                    program.add_square(slack, SLACK_CURVATURE, 0.0);
                    program.add_linear(slack, SLACK_PRICE);
                    1.0
                }
            };
            if let Some(bound) = program.bounds.get_mut(index) {
                *bound = 1.0 - used;
            }
        }
    }
}

fn dot(a: &Velocity, b: &Velocity) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// By how much a bound on three entries of a predicted state, from entry `first` on, is drawn in; at most by `most`.
fn drawn_in(outlook: &Outlook<'_>, row: &Row, coefficients: &Velocity, first: usize, most: f64) -> f64 {
    let Some(caution) = outlook.caution else { return 0.0 };
    let mut direction = SVector::<f64, 6>::zeros();
    direction.fixed_rows_mut::<3>(first).copy_from_slice(coefficients);
    caution.margin(row.period + 1, &direction).min(most)
}

/// 1/limit on one axis.
fn unit(axis: usize, limit: f64) -> Velocity {
    let mut coefficients = [0.0; 3];
    coefficients[axis] = 1.0 / limit;
    coefficients
}

/// Adds three coefficients to a row.
fn put(program: &mut QuadraticProgram, index: usize, column: usize, coefficients: &Velocity) {
    for (offset, value) in coefficients.iter().enumerate() {
        program.rows[(index, column + offset)] += value;
    }
}

/// A row on the input of its period; returns what the present plan uses of it.
fn on_input(program: &mut QuadraticProgram, index: usize, row: &Row, coefficients: &Velocity, input: &Velocity) -> f64 {
    let signed = coefficients.map(|value| row.sign * value);
    put(program, index, 3 * row.period, &signed);
    dot(&signed, input)
}

/// A row on three entries of state `k`, from entry `first` on.
fn on_state(program: &mut QuadraticProgram, index: usize, k: usize, coefficients: &Velocity, first: usize, condensed: &Condensed) {
    let through = |sensitivity: &Block| -> Velocity {
        std::array::from_fn(|column| (0..3).map(|entry| coefficients[entry] * sensitivity[(first + entry, column)]).sum())
    };
    for block in 0..condensed.reach(k) {
        put(program, index, 3 * block, &through(&condensed.block(k, block)));
    }
    for (place, block) in condensed.by_surprise(k).iter().enumerate() {
        program.put_row_by_surprise(index, 3 * place, &through(block));
    }
}
