//! The dead time of the drives, from the speeds of the wheels.
//!
//! A body velocity is noisy, and a body slides away from its wheels. Prediction by one period tells
//! little of a dead time in noise, because A and B explain most of what another dead time changes.
//! So the response of each dead time also follows the wheels, and is only drawn to them slowly:
//!
//! ```text
//! w = J⁺ r ω      e = w⁺ − (A x + B u_δ + c + t)      x⁺ = w⁺ − e^{−T/τ} e      τ = 0.15 s
//! ```
//! x is that of a Luenberger observer with a small gain. The error of a wrong dead time adds up in
//! it, and noise does not. The dead time with the smallest e² is proposed. A, B and c are
//! identified from the wheels by the same least squares as those of the body.

use super::hypothesis::{DEAD_TIMES, Hypotheses, Hypothesis, Period, better};
use super::{FRAMES, PERIODS_LEAST, turning};
use crate::delay::Sent;
use crate::main_model::MainModel;
use crate::{AXES, Velocity};

/// τ \[s\].
const FOLLOWING_S: f64 = 0.15;

/// Largest |e| of a response that follows \[m/s\]. Beyond, it begins anew at the wheels.
const LOST_MPS: f64 = 10.0;

/// Proposes a dead time. Does not allocate.
#[derive(Debug, Clone)]
pub(super) struct ByWheels {
    hypotheses: Hypotheses,
    /// x, without t and with it \[m/s, m/s, rad/s\].
    followed: [[Velocity; FRAMES]; DEAD_TIMES.len()],
    /// Sum of e² with forgetting, without t and with it \[(m/s)²\].
    costs: [[f64; FRAMES]; DEAD_TIMES.len()],
    /// Index of the proposed dead time.
    proposed: usize,
    /// w at the end of the last period.
    before: Option<Velocity>,
    taken: u32,
}

impl ByWheels {
    /// Begins with `main` and no dead time.
    pub(super) fn new(main: &MainModel) -> Self {
        Self {
            hypotheses: Hypothesis::all(main),
            followed: [[[0.0; AXES]; FRAMES]; DEAD_TIMES.len()],
            costs: [[0.0; FRAMES]; DEAD_TIMES.len()],
            proposed: 0,
            before: None,
            taken: 0,
        }
    }

    /// Begins with these responses and their costs, and with this dead time.
    pub(super) fn begin_with(&mut self, hypotheses: &Hypotheses, proposed: usize) {
        self.hypotheses.copy_from_slice(hypotheses);
        self.costs = [[0.0; FRAMES]; DEAD_TIMES.len()];
        (self.proposed, self.before, self.taken) = (proposed, None, 0);
    }

    /// The next period begins with `wheels`, if they are measured.
    pub(super) fn resume(&mut self, wheels: Option<&Velocity>) {
        self.before = wheels.copied();
        if let Some(wheels) = wheels {
            self.followed = [[*wheels; FRAMES]; DEAD_TIMES.len()];
        }
    }

    /// Processes the period that has just ended with w = `wheels`; its command is the newest of
    /// `sent`. Returns the proposed dead time, once there is one.
    pub(super) fn update(
        &mut self,
        main: &MainModel,
        sent: &Sent,
        wheels: &Velocity,
        scale: Velocity,
        forgetting: f64,
    ) -> Option<usize> {
        let Some(before) = self.before.replace(*wheels) else {
            self.resume(Some(wheels));
            return None;
        };
        self.taken = self.taken.saturating_add(1);
        let turning = turning(main, &before).mean;
        let period = Period { before, after: *wheels, turning, forgetting, scale };
        let kept = (-main.period / FOLLOWING_S).exp();
        for ((hypothesis, followed), costs) in
            self.hypotheses.iter_mut().zip(&mut self.followed).zip(&mut self.costs)
        {
            let acted = sent.acted(hypothesis.delay);
            let mut errors = [[0.0; AXES]; FRAMES];
            for (frame, followed) in followed.iter_mut().enumerate() {
                for axis in 0..AXES {
                    let of = hypothesis.fits[axis].first_order(frame);
                    let turned = if frame == 0 { 0.0 } else { turning[axis] };
                    let next =
                        of.decay * followed[axis] + of.gain * acted[axis] + of.offset + turned;
                    let error = wheels[axis] - next;
                    errors[frame][axis] = error;
                    let kept = if error.abs() < LOST_MPS { kept } else { 0.0 };
                    followed[axis] = wheels[axis] - kept * error;
                }
            }
            period.add(costs, &errors);
            hypothesis.update(&period, &acted);
        }
        let (hypotheses, costs) = (&self.hypotheses, &self.costs);
        let present = hypotheses[self.proposed].cost();
        let usable =
            |index: usize| hypotheses[index].believable() && hypotheses[index].cost() <= present;
        let cost = |index: usize| costs[index][hypotheses[index].frame()];
        if self.taken >= PERIODS_LEAST {
            self.proposed = better(self.proposed, usable, cost).unwrap_or(self.proposed);
        }
        (self.taken >= PERIODS_LEAST).then_some(self.proposed)
    }
}
