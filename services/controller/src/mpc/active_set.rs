//! A dual active-set method for strictly convex programs in stages (Goldfarb and Idnani,
//! Mathematical Programming 27, 1983).
//!
//! The method begins at the minimum without rows, and adds one violated bound after the other. So
//! it costs little where few limits are active. Slacks at zero are the one exception: they have a
//! penalty as long as no row needs them, so they are held at zero from the start.
//!
//! ```text
//! J Jᵀ = H⁻¹      Jᵀ N = Q R      QᵀQ = 1, R upper triangular
//! N: the active bounds' normals, which point inwards
//! ```
//! J is never formed: [`Riccati`] multiplies by it and its transpose in O(N). A slack adds an entry
//! to v = J⁻¹x once it is no longer held. A bound with the normal n is added along w, while the
//! multipliers of the active ones change by −r:
//!
//! ```text
//! d = Jᵀ n      w = d − Q Qᵀ d      r = R⁻¹ Qᵀ d
//! ```
//! The step ends at the bound, or where a multiplier becomes zero: then that bound is dropped. The
//! iteration updates v. The distance of a bound b + nᵀx is b + dᵀv; x = J v is computed when all
//! bounds are checked. One such step is O(N (1 + active bounds)).
//!
//! Programs of successive ticks differ little. If the last solution had an active row that
//! [recurs](super::qp::Row::recurs), its active bounds are active from the start, and its free
//! slacks are free. The minimum v₀ without rows, and the distances ρ of these bounds there, give their
//! multipliers λ at once:
//!
//! ```text
//! Rᵀ z = −ρ      v = v₀ + Q z      R λ = z
//! ```
//! Bounds with a negative multiplier are dropped, and slacks whose penalty is exceeded become free,
//! until none is left. From there on, the method goes on as above.

mod bound;
mod orthogonal;
mod resume;

use super::qp::{INPUT, QuadraticProgram};
use super::riccati::{Riccati, Trajectory};
use super::solver::{Outcome, Status, Turn};
use bound::{Bound, Slack, entry_of_slack};
use nalgebra::DVector;
use orthogonal::{DEPENDENT, Orthogonal};

/// Tolerated violation of a bound; rows are scaled to bounds of 1.
const VIOLATION: f64 = 1e-9;
/// From this decrease on, a multiplier counts as decreasing, per unit of the new bound's
/// multiplier.
const RELEASE: f64 = 1e-12;
/// Largest number of bounds that are added or dropped, in multiples of the number of unknowns and
/// bounds.
const STEPS_MOST: usize = 2;

/// The owner of a multiplier that became zero.
#[derive(Debug, Clone, Copy)]
enum Released {
    /// The active bound at this place.
    Active(usize),
    /// A slack that is held.
    Slack(usize),
}

/// Result of a step towards a bound.
enum Step {
    /// The bound is active.
    Added,
    /// Another bound was dropped on the way.
    Dropped,
    /// No step reaches the bound.
    Impossible,
}

/// The method with all its memory: set up once, then in place.
pub struct ActiveSet {
    factor: Riccati,
    /// Whether the factor belongs to a program that can be solved.
    prepared: bool,
    /// Largest number of steps.
    most: usize,
    /// Q and R.
    normals: Orthogonal,
    /// Active bounds, in the order of R's columns, and their multipliers. Held slacks are not among
    /// them.
    active: Vec<Bound>,
    multipliers: Vec<f64>,
    /// Bounds that were active in the last solution, and slacks that were free.
    recurring: Vec<Bound>,
    recurring_slacks: Vec<usize>,
    /// ρ of the bounds that are active from the start.
    distances: Vec<f64>,
    /// Bounds that were violated at the last check of all bounds.
    violated: Vec<(Bound, f64)>,
    /// v, and the x that belongs to it.
    whitened: DVector<f64>,
    at: Trajectory,
    slacks: Vec<f64>,
    slack_states: Vec<Slack>,
    /// Multipliers of held slacks.
    slack_multipliers: Vec<f64>,
    /// Number of entries of v.
    entries: usize,
    /// d, the number of its leading entries that may be nonzero, and r.
    image: DVector<f64>,
    reach: usize,
    release: DVector<f64>,
    /// The same for held slacks.
    slack_release: Vec<f64>,
}

impl ActiveSet {
    /// Allocates for programs of the shape of `program`.
    pub fn new(program: &QuadraticProgram) -> Self {
        let (unknowns, slacks) = (program.unknowns(), program.slacks());
        Self {
            factor: Riccati::new(program),
            prepared: false,
            most: steps_most(program),
            normals: Orthogonal::new(unknowns),
            active: Vec::with_capacity(unknowns),
            multipliers: Vec::with_capacity(unknowns),
            recurring: Vec::with_capacity(unknowns),
            recurring_slacks: Vec::with_capacity(slacks),
            distances: Vec::with_capacity(unknowns),
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

    /// Solves `program`, and writes inputs and slacks to `solution` if there is an answer. Does not
    /// allocate.
    pub fn solve(
        &mut self,
        program: &QuadraticProgram,
        solution: &mut [f64],
        turn: &Turn,
    ) -> Outcome {
        self.prepare(program);
        self.finish(program, solution, turn)
    }

    /// Does the work that needs no gradients or bounds. Does not allocate.
    pub fn prepare(&mut self, program: &QuadraticProgram) {
        self.prepared = self.factor.factorise(program)
            && program.penalties.slack >= 0.0
            && program.penalties.slack_curvature > 0.0;
    }

    /// Solves the [prepared](Self::prepare) program. Can be called repeatedly. Does not allocate.
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
            self.remember(program);
            inputs.copy_from_slice(self.at.inputs.as_flattened());
            slacks.copy_from_slice(&self.slacks);
        }
        Outcome { status, iterations }
    }

    /// Adds violated bounds, one after the other, until none is violated. The dual cost grows with
    /// each step.
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
        self.resume(program, iterations);
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

    /// The next violated bound and its distance, if there is one. When the list of violated bounds
    /// is empty, all bounds are checked again; the most violated come first.
    ///
    /// Afterwards d and its reach belong to that bound: the distance follows from them, without x.
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
            // A bound that is violated by x but not by v is violated by rounding only.
            if looked {
                return None;
            }
            looked = true;
            self.place(program);
            self.look_for_violated(program);
            self.violated.sort_unstable_by(|(_, a), (_, b)| b.total_cmp(a));
        }
    }

    /// Checks all bounds except the active ones.
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

    /// Steps towards `bound`, at the given `distance` and with the given `multiplier` so far.
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

    /// Computes d of `bound`, and its reach.
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

    /// Computes r, and the same for held slacks.
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

    /// Releases `slack`: v gains an entry, and so do the normals of the active rows that this slack
    /// relaxes.
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

/// Largest number of steps for programs of the shape of `program`.
fn steps_most(program: &QuadraticProgram) -> usize {
    STEPS_MOST * (program.unknowns() + 2 * program.rows.len() + program.slacks())
}

#[cfg(test)]
mod tests;
