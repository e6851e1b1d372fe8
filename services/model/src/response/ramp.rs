//! The ramp of a drive: the largest rate at which it changes the set points of its wheels.
//!
//! ```text
//! s⁺ = s + clamp(J u − s, ±a T)      per wheel; s: set point of the rim speed
//! ```
//! s̄ is the mean of s over a period. While the commands ask for more than a, a response to J⁺ s̄
//! [follows](super::follower) the wheels better than one to u. Several a are compared, beside no
//! ramp. A drive may have a ramp and a dead time, so each a is compared with several dead times.
//!
//! The a with the smallest errors is selected. When the commands keep to it, s = u, and all greater
//! a are as good. Then it stays selected.

use super::CONVINCING;
use super::follower::{Errors, Follower};
use super::hypothesis::{Hypothesis, Period};
use crate::Velocity;
use crate::delay::{Delay, Sent};
use crate::main_model::MainModel;
use robot::{PerWheel, Wheels};

/// Rates that are compared \[m/s²\]. The first is no ramp.
const RATES: [f64; 13] =
    [f64::INFINITY, 0.6, 0.72, 0.86, 1.04, 1.24, 1.49, 1.79, 2.15, 2.58, 3.1, 3.72, 4.46];

/// Dead times that are compared with each rate \[periods\].
const DEAD_TIMES: [f64; 4] = [0.0, 1.0, 2.0, 4.0];

/// A ramp is selected when the error of the response that follows is below this share of the error
/// without it.
const CONVINCING_RAMP: f64 = 0.5;

/// Smallest difference of these errors that reveals a ramp \[(m/s)²\].
const EVIDENCE: f64 = 0.02;

/// Time for which a ramp must be better before it is selected \[s\]. For a few periods after a
/// change of the robot, as a motor that fails, anything can be.
const LASTING_S: f64 = 1.0;

/// Time before the first selection \[s\]: the responses must be identified first.
const LEARNING_S: f64 = 2.0;

/// One rate.
#[derive(Debug, Clone, Copy)]
struct Ramp {
    /// a; infinite for no ramp \[m/s²\].
    rate: f64,
    /// s of each wheel \[rad/s\].
    set_points: PerWheel,
    /// J⁺ s̄ of the last periods.
    sent: Sent,
    followers: [Follower; DEAD_TIMES.len()],
}

impl Ramp {
    fn new(rate: f64, main: &MainModel) -> Self {
        Self {
            rate,
            set_points: [0.0; robot::WHEELS_MAX],
            sent: Sent::default(),
            followers: DEAD_TIMES.map(|periods| Follower::new(&Hypothesis::new(main, periods))),
        }
    }

    /// The drive receives `command` for one period.
    fn push(&mut self, command: &Velocity, wheels: &Wheels, period_s: f64) {
        let (goals, mut means) = (wheels.speeds(*command), self.set_points);
        for (wheel, radius) in wheels.radii_m().iter().enumerate() {
            let most = self.rate * period_s / radius;
            let gap = goals[wheel] - self.set_points[wheel];
            let change = gap.clamp(-most, most);
            // The set point changes during this share of the period, and is constant after it.
            let share = (gap.abs() / most).min(1.0);
            means[wheel] += change * (1.0 - 0.5 * share);
            self.set_points[wheel] += change;
        }
        self.sent.push(wheels.body(&means));
    }

    /// Errors of the best of its dead times.
    fn errors(&self) -> Errors {
        Errors::least(&self.followers)
    }

    fn delay(&self) -> Delay {
        let best = self.followers.iter().min_by(|a, b| a.cost().total_cmp(&b.cost()));
        best.map_or(Delay::default(), |follower| follower.hypothesis.delay)
    }
}

/// Compares ramps. Does not allocate.
#[derive(Debug, Clone)]
pub(super) struct Ramps {
    wheels: Wheels,
    period_s: f64,
    candidates: [Ramp; RATES.len()],
    /// Index of the selected one; 0 is no ramp.
    selected: usize,
    /// Number of periods in a row in which another one was better.
    better: u32,
    taken: u32,
}

impl Ramps {
    pub(super) fn new(main: &MainModel, wheels: &Wheels) -> Self {
        Self {
            wheels: *wheels,
            period_s: main.period,
            candidates: RATES.map(|rate| Ramp::new(rate, main)),
            selected: 0,
            better: 0,
            taken: 0,
        }
    }

    /// a, if the drive ramps its command \[m/s²\].
    pub(super) fn rate(&self) -> Option<f64> {
        (self.selected > 0).then(|| self.candidates[self.selected].rate)
    }

    /// The inputs that acted without dead time, if the drive ramps its command.
    pub(super) fn sent(&self) -> Option<&Sent> {
        (self.selected > 0).then(|| &self.candidates[self.selected].sent)
    }

    /// Dead time of the best response with the selected ramp.
    pub(super) fn delay(&self) -> Delay {
        self.candidates[self.selected].delay()
    }

    /// Selects this rate in place of the compared one that is nearest to it.
    pub(super) fn select(&mut self, rate: Option<f64>) {
        self.selected = rate.map_or(0, |rate| {
            let apart = |index: &usize| (self.candidates[*index].rate - rate).abs();
            let nearest =
                (1..RATES.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0);
            self.candidates[nearest].rate = rate;
            nearest
        });
    }

    /// The drive has followed `command` for long.
    pub(super) fn settle(&mut self, command: &Velocity) {
        for ramp in &mut self.candidates {
            (ramp.set_points, ramp.sent) = (self.wheels.speeds(*command), Sent::always(*command));
        }
    }

    /// The drive receives `command` for one period.
    pub(super) fn push(&mut self, command: &Velocity) {
        for ramp in &mut self.candidates {
            ramp.push(command, &self.wheels, self.period_s);
        }
    }

    /// The next period begins with `wheels`.
    pub(super) fn resume(&mut self, wheels: &Velocity) {
        let followers = self.candidates.iter_mut().flat_map(|ramp| &mut ramp.followers);
        followers.for_each(|follower| follower.resume(wheels));
    }

    /// Processes a period of the wheels whose command has been pushed. `without` are the errors of
    /// the best dead time without a ramp, which count while no ramp is selected. Returns whether
    /// a ramp is selected now and was not before, or the other way round.
    pub(super) fn update(&mut self, period: &Period, without: Errors) -> bool {
        self.taken = self.taken.saturating_add(1);
        for ramp in &mut self.candidates {
            for follower in &mut ramp.followers {
                follower.update(period, &ramp.sent.acted(follower.hypothesis.delay).input);
            }
        }
        let errors = self.candidates.each_ref().map(Ramp::errors);
        let (before, best) = (self.selected, least(&errors));
        let present = if before == 0 { errors[0].min(without) } else { errors[before] };
        let is_found = before == 0 && best != 0;
        let [followed, one_step] = if is_found { [CONVINCING_RAMP, CONVINCING] } else { [1.0; 2] };
        // A soft response that follows with a ramp looks better too, but not over one period.
        let is_better = errors[best].followed < followed * present.followed
            && present.followed - errors[best].followed > EVIDENCE
            && errors[best].one_step < one_step * present.one_step;
        self.better = if is_better { self.better + 1 } else { 0 };
        let least_periods = if is_found { (LASTING_S / self.period_s).max(1.0) as u32 } else { 1 };
        if f64::from(self.taken) * self.period_s >= LEARNING_S && self.better >= least_periods {
            self.selected = best;
            self.refine(&errors);
        }
        (before == 0) != (self.selected == 0)
    }

    /// Moves the selected rate to where the parabola through its error and those of its neighbours
    /// is least.
    fn refine(&mut self, errors: &[Errors; RATES.len()]) {
        let at = self.selected;
        let around = at.checked_sub(1).and_then(|before| self.candidates.get(before..at + 2));
        let Some([before, here, after]) = around else { return };
        let (left, right) = (here.rate - before.rate, here.rate - after.rate);
        let of = |index: usize| errors[index].followed;
        let (rise_left, rise_right) = (of(at) - of(at + 1), of(at) - of(at - 1));
        let moved = 0.5 * (left * left * rise_left - right * right * rise_right)
            / (left * rise_left - right * rise_right);
        if moved.is_finite() {
            self.candidates[at].rate = (here.rate - moved).clamp(before.rate, after.rate);
        }
    }
}

/// Index of the rate with the least error. It lies between two others, so it is never the largest
/// one.
fn least(errors: &[Errors; RATES.len()]) -> usize {
    (0..RATES.len() - 1)
        .min_by(|&a, &b| errors[a].followed.total_cmp(&errors[b].followed))
        .unwrap_or(0)
}
