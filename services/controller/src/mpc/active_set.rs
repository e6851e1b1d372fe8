//! A dual active-set method for strictly convex programs (Goldfarb and Idnani, Mathematical Programming 27, 1983), in stages.
//!
//! It begins at the minimum without rows and adds one violated bound after the other, so that it costs next to nothing where few limits
//! bind. Slacks at zero are the one exception: they have a penalty as long as no row needs them, so they are held there at the start.
//!
//! ```text
//! J Jᵀ = H⁻¹      Jᵀ N = Q R      N: the active bounds' normals, which point inwards; QᵀQ = 1, R upper triangular
//! ```
//! J is never written down: [`Riccati`] multiplies by it and its transpose in O(N), and a slack adds an entry to v = J⁻¹x once it is no longer held.
//! A bound with the normal n is added along w, while the multipliers of the active ones change by −r:
//!
//! ```text
//! d = Jᵀ n      w = d − Q Qᵀ d      r = R⁻¹ Qᵀ d
//! ```
//! as far as the bound asks for, or until a multiplier is zero: then that bound is dropped. What goes on is v, by
//! which the distance of a bound b + nᵀx is b + dᵀv; x = J v is worked out when all bounds are looked at. One such step is O(N (1 + active bounds)).

mod orthogonal;

use super::qp::{INPUT, QuadraticProgram};
use super::riccati::{Riccati, Trajectory};
use super::solver::{Outcome, Status, Turn};
use nalgebra::DVector;
use orthogonal::{DEPENDENT, Orthogonal};

/// By how much a bound may be violated; rows are scaled to bounds of 1.
const VIOLATION: f64 = 1e-9;
/// What counts as a multiplier that grows smaller, per unit of the new bound's.
const RELEASE: f64 = 1e-12;
/// Most bounds that are added or dropped, in multiples of the number of unknowns and bounds.
const STEPS_MOST: usize = 2;

/// What may be active.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bound {
    /// Of a row, from above (0) or from below (1).
    Row(usize, usize),
    /// s ≥ 0 of a slack.
    Slack(usize),
}

/// A slack's state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Slack {
    /// At zero from the start.
    Held,
    /// It has this entry of v.
    Free(usize),
}

/// Whose multiplier is zero.
#[derive(Debug, Clone, Copy)]
enum Released {
    /// The active bound at this place.
    Active(usize),
    /// A slack that is held.
    Slack(usize),
}

/// What a step towards a bound came to.
enum Step {
    /// The bound is active.
    Added,
    /// Another was dropped on the way.
    Dropped,
    /// No step leads there.
    Impossible,
}

/// The method with all its memory: set up once, then in place.
pub struct ActiveSet {
    factor: Riccati,
    /// Whether that is of a program that can be solved.
    prepared: bool,
    /// Most steps that are taken.
    most: usize,
    /// Q and R.
    normals: Orthogonal,
    /// Active bounds, in the order of R's columns, and their multipliers; slacks that are held are not among them.
    active: Vec<Bound>,
    multipliers: Vec<f64>,
    /// What was violated when all bounds were looked at last.
    violated: Vec<(Bound, f64)>,
    /// v, and the x that belongs to it.
    whitened: DVector<f64>,
    at: Trajectory,
    slacks: Vec<f64>,
    slack_states: Vec<Slack>,
    /// Of slacks that are held.
    slack_multipliers: Vec<f64>,
    /// How many entries v has.
    entries: usize,
    /// d, how many of its first entries may be other than zero, and r.
    image: DVector<f64>,
    reach: usize,
    release: DVector<f64>,
    /// The same of slacks that are held.
    slack_release: Vec<f64>,
}

impl ActiveSet {
    /// Makes room for programs of the shape of `program`.
    pub fn new(program: &QuadraticProgram) -> Self {
        let (unknowns, slacks) = (program.unknowns(), program.slacks());
        Self {
            factor: Riccati::new(program),
            prepared: false,
            most: steps_most(program),
            normals: Orthogonal::new(unknowns),
            active: Vec::with_capacity(unknowns),
            multipliers: Vec::with_capacity(unknowns),
            violated: Vec::with_capacity(2 * program.rows.len() + slacks),
            whitened: DVector::zeros(unknowns),
            at: Trajectory::of(program),
            slacks: vec![0.0; slacks],
            slack_states: vec![Slack::Held; slacks],
            slack_multipliers: vec![0.0; slacks],
            entries: 0,
            image: DVector::zeros(unknowns),
            reach: 0,
            release: DVector::zeros(unknowns),
            slack_release: vec![0.0; slacks],
        }
    }

    /// Solves `program`, and writes inputs and slacks to `solution` if there is an answer. Does not allocate.
    pub fn solve(
        &mut self,
        program: &QuadraticProgram,
        solution: &mut [f64],
        turn: &Turn,
    ) -> Outcome {
        self.prepare(program);
        self.finish(program, solution, turn)
    }

    /// What there is to do before gradients and bounds are known. Does not allocate.
    pub fn prepare(&mut self, program: &QuadraticProgram) {
        self.prepared = self.factor.factorise(program)
            && program.penalties.slack >= 0.0
            && program.penalties.slack_curvature > 0.0;
    }

    /// Solves the program that was [prepared](Self::prepare), as often as that is wanted. Does not allocate.
    pub fn finish(
        &mut self,
        program: &QuadraticProgram,
        solution: &mut [f64],
        turn: &Turn,
    ) -> Outcome {
        let mut iterations = 0;
        let status = if turn.is_over() {
            Status::OutOfTime
        } else {
            self.dual_ascent(program, turn, &mut iterations)
        };
        if status == Status::Solved
            && let Some((inputs, slacks)) = solution.split_at_mut_checked(INPUT * program.blocks())
        {
            inputs.copy_from_slice(self.at.inputs.as_flattened());
            slacks.copy_from_slice(&self.slacks);
        }
        Outcome { status, iterations }
    }

    /// Adds violated bounds, one after the other, until none is violated: the dual cost grows with each step.
    fn dual_ascent(
        &mut self,
        program: &QuadraticProgram,
        turn: &Turn,
        iterations: &mut u32,
    ) -> Status {
        if !self.prepared {
            return Status::Failed;
        }
        self.begin(program);
        while let Some((bound, mut distance)) = self.violated(program) {
            let mut multiplier = 0.0;
            loop {
                *iterations += 1;
                if *iterations as usize > self.most {
                    return Status::OutOfIterations;
                }
                if turn.is_over() {
                    return Status::OutOfTime;
                }
                match self.approach(program, bound, &mut distance, &mut multiplier) {
                    Step::Added => break,
                    Step::Dropped => {}
                    Step::Impossible => return Status::Infeasible,
                }
            }
        }
        let finite =
            self.at.inputs.as_flattened().iter().chain(&self.slacks).all(|value| value.is_finite());
        if finite { Status::Solved } else { Status::Failed }
    }

    /// The minimum without rows, but with every slack held at zero.
    fn begin(&mut self, program: &QuadraticProgram) {
        self.active.clear();
        self.multipliers.clear();
        self.normals.clear();
        self.violated.clear();
        self.slacks.fill(0.0);
        self.slack_states.fill(Slack::Held);
        self.slack_multipliers.fill(program.penalties.slack);
        self.entries = INPUT * program.blocks();
        let mut whitened = self.whitened.rows_mut(0, self.entries);
        self.factor.transposed_gradient(program, whitened.as_mut_slice());
        whitened.neg_mut();
    }

    /// x = J v.
    fn place(&mut self, program: &QuadraticProgram) {
        self.factor.apply(self.whitened.as_slice(), &mut self.at);
        for (slack, state) in self.slacks.iter_mut().zip(&self.slack_states) {
            if let Slack::Free(entry) = state {
                *slack = self.whitened[*entry] * entry_of_slack(program);
            }
        }
    }

    /// A bound that is violated, if one is, and its distance. All are looked at when nothing is left of what was violated the last time, the most first.
    ///
    /// Then d and its reach are those of that bound: its distance follows from them, without x.
    fn violated(&mut self, program: &QuadraticProgram) -> Option<(Bound, f64)> {
        let mut looked = false;
        loop {
            while let Some((bound, _)) = self.violated.pop() {
                self.look_at(program, bound);
                let distance = bound.room(program)
                    + self.image.rows(0, self.reach).dot(&self.whitened.rows(0, self.reach));
                if distance < -VIOLATION {
                    return Some((bound, distance));
                }
            }
            // What only x says is violated, and not v, is so by rounding.
            if looked {
                return None;
            }
            looked = true;
            self.place(program);
            self.look_for_violated(program);
            self.violated.sort_unstable_by(|(_, a), (_, b)| b.total_cmp(a));
        }
    }

    /// Looks at all bounds but the active ones.
    fn look_for_violated(&mut self, program: &QuadraticProgram) {
        let mut look = |bound: Bound, distance: f64| {
            if distance < -VIOLATION && !self.active.contains(&bound) {
                self.violated.push((bound, distance));
            }
        };
        for (index, row) in program.rows.iter().enumerate() {
            let value = row.value(&self.at.states, &self.at.inputs);
            let slack = row.slack.map_or(0.0, |slack| self.slacks[slack]);
            look(Bound::Row(index, 0), row.bounds[0] - value + slack);
            look(Bound::Row(index, 1), row.bounds[1] + value + slack);
        }
        for (index, slack) in self.slacks.iter().enumerate() {
            look(Bound::Slack(index), *slack);
        }
    }

    /// Goes towards `bound`, which is `distance` away and whose multiplier so far is `multiplier`.
    fn approach(
        &mut self,
        program: &QuadraticProgram,
        bound: Bound,
        distance: &mut f64,
        multiplier: &mut f64,
    ) -> Step {
        let (whole, square) = self.normals.take_apart(&self.image, self.reach);
        self.find_release(program, bound);
        let (mut first, mut until_released) = (None, f64::INFINITY);
        let of_active = self
            .multipliers
            .iter()
            .zip(self.release.iter())
            .enumerate()
            .map(|(place, of)| (Released::Active(place), of));
        let of_slacks = self
            .slack_multipliers
            .iter()
            .zip(&self.slack_release)
            .enumerate()
            .map(|(slack, of)| (Released::Slack(slack), of));
        for (which, (multiplier, release)) in of_active.chain(of_slacks) {
            if *release > RELEASE && multiplier / release < until_released {
                (first, until_released) = (Some(which), multiplier / release);
            }
        }
        let independent = square > DEPENDENT * whole && self.normals.has_room();
        let until_reached = if independent { -*distance / square } else { f64::INFINITY };
        let length = until_reached.min(until_released);
        if !length.is_finite() {
            return Step::Impossible;
        }
        let of_slacks = self.slack_multipliers.iter_mut().zip(&self.slack_release);
        for (multiplier, release) in
            self.multipliers.iter_mut().zip(self.release.iter()).chain(of_slacks)
        {
            *multiplier -= length * release;
        }
        *multiplier += length;
        if independent {
            self.whitened.axpy(length, self.normals.rest(), 1.0);
            *distance += length * square;
        }
        match first {
            Some(which) if until_released < until_reached => {
                match which {
                    Released::Active(place) => self.drop_constraint(place),
                    Released::Slack(slack) => {
                        self.free_slack(program, slack);
                        self.look_at(program, bound);
                    }
                }
                Step::Dropped
            }
            _ => {
                self.add_constraint(bound, *multiplier);
                Step::Added
            }
        }
    }

    /// d of `bound`, and its reach.
    fn look_at(&mut self, program: &QuadraticProgram, bound: Bound) {
        self.reach = 0;
        match bound {
            Bound::Row(row, side) => {
                let row = &program.rows[row];
                self.factor.transposed_row(row, self.image.as_mut_slice());
                if side == 0 {
                    self.image.neg_mut();
                }
                self.reach = INPUT * (row.stage + 1).min(program.blocks());
            }
            Bound::Slack(_) => self.image.fill(0.0),
        }
        if let Some(Slack::Free(entry)) = bound.slack(program).map(|slack| self.slack_states[slack])
        {
            self.image[entry] = entry_of_slack(program);
            self.reach = entry + 1;
        }
    }

    /// r, and what belongs to the slacks that are held.
    fn find_release(&mut self, program: &QuadraticProgram, bound: Bound) {
        self.normals.solve(&mut self.release);
        self.slack_release.fill(0.0);
        let with_release = self.active.iter().zip(self.release.iter().map(|release| -release));
        for (bound, by) in with_release.chain([(&bound, 1.0)]) {
            if let Some(slack) =
                bound.slack(program).filter(|slack| self.slack_states[*slack] == Slack::Held)
            {
                self.slack_release[slack] += by;
            }
        }
    }

    fn add_constraint(&mut self, bound: Bound, multiplier: f64) {
        self.normals.add_column();
        self.active.push(bound);
        self.multipliers.push(multiplier);
    }

    fn drop_constraint(&mut self, place: usize) {
        self.normals.drop_column(place);
        self.active.remove(place);
        self.multipliers.remove(place);
    }

    /// Holds `slack` no longer: v has an entry more, and so have the normals of the active rows that it lets off.
    fn free_slack(&mut self, program: &QuadraticProgram, slack: usize) {
        let entry = self.entries;
        (self.slack_states[slack], self.slack_multipliers[slack]) = (Slack::Free(entry), 0.0);
        self.whitened[entry] = 0.0;
        self.entries += 1;
        for (slot, bound) in self.release.iter_mut().zip(&self.active) {
            *slot = if bound.slack(program) == Some(slack) { entry_of_slack(program) } else { 0.0 };
        }
        self.normals.add_row(entry, &mut self.release);
    }
}

impl Bound {
    /// How far it is away where everything is zero.
    fn room(self, program: &QuadraticProgram) -> f64 {
        match self {
            Self::Row(row, side) => program.rows[row].bounds[side],
            Self::Slack(_) => 0.0,
        }
    }

    /// The slack that it is about, if there is one.
    fn slack(self, program: &QuadraticProgram) -> Option<usize> {
        match self {
            Self::Row(row, _) => program.rows[row].slack,
            Self::Slack(slack) => Some(slack),
        }
    }
}

/// A slack in v, of a slack in x; and the other way about.
fn entry_of_slack(program: &QuadraticProgram) -> f64 {
    1.0 / program.penalties.slack_curvature.sqrt()
}

/// Most steps for programs of the shape of `program`.
fn steps_most(program: &QuadraticProgram) -> usize {
    STEPS_MOST * (program.unknowns() + 2 * program.rows.len() + program.slacks())
}

#[cfg(test)]
mod tests;
