//! Estimates a response: prediction errors of whole stretches are minimised.
//!
//! 1. **Start.** On each axis alone, a grid of dead times and time constants; gain and offset
//!    follow by linear least squares.
//! 2. **Fit.** Levenberg–Marquardt over all parameters of all axes at once, from the best starts.
//!    An error counts in multiples of its axis' own scatter, and linearly where it is large (pseudo
//!    Huber), so that a collision or a slip does not decide.
//!    Once without and once with integral parts, which are kept if they explain the data clearly
//!    better: where there are none, they would make the gain uncertain.
//! 3. **Limits.** A largest acceleration or deceleration is added to an axis where that explains
//!    the data clearly better.
//! 4. **Stiction.** More friction at standstill is added to all axes in the same way.
//! 5. **Intervals.** Errors are correlated in time (a random force acts for a while), so the
//!    covariance is that of Newey and West, 1987: H⁻¹ (Σ_l w_l Σ_k g_k g_{k+l}ᵀ) H⁻¹ with the
//!    gradients g_k of one period, H = JᵀJ and the weights w_l = 1 − l/(L + 1).
//!
//! Drag and dry friction can hardly be told apart at the speeds of one drive, so the drag has a
//! prior: 0 with a standard deviation of 0.01 s/m, which is 1 % of the speed at 1 m/s.
//!
//! The quantile is that of Kiefer and Vogelsang, 2005, for a bandwidth that is a share b of the
//! data: 1.96 + 2.97 b, and the covariance is enlarged for the number of parameters.
//!
//! Levenberg–Marquardt as in Moré, 1978 (crate `levenberg-marquardt`). Prediction over a long
//! horizon: Ljung, *System Identification*, 1999, sections 5.2 and 7.2.

use crate::log::Log;
use crate::parameter::Parameter;
use crate::response::{Response, Simulation};
use crate::start;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn};
use robot::{AXES, Velocity, Wheels};
use std::thread;

/// Error above which it counts linearly, in multiples of the scatter.
const LARGE: f64 = 2.5;
/// Least scatter that counts \[m/s, m/s, rad/s\]: a simulator without noise must not give one axis
/// all the weight.
const SCATTER_MIN: f64 = 5e-4;
/// Time over which errors are about independent \[s\].
const CORRELATED_S: f64 = 0.3;
/// Time after which no correlation is left \[s\].
const UNCORRELATED_S: f64 = 1.0;
/// Half width of a 95 % interval of independent errors, in standard deviations.
const WIDTH_95: f64 = 1.96;
/// Standard deviation of the drag before any data \[s/m\].
const DRAG_PRIOR_S_PER_M: f64 = 0.01;
/// Evaluations per fit, in multiples of the parameters.
const PATIENCE: usize = 30;
/// Share of the cost by which integral parts, a limit of the acceleration, or stiction must lower
/// it.
const WORTH: f64 = 0.05;
/// Samples at the begin of a stretch whose input in the past is not known \[s\].
const PAST_S: f64 = 0.6;

/// A response with its uncertainty.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// The response.
    pub response: Response,
    /// Axes that were moved. The others keep their default.
    pub axes: [bool; AXES],
    /// What was estimated.
    pub parameters: Vec<Estimated>,
    /// Whether the last fit ended at a minimum.
    pub is_converged: bool,
}

/// One parameter with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimated {
    /// Which one.
    pub parameter: Parameter,
    /// Its value.
    pub value: f64,
    /// Half of the 95 % interval.
    pub half_width: f64,
}

impl Estimate {
    /// Value and interval of `parameter`, if it was estimated.
    pub fn of(&self, parameter: Parameter) -> Option<Estimated> {
        self.parameters.iter().copied().find(|estimated| estimated.parameter == parameter)
    }
}

/// Differences of measured and simulated velocity, period by period \[m/s, m/s, rad/s\].
pub fn errors(log: &Log, wheels: &Wheels, response: &Response) -> Vec<Velocity> {
    let simulations = simulations(log, wheels);
    Fit::new(log, &simulations, [true; AXES]).errors(response)
}

fn simulations<'a>(log: &'a Log, wheels: &'a Wheels) -> Vec<Simulation<'a>> {
    let stretches = log.stretches.iter();
    stretches.map(|stretch| Simulation::new(wheels, stretch, log.period_s)).collect()
}

/// Estimates the response of a robot with `wheels` from `log`, on the axes that `axes` name, from
/// the start `near` or from starts of its own. `progress` is told of each step.
pub fn estimate(
    log: &Log,
    wheels: &Wheels,
    axes: [bool; AXES],
    near: Option<&Response>,
    progress: &mut dyn FnMut(&str),
) -> Estimate {
    let simulations = simulations(log, wheels);
    let mut fit = Fit::new(log, &simulations, axes);
    progress("starts");
    let starts = match near {
        Some(near) => [vec![near.plain()], Vec::new()],
        None => [false, true].map(|has_integral| start::starts(log, axes, has_integral)),
    };
    let first = starts[0].first().copied().unwrap_or_default();
    fit.scale = fit.scatter(&first);
    let mut kinds = starts.map(|starts| {
        let has_integral = starts.iter().any(Response::has_integral);
        let parameters = Parameter::of_axes(axes, has_integral);
        let tried = starts.iter().enumerate().map(|(number, start)| {
            progress(&format!("fit {} of {}", number + 1, starts.len()));
            fit.minimise(start, &parameters)
        });
        let best = tried.min_by(|a, b| a.0.total_cmp(&b.0));
        (best.unwrap_or((f64::INFINITY, first, false)), parameters)
    });
    kinds[1].0.0 /= 1.0 - WORTH;
    let [without, with] = kinds;
    let ((_, mut response, _), mut parameters) =
        if with.0.0 < without.0.0 { with } else { without };
    fit.scale = fit.scatter(&response);
    progress("limits of the acceleration");
    let mut cost = fit.minimise(&response, &parameters);
    response = cost.1;
    for limit in limits(axes) {
        let Some(start) = fit.limited(&response, limit, cost.0) else { continue };
        let mut with = parameters.clone();
        with.push(limit);
        let tried = fit.minimise(&start, &with);
        if tried.0 < (1.0 - WORTH) * cost.0 {
            (cost, response, parameters) = (tried, tried.1, with);
        }
    }
    progress("stiction");
    let stuck = (0..AXES).filter(|&axis| axes[axis]).map(Parameter::Stiction);
    let with: Vec<Parameter> = parameters.iter().copied().chain(stuck).collect();
    let tried = fit.minimise(&fit.sticking(&response), &with);
    if tried.0 < (1.0 - WORTH) * cost.0 {
        (response, parameters) = (tried.1, with);
    }
    fit.scale = fit.scatter(&response);
    let last = fit.minimise(&response, &parameters);
    response = last.1;
    progress("intervals");
    let lags = (UNCORRELATED_S / log.period_s).ceil() as usize;
    let half_widths = fit.half_widths(&response, &parameters, lags);
    let estimated = parameters.iter().zip(half_widths).map(|(&parameter, half_width)| Estimated {
        parameter,
        value: parameter.of(&response),
        half_width,
    });
    Estimate { response, axes, parameters: estimated.collect(), is_converged: last.2 }
}

fn limits(axes: [bool; AXES]) -> Vec<Parameter> {
    let moved = (0..AXES).filter(|&axis| axes[axis]);
    moved.flat_map(|axis| [Parameter::Acceleration(axis), Parameter::Braking(axis)]).collect()
}

/// The data of a fit.
struct Fit<'a> {
    simulations: &'a [Simulation<'a>],
    /// Samples at the begin of each stretch that do not count.
    skipped: usize,
    axes: [bool; AXES],
    scale: Velocity,
    /// Number of periods over which errors are correlated.
    correlated: f64,
}

impl<'a> Fit<'a> {
    fn new(log: &Log, simulations: &'a [Simulation<'a>], axes: [bool; AXES]) -> Self {
        let skipped = (PAST_S / log.period_s).ceil() as usize;
        let correlated = (CORRELATED_S / log.period_s).max(1.0);
        Self { simulations, skipped, axes, scale: [1.0; AXES], correlated }
    }

    /// Errors of all moved axes, period by period \[m/s, m/s, rad/s\].
    fn errors(&self, response: &Response) -> Vec<Velocity> {
        let mut errors = Vec::new();
        for simulation in self.simulations {
            let samples = simulation.samples();
            let run = simulation.whole(response).into_iter().map(|motion| motion.velocity);
            let measured = samples.iter().skip(1).map(|sample| sample.velocity);
            let pairs = measured.zip(run).skip(self.skipped);
            errors.extend(pairs.map(|(measured, simulated)| {
                std::array::from_fn(|axis| {
                    if self.axes[axis] { measured[axis] - simulated[axis] } else { 0.0 }
                })
            }));
        }
        errors
    }

    /// Scatter of the errors: 1.48 times their median magnitude.
    fn scatter(&self, response: &Response) -> Velocity {
        let errors = self.errors(response);
        std::array::from_fn(|axis| {
            let mut sizes: Vec<f64> = errors.iter().map(|error| error[axis].abs()).collect();
            sizes.sort_by(f64::total_cmp);
            let median = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
            (1.4826 * median).max(SCATTER_MIN)
        })
    }

    /// Errors as they count, period by period and axis by axis, and last the distance from the
    /// prior.
    fn residuals(&self, response: &Response) -> DVector<f64> {
        let errors = self.errors(response);
        let counted = errors.iter().flat_map(|error| {
            (0..AXES).map(|axis| {
                let error = error[axis] / self.scale[axis];
                let size = error / LARGE;
                let counted = LARGE * (2.0 * ((1.0 + size * size).sqrt() - 1.0)).sqrt();
                // A simulation that diverges must stay a number.
                if counted.is_finite() { counted.copysign(error) } else { 1e6 }
            })
        });
        // One error in so many is independent, and the prior weighs as much as that one.
        let prior = self.correlated.sqrt() * response.drag_s_per_m / DRAG_PRIOR_S_PER_M;
        DVector::from_iterator(errors.len() * AXES + 1, counted.chain([prior]))
    }

    /// The least cost near `start`, its response, and whether it is a minimum.
    fn minimise(&self, start: &Response, parameters: &[Parameter]) -> (f64, Response, bool) {
        let free = parameters.iter().map(|parameter| parameter.free(start));
        let problem = Problem {
            fit: self,
            parameters,
            base: *start,
            free: DVector::from_iterator(parameters.len(), free),
        };
        let method =
            LevenbergMarquardt::new().with_ftol(1e-7).with_xtol(1e-7).with_patience(PATIENCE);
        let (problem, report) = method.minimize(problem);
        (report.objective_function, problem.response(), report.termination.was_successful())
    }

    /// A start with `limit`, if one explains the data better than `cost` before any fit: a limited
    /// axis looks slower than it is.
    fn limited(&self, response: &Response, limit: Parameter, cost: f64) -> Option<Response> {
        let (Parameter::Acceleration(axis) | Parameter::Braking(axis)) = limit else { return None };
        let reached = self.reached(response, limit);
        let mut best = (cost, None);
        for share in [0.85, 0.6, 0.4] {
            for faster in [1.0, 0.6, 0.3] {
                let mut start = *response;
                start.time_constant_s[axis] *= faster;
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

    /// Largest acceleration or deceleration that `response` shows on an axis.
    fn reached(&self, response: &Response, limit: Parameter) -> f64 {
        let mut largest: f64 = 1e-3;
        for simulation in self.simulations {
            let run = simulation.whole(response);
            let period = simulation.period_s();
            for pair in run.windows(2) {
                let (axis, speeds_up) = match limit {
                    Parameter::Acceleration(axis) => (axis, true),
                    Parameter::Braking(axis) => (axis, false),
                    _ => continue,
                };
                let [before, after] = [0, 1].map(|number: usize| pair[number].velocity[axis]);
                let change = after - before;
                if (change * before >= 0.0) == speeds_up {
                    largest = largest.max(change.abs() / period);
                }
            }
        }
        largest
    }

    /// Half of the 95 % interval of each parameter; infinite if the data do not tell it.
    fn half_widths(&self, response: &Response, parameters: &[Parameter], lags: usize) -> Vec<f64> {
        let free = parameters.iter().map(|parameter| parameter.free(response));
        let problem = Problem {
            fit: self,
            parameters,
            base: *response,
            free: DVector::from_iterator(parameters.len(), free),
        };
        let (jacobian, residuals) = (problem.derivatives(), self.residuals(response));
        // A parameter without any effect has no interval, and must not spoil the others'.
        let live: Vec<usize> =
            (0..parameters.len()).filter(|&index| jacobian.column(index).norm() > 0.0).collect();
        let deviations = self.deviations(&jacobian.select_columns(&live), &residuals, lags);
        let mut half_widths = vec![f64::INFINITY; parameters.len()];
        for (&index, deviation) in live.iter().zip(deviations) {
            half_widths[index] = deviation * parameters[index].slope(response);
        }
        half_widths
    }

    /// Half of the 95 % interval of each free number; infinite if the data do not tell it.
    fn deviations(
        &self,
        jacobian: &DMatrix<f64>,
        residuals: &DVector<f64>,
        lags: usize,
    ) -> Vec<f64> {
        let count = jacobian.ncols();
        // The last row is that of the prior.
        let last = residuals.len() - 1;
        let periods = last / AXES;
        // g_k, one row per period.
        let mut gradients = DMatrix::zeros(periods, count);
        for period in 0..periods {
            for axis in 0..AXES {
                let row = period * AXES + axis;
                for column in 0..count {
                    gradients[(period, column)] += jacobian[(row, column)] * residuals[row];
                }
            }
        }
        let mut middle = gradients.tr_mul(&gradients);
        for lag in 1..=lags.min(periods.saturating_sub(1)) {
            let weight = 1.0 - lag as f64 / (lags + 1) as f64;
            let early = gradients.rows(0, periods - lag);
            let late = gradients.rows(lag, periods - lag);
            let product = early.tr_mul(&late);
            middle += weight * (&product + product.transpose());
        }
        let prior = jacobian.row(last);
        middle += self.correlated * prior.tr_mul(&prior);
        // In units of each column, so that the inverse is well conditioned.
        let norms: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let mut scaled = jacobian.clone();
        for (mut column, norm) in scaled.column_iter_mut().zip(&norms) {
            column /= *norm;
        }
        let Some(inverse) = scaled.tr_mul(&scaled).try_inverse() else {
            return vec![f64::INFINITY; count];
        };
        for row in 0..count {
            for column in 0..count {
                middle[(row, column)] /= norms[row] * norms[column];
            }
        }
        let covariance = &inverse * middle * &inverse;
        let independent = last as f64 / self.correlated;
        let enlarged = independent / (independent - count as f64).max(1.0);
        let bandwidth = lags as f64 / periods.max(1) as f64;
        let quantile = enlarged.sqrt() * (WIDTH_95 + 2.97 * bandwidth);
        (0..count)
            .map(|index| {
                let variance = covariance[(index, index)];
                // A variance that is none is one that the data do not tell.
                if variance > 0.0 {
                    quantile * variance.sqrt() / norms[index]
                } else {
                    f64::INFINITY
                }
            })
            .collect()
    }
}

/// A fit as a least-squares problem.
#[derive(Clone)]
struct Problem<'a> {
    fit: &'a Fit<'a>,
    parameters: &'a [Parameter],
    base: Response,
    free: DVector<f64>,
}

impl Problem<'_> {
    fn response(&self) -> Response {
        self.response_at(&self.free)
    }

    fn response_at(&self, free: &DVector<f64>) -> Response {
        let mut response = self.base;
        for (parameter, &value) in self.parameters.iter().zip(free.iter()) {
            parameter.set(&mut response, value);
        }
        response
    }

    /// Derivatives of the residuals by the free numbers, by central differences.
    fn derivatives(&self) -> DMatrix<f64> {
        let column = |index: usize| {
            let step = self.parameters[index].step();
            let at = |change: f64| {
                let mut free = self.free.clone();
                free[index] += change;
                self.fit.residuals(&self.response_at(&free))
            };
            (at(step) - at(-step)) / (2.0 * step)
        };
        let count = self.parameters.len();
        let threads = thread::available_parallelism().map_or(1, usize::from).min(count.max(1));
        let columns: Vec<Vec<DVector<f64>>> = thread::scope(|scope| {
            let parts: Vec<_> = (0..threads)
                .map(|part| {
                    scope.spawn(move || (part..count).step_by(threads).map(column).collect())
                })
                .collect();
            parts.into_iter().map(|part| part.join().unwrap_or_default()).collect()
        });
        let rows = columns.iter().flatten().map(DVector::len).max().unwrap_or(0);
        let mut matrix = DMatrix::zeros(rows, count);
        for (part, columns) in columns.iter().enumerate() {
            for (number, column) in columns.iter().enumerate() {
                matrix.set_column(part + number * threads, column);
            }
        }
        matrix
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, free: &DVector<f64>) {
        self.free.copy_from(free);
    }

    fn params(&self) -> DVector<f64> {
        self.free.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        Some(self.fit.residuals(&self.response()))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        Some(self.derivatives())
    }
}
