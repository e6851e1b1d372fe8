//! The limits: the wheels' own, all linear in (v, u), and soft bounds on the predicted state.
//!
//! Wheel rows cover the periods with a free input. Later inputs keep their distance from the
//! target, and are clamped to the wheels' limits during prediction.
//!
//! Every row is scaled to a bound of 1. This keeps the program well scaled, and one slack per
//! period serves all its soft rows: a slack of 0.1 allows each row to be exceeded by a tenth. Only
//! the corridor has a slack of its own: a robot far outside the corridor must not be free to exceed
//! the other limits as well.
//!
//! Tightening reduces the bounds on the state, at most until the two sides meet.

mod current;
mod inputs;
mod nearest;

pub use inputs::{InputLimits, RobotLimit};

use super::around::{ACTIVE_MAX, Around, CORNERS};
use super::qp::{BEFORE, Penalties, QuadraticProgram, Row, Vector};
use super::{PresentPlan, Stage};
use crate::settings::StateLimits;
use model::main_model::MainModel;
use model::{State, Velocity};
use nalgebra::SVector;
use robot::WHEELS_MAX;

/// Linear penalty of a slack of 1. It is greater than any multiplier of a soft row, so slacks stay
/// zero where they can.
const SLACK_PENALTY: f64 = 1e3;
/// Curvature of that penalty: keeps the program strictly convex.
const SLACK_CURVATURE: f64 = 1.0;

/// From this share of a limit on, a plan reaches it.
const REACHES: f64 = 0.99;

/// Index of the velocity in a state.
const VELOCITY: usize = 3;

/// Quantity that one row bounds, from above and below.
#[derive(Debug, Clone, Copy)]
enum Kind {
    /// |J u|/(r `ω_max`) of one wheel.
    WheelSpeed(usize),
    /// |u|/`u_max` of one axis.
    Input(usize),
    /// Change of u in one period, per axis; of J u, per wheel, if the drive ramps its command.
    Change(usize),
    /// |`k_p` J (u − v + (g + d)/(1 − A))/r| of one wheel, over the share of `i_max` that plans
    /// use; soft.
    Current(usize),
    /// |θ|/`θ_max`; soft.
    Heading,
    /// |v|/`v_max` of one axis; soft.
    Speed(usize),
    /// Distance across the reference's course over the width to the left, or to the right if the
    /// sign is −1. Bounded from above alone; soft.
    Corridor(f64),
    /// Distance of a corner of the footprint from one of the nearest obstacles; soft, with a slack
    /// of its own.
    Obstacle { index: usize, corner: usize },
}

/// Limits of wheels and state. Constant, except for dropped rows.
pub struct Limits {
    inputs: InputLimits,
    heading: Option<f64>,
    /// Per axis.
    speed: [Option<f64>; 3],
    /// Width to the left and to the right.
    corridor: [Option<f64>; 2],
    horizon: usize,
    main: MainModel,
    /// Wheels whose current rows are dropped.
    dropped: [bool; WHEELS_MAX],
    /// Share of the limit on currents that plans use at the start of a period, and its largest
    /// value.
    current_share: f64,
    current_share_max: f64,
    /// Rows of the currents: those of the robot's limit, over that share.
    current: [Velocity; WHEELS_MAX],
    /// Rows of the largest change of u in one period, each at most 1 either way.
    changes: [Velocity; WHEELS_MAX],
    /// Largest change of the rim speeds in one period, if the drive ramps its command \[m/s\].
    ramp: Option<f64>,
    /// Obstacles; none if the program has no rows for them.
    around: Option<Around>,
    /// Kind and period of each row; a row on a state bounds that period's end.
    kinds: Vec<(Kind, usize)>,
}

impl Limits {
    /// The limits for a horizon of `horizon` periods of which `blocks` have free inputs, of a robot
    /// with this main model.
    pub fn new(
        inputs: &InputLimits,
        state: &StateLimits,
        horizon: usize,
        blocks: usize,
        main: &MainModel,
    ) -> Self {
        let current_share_max = current::share_max(main);
        let mut this = Self {
            inputs: *inputs,
            heading: state.heading_rad,
            speed: [state.speed_mps, state.speed_mps, state.yaw_rate_radps],
            corridor: [state.corridor_left_m, state.corridor_right_m],
            horizon,
            main: *main,
            dropped: [false; WHEELS_MAX],
            current_share: 1.0,
            current_share_max,
            current: inputs.current.unwrap_or_default(),
            changes: inputs.changes(None),
            ramp: None,
            around: None,
            kinds: Vec::new(),
        };
        this.kinds = this.all_kinds(blocks);
        this.use_current_share(current_share_max);
        this
    }

    /// The same with rows for obstacles.
    pub(super) fn around(mut self, around: Option<Around>) -> Self {
        if around.is_some() {
            let periods = 0..self.horizon;
            self.kinds.extend(periods.flat_map(|period| {
                (0..ACTIVE_MAX * CORNERS).map(move |row| {
                    let (index, corner) = (row / CORNERS, row % CORNERS);
                    (Kind::Obstacle { index, corner }, period)
                })
            }));
        }
        Self { around, ..self }
    }

    /// The obstacles, if the program has rows for them.
    pub(super) fn obstacles_mut(&mut self) -> Option<&mut Around> {
        self.around.as_mut()
    }

    /// Whether an obstacle holds the plan that moves the states by `moves`.
    pub(super) fn held_by_obstacle(&self, program: &QuadraticProgram, moves: &[Vector]) -> bool {
        let rows = program.rows.iter().zip(&self.kinds);
        self.around.as_ref().is_some_and(|around| around.count() > 0)
            && rows
                .filter(|(_, (kind, _))| matches!(kind, Kind::Obstacle { .. }))
                .any(|(row, _)| Around::holds(row, row.value(moves, &[])))
    }

    /// From now on plans keep to a drive that changes the rim speeds of its set points by no more
    /// than this in a period, if there is such a bound \[m/s\]. Returns whether that is new.
    pub(super) fn keep_to_ramp(&mut self, rim: Option<f64>) -> bool {
        let is_new = self.ramp != rim;
        (self.changes, self.ramp) = (self.inputs.changes(rim), rim);
        is_new
    }

    /// The bound of [`keep_to_ramp`](Self::keep_to_ramp).
    pub(super) fn ramp(&self) -> Option<f64> {
        self.ramp
    }

    /// The limit of the robot that a plan reaches in its first period, if it reaches one. `after`
    /// is the state at the end of this period, `last_input` the input before.
    pub(super) fn reached(
        &self,
        first: &Stage,
        after: &State,
        last_input: &Velocity,
    ) -> Option<RobotLimit> {
        let InputLimits { wheel, wheels, input, .. } = &self.inputs;
        let currents = self.foretold_currents(first, after).start;
        let change: Velocity = std::array::from_fn(|axis| first.input[axis] - last_input[axis]);
        let is_ramped =
            |change: &Velocity| self.changes.iter().any(|row| dot(row, change).abs() >= REACHES);
        let full = REACHES * self.current_share;
        let is_full = |wheel: usize| !self.dropped[wheel] && currents[wheel].abs() >= full;
        if (0..*wheels).any(is_full) {
            let is_floor = self.current_share < self.current_share_max;
            Some(if is_floor { RobotLimit::Grip } else { RobotLimit::MotorCurrent })
        } else if self.ramp.is_some() && is_ramped(&change) {
            Some(RobotLimit::Ramp)
        } else if wheel.iter().any(|row| dot(row, &first.input).abs() >= REACHES) {
            Some(RobotLimit::WheelSpeed)
        } else if (0..3).any(|axis| first.input[axis].abs() >= REACHES * input[axis]) {
            Some(RobotLimit::Input)
        } else {
            None
        }
    }

    /// Moves the plan's states by `moves`, with unchanged inputs. The accelerations that the main
    /// model does not explain stay unchanged too. Does not allocate.
    pub(super) fn displace(&self, moves: &[Vector], program: &mut QuadraticProgram) {
        for (row, &(kind, period)) in program.rows.iter_mut().zip(&self.kinds) {
            let (Kind::Current(wheel), Some([before, after, ..])) = (kind, moves.get(period..))
            else {
                continue;
            };
            if self.dropped[wheel] {
                continue;
            }
            let unmodelled = std::array::from_fn(|axis| {
                let (decay, of) = (self.main.decay[axis], VELOCITY + axis);
                (after[of] - decay * before[of]) / (1.0 - decay)
            });
            let moved = dot(&self.current[wheel], &unmodelled);
            row.bounds[0] -= moved;
            row.bounds[1] += moved;
        }
    }

    /// Number of slacks.
    pub fn slacks(&self) -> usize {
        self.first_obstacle_slack() + if self.around.is_some() { self.horizon } else { 0 }
    }

    /// Number of slacks of the other rows.
    fn first_obstacle_slack(&self) -> usize {
        if self.corridor.iter().any(Option::is_some) { 2 * self.horizon } else { self.horizon }
    }

    fn all_kinds(&self, blocks: usize) -> Vec<(Kind, usize)> {
        let mut kinds = Vec::new();
        for period in 0..blocks {
            kinds.extend((0..self.inputs.wheels).map(|wheel| (Kind::WheelSpeed(wheel), period)));
            kinds.extend((0..3).map(|axis| (Kind::Input(axis), period)));
            let changes = if self.inputs.change.is_some() { self.inputs.wheels.max(3) } else { 0 };
            kinds.extend((0..changes).map(|row| (Kind::Change(row), period)));
            kinds.extend(
                (0..self.inputs.wheels)
                    .filter(|_| self.inputs.current.is_some())
                    .map(|wheel| (Kind::Current(wheel), period)),
            );
        }
        for period in 0..self.horizon {
            kinds.extend(self.heading.map(|_| (Kind::Heading, period)));
            kinds.extend(
                (0..3)
                    .filter(|&axis| self.speed[axis].is_some())
                    .map(|axis| (Kind::Speed(axis), period)),
            );
            let sides = [1.0, -1.0].into_iter().zip(self.corridor);
            kinds.extend(
                sides
                    .filter(|(_, width)| width.is_some())
                    .map(|(sign, _)| (Kind::Corridor(sign), period)),
            );
        }
        kinds
    }

    /// The rows, before a plan is known.
    pub(super) fn rows(&self) -> Vec<Row> {
        let row = |&(kind, period): &(Kind, usize)| {
            let (stage, first, slack) = match kind {
                Kind::WheelSpeed(_) | Kind::Input(_) => (period, 0, None),
                Kind::Change(_) => (period, BEFORE, None),
                Kind::Current(_) => (period, VELOCITY, Some(period)),
                Kind::Heading => (period + 1, 0, Some(period)),
                Kind::Speed(_) => (period + 1, VELOCITY, Some(period)),
                Kind::Corridor(_) => (period + 1, 0, Some(self.horizon + period)),
                Kind::Obstacle { .. } => {
                    (period + 1, 0, Some(self.first_obstacle_slack() + period))
                }
            };
            let is_one_sided = matches!(kind, Kind::Corridor(_) | Kind::Obstacle { .. });
            let below = if is_one_sided { f64::INFINITY } else { 1.0 };
            Row {
                stage,
                first,
                by_state: [0.0; 3],
                by_input: [0.0; 3],
                slack,
                bounds: [1.0, below],
                recurs: matches!(kind, Kind::Obstacle { .. }),
            }
        };
        self.kinds.iter().map(row).collect()
    }

    /// Penalties of the free inputs and of the slacks.
    pub(super) fn with_slacks(inputs: Penalties) -> Penalties {
        Penalties { slack: SLACK_PENALTY, slack_curvature: SLACK_CURVATURE, ..inputs }
    }

    /// Writes every row about the present plan. Does not allocate.
    pub(super) fn write(&self, plan: &PresentPlan<'_>, program: &mut QuadraticProgram) {
        let PresentPlan { stages, last_input, .. } = *plan;
        let InputLimits { wheel: of_wheel, input: largest, .. } = &self.inputs;
        let around = self.around.as_ref();
        let mut approaches =
            around.map_or_else(Default::default, |around| around.approaches(plan.state(0)));
        for (row, &(kind, period)) in program.rows.iter_mut().zip(&self.kinds) {
            let Some(stage) = stages.get(period) else { continue };
            let after = plan.state(period + 1);
            let used = match kind {
                Kind::WheelSpeed(wheel) => on_input(row, &of_wheel[wheel], &stage.input),
                Kind::Input(axis) => on_input(row, &unit(axis, largest[axis]), &stage.input),
                Kind::Change(index) => {
                    let before = period
                        .checked_sub(1)
                        .and_then(|k| stages.get(k))
                        .map_or(last_input, |stage| &stage.input);
                    let coefficients = self.changes[index];
                    on_input(row, &coefficients, &stage.input)
                        + on_state(row, &coefficients.map(|value| -value), before)
                }
                Kind::Current(wheel) if self.dropped[wheel] => {
                    (row.by_state, row.by_input) = ([0.0; 3], [0.0; 3]);
                    0.0
                }
                Kind::Current(wheel) => {
                    let coefficients = self.current[wheel];
                    on_input(row, &coefficients, &stage.input)
                        + on_state(row, &coefficients.map(|value| -value), &stage.state.velocity)
                        + dot(&coefficients, &self.unmodelled(&stage.state.velocity, after))
                }
                Kind::Heading => {
                    on_state(row, &unit(2, self.heading.unwrap_or(f64::INFINITY)), &after.pose)
                }
                Kind::Speed(axis) => on_state(
                    row,
                    &unit(axis, self.speed[axis].unwrap_or(f64::INFINITY)),
                    &after.velocity,
                ),
                Kind::Corridor(sign) => {
                    let Some(point) = plan.reference.get(period + 1) else { continue };
                    let [left, right] = self.corridor.map(|width| width.unwrap_or(f64::INFINITY));
                    let width = if sign > 0.0 { left } else { right };
                    let [x, y] = point.leftwards().map(|value| sign * value / width);
                    row.by_state = [x, y, 0.0];
                    let most = 0.5 * (left + right) / width;
                    row.bounds[0] =
                        1.0 - sign * point.lateral(&after.pose) / width - drawn_in(plan, row, most);
                    continue;
                }
                Kind::Obstacle { index, corner } => {
                    let (Some(around), Some(approach)) = (around, approaches.get_mut(index)) else {
                        continue;
                    };
                    if corner == 0 {
                        around.advance(index, period, after, approach);
                    }
                    approach.write(corner, row);
                    row.bounds[0] -= drawn_in(plan, row, 1.0);
                    continue;
                }
            };
            let margin = if row.stage > period { drawn_in(plan, row, 1.0) } else { 0.0 };
            row.bounds = [1.0 - used - margin, 1.0 + used - margin];
        }
    }
}

fn dot(a: &Velocity, b: &Velocity) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Tightening of the bounds of a row on a predicted state; at most `most`.
fn drawn_in(plan: &PresentPlan<'_>, row: &Row, most: f64) -> f64 {
    let Some(tightening) = plan.tightening else { return 0.0 };
    let mut direction = SVector::<f64, 6>::zeros();
    direction.fixed_rows_mut::<3>(row.first).copy_from_slice(&row.by_state);
    tightening.margin(row.stage, &direction).min(most)
}

/// 1/limit on one axis.
fn unit(axis: usize, limit: f64) -> Velocity {
    let mut coefficients = [0.0; 3];
    coefficients[axis] = 1.0 / limit;
    coefficients
}

/// Sets a row's coefficients on the input of its period. Returns the present plan's share of the
/// bound.
fn on_input(row: &mut Row, coefficients: &Velocity, input: &Velocity) -> f64 {
    row.by_input = *coefficients;
    dot(coefficients, input)
}

/// Sets a row's coefficients on three entries of its state. Returns the present plan's share of the
/// bound.
fn on_state(row: &mut Row, coefficients: &Velocity, entries: &Velocity) -> f64 {
    row.by_state = *coefficients;
    dot(coefficients, entries)
}
