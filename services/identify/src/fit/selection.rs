//! Which limits, and whether stiction, explain the data clearly better.

use super::{COMPARED, Fit, Found, WORTH};
use crate::parameter::Parameter;
use crate::response::{Response, Simulation};
use robot::AXES;

/// Share of the cost by which a limit must lower it, which acts for a small share of the time.
const WORTH_OF_LIMIT: f64 = 0.01;

impl Fit<'_> {
    /// `found` with those limits that explain the data clearly better.
    pub(super) fn with_limits(&self, mut found: Found) -> Found {
        let moved = (0..AXES).filter(|&axis| self.axes[axis]);
        let of_axes =
            moved.flat_map(|axis| [Parameter::Acceleration(axis), Parameter::Braking(axis)]);
        for limit in std::iter::once(Parameter::Saturation).chain(of_axes) {
            let Some(start) = self.limited(&found.response, limit, found.cost) else { continue };
            let mut with = found.parameters.clone();
            with.push(limit);
            let tried = self.minimise(&start, with, COMPARED);
            if tried.cost < (1.0 - WORTH_OF_LIMIT) * found.cost {
                found = tried;
            }
        }
        found
    }

    /// `found` with stiction on all axes, if that explains the data clearly better.
    pub(super) fn with_stiction(&self, found: Found) -> Found {
        let stuck = (0..AXES).filter(|&axis| self.axes[axis]).map(Parameter::Stiction);
        let with = found.parameters.iter().copied().chain(stuck).collect();
        let tried = self.minimise(&self.sticking(&found.response), with, COMPARED);
        if tried.cost < (1.0 - WORTH) * found.cost { tried } else { found }
    }

    /// A start with `limit`, if one explains the data better than `cost` before any fit: a limited
    /// axis looks slower than it is.
    fn limited(&self, response: &Response, limit: Parameter, cost: f64) -> Option<Response> {
        let reached = self.reached(response, limit);
        let is_limited = |axis: usize| match limit {
            Parameter::Acceleration(limited) | Parameter::Braking(limited) => axis == limited,
            _ => true,
        };
        let mut best = (cost, None);
        for share in [0.95, 0.85, 0.6, 0.4] {
            for faster in [1.0, 0.6, 0.3] {
                let mut start = *response;
                for axis in (0..AXES).filter(|&axis| is_limited(axis)) {
                    start.time_constant_s[axis] *= faster;
                }
                limit.set(&mut start, (share * reached).ln());
                let found = 0.5 * self.residuals(&start).norm_squared();
                if found < best.0 {
                    best = (found, Some(start));
                }
            }
        }
        best.1
    }

    /// The best start with stiction, in multiples of the dry friction.
    fn sticking(&self, response: &Response) -> Response {
        let starts = [0.5, 1.5, 3.0].map(|factor| Response {
            stiction: std::array::from_fn(|axis| {
                if self.axes[axis] { factor * response.friction[axis].max(0.01) } else { 0.0 }
            }),
            ..*response
        });
        let cost = |start: &Response| self.residuals(start).norm_squared();
        let best = starts.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)));
        best.unwrap_or(*response)
    }

    /// The largest of what `limit` limits that `response` shows.
    fn reached(&self, response: &Response, limit: Parameter) -> f64 {
        let of_stretch = |simulation: &Simulation<'_>| {
            let (axis, speeds_up) = match limit {
                Parameter::Acceleration(axis) => (axis, true),
                Parameter::Braking(axis) => (axis, false),
                _ => return simulation.most_behind_mps(response),
            };
            let run = simulation.whole(response);
            let changes = run.windows(2).filter_map(|pair| {
                let [before, after] = [0, 1].map(|number: usize| pair[number].velocity[axis]);
                let change = after - before;
                ((change * before >= 0.0) == speeds_up).then_some(change.abs())
            });
            changes.fold(0.0, f64::max) / simulation.period_s()
        };
        self.simulations.iter().map(of_stretch).fold(1e-3, f64::max)
    }
}
