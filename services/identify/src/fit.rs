//! Estimates a response: prediction errors of whole stretches are minimised.
//!
//! 1. **Start.** On each axis alone, a grid of dead times and time constants; gain and offset
//!    follow by linear least squares.
//! 2. **Fit.** Levenberg–Marquardt over all parameters of all axes at once, from the best starts.
//!    An error counts in multiples of its axis' own scatter, and linearly where it is large (pseudo
//!    Huber), so that a collision or a slip does not decide.
//!    Once without and once with integral parts, which are kept if they explain the data clearly
//!    better: where there are none, they would make the gain uncertain.
//! 3. **Stiction.** More friction at standstill is added to all axes where it explains the data
//!    clearly better. In the end stiction and integral parts are left out on axes whose interval
//!    does not exclude that there are none.
//! 4. **Noise.** A random force acts for a while, so errors are correlated in time. From here on,
//!    the mean errors of a tenth of a second count, and of them what is new (module `noise`).
//!    Faster errors are the sensor's noise, and what the response leaves out.
//! 5. **Limits.** The saturation of the drives, and a largest acceleration or deceleration of an
//!    axis are added in the same way as stiction. Then follows the last fit.
//! 6. **Intervals** are those of a fit of all errors as they are. They are a little wider than
//!    those of the last fit, which leave out how forces act on the friction. The covariance is that
//!    of Newey and West, 1987, as errors are correlated: H⁻¹ (Σ_l w_l Σ_k g_k g_{k+l}ᵀ) H⁻¹ with
//!    the gradients g_k of one period, H = JᵀJ and the weights w_l = 1 − l/(L + 1).
//!
//! Drag and dry friction can hardly be told apart at the speeds of one drive, so the drag has a
//! prior: 0 with a standard deviation of 0.01 s/m, which is 1 % of the speed at 1 m/s.
//!
//! The quantile is that of Kiefer and Vogelsang, 2005, for a bandwidth that is a share b of the
//! data: 1.96 + 2.97 b, and the covariance is enlarged for the number of parameters.
//!
//! Levenberg–Marquardt as in Moré, 1978 (crate `levenberg-marquardt`). Prediction over a long
//! horizon: Ljung, *System Identification*, 1999, sections 5.2 and 7.2.

mod intervals;
mod noise;
mod problem;
mod selection;

use crate::log::{Log, Sample};
use crate::parameter::Parameter;
use crate::response::{Motion, Response, Simulation};
use crate::sensors::Measured;
use crate::start;
use levenberg_marquardt::LevenbergMarquardt;
use nalgebra::{DMatrix, DVector};
use noise::Noise;
use problem::Problem;
use robot::{AXES, Velocity, Wheels};

/// Error above which it counts linearly, in multiples of the scatter.
const LARGE: f64 = 2.5;
/// Least scatter that counts \[m/s, m/s, rad/s\]: a simulator without noise must not give one axis
/// all the weight.
const SCATTER_MIN: f64 = 5e-4;
/// Time over which errors are about independent \[s\].
const CORRELATED_S: f64 = 0.3;
/// Time after which no correlation is left \[s\].
const UNCORRELATED_S: f64 = 1.0;
/// Standard deviation of the drag before any data \[s/m\].
const DRAG_PRIOR_S_PER_M: f64 = 0.01;
/// Share of cost and parameters within which the last fit ends.
const EXACT: f64 = 1e-7;
/// The same of a fit that is compared with others.
const COMPARED: f64 = 1e-4;
/// Evaluations per fit, in multiples of the parameters.
const PATIENCE: usize = 30;
/// Share of the cost by which integral parts or stiction must lower it.
const WORTH: f64 = 0.05;
/// Time over which errors are averaged in the last fit \[s\].
const BLOCK_S: f64 = 0.1;
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
    /// Their covariance, so scaled that its diagonal has the squares of their half widths.
    pub covariance: DMatrix<f64>,
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

    /// Σ w p over parameters p and their weights w, with its interval, if all were estimated.
    pub fn sum(&self, terms: &[(Parameter, f64)]) -> Option<Measured> {
        let (mut value, mut variance) = (0.0, 0.0);
        let places: Option<Vec<usize>> = terms.iter().map(|(it, _)| self.place(*it)).collect();
        let places = places?;
        for ((_, weight), &row) in terms.iter().zip(&places) {
            value += weight * self.parameters[row].value;
            for ((_, other), &column) in terms.iter().zip(&places) {
                variance += weight * other * self.covariance[(row, column)];
            }
        }
        Some(Measured { value, half_width: variance.max(0.0).sqrt() })
    }

    fn place(&self, parameter: Parameter) -> Option<usize> {
        self.parameters.iter().position(|estimated| estimated.parameter == parameter)
    }
}

/// A measurement beside the simulated velocity at the same time \[m/s, m/s, rad/s\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beside {
    /// The measurement.
    pub sample: Sample,
    /// The velocity of the simulation, which follows from the inputs alone.
    pub simulated: Velocity,
}

/// The samples of each stretch of `log` beside a simulation of `response`, without the begin of the
/// stretch, whose inputs in the past are not known.
pub fn beside(log: &Log, wheels: &Wheels, response: &Response) -> Vec<Vec<Beside>> {
    let skipped = skipped(log);
    let both = simulations(log, wheels).into_iter().map(|simulation| {
        let run = simulation.whole(response).into_iter().map(|motion| motion.velocity);
        let pairs = simulation.samples().iter().skip(1).zip(run).skip(skipped);
        pairs.map(|(&sample, simulated)| Beside { sample, simulated }).collect()
    });
    both.collect()
}

/// Samples at the begin of a stretch that do not count.
fn skipped(log: &Log) -> usize {
    (PAST_S / log.period_s).ceil() as usize
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
    let lags = (UNCORRELATED_S / log.period_s).ceil() as usize;
    progress("starts");
    let starts = match near {
        Some(near) => [vec![near.plain()], Vec::new()],
        None => [false, true].map(|has_integral| start::starts(log, axes, has_integral)),
    };
    let mut found = fit.best_of(starts, progress);
    fit.scale = fit.scatter(&found.response);
    progress("stiction");
    found = fit.with_stiction(fit.minimise(&found.response, found.parameters, COMPARED));
    fit.whiten(&found.response);
    progress("limits");
    found = fit.with_limits(fit.minimise(&found.response, found.parameters, COMPARED));
    progress("intervals");
    let covariance = loop {
        fit.whiten(&found.response);
        found = fit.minimise(&found.response, found.parameters, EXACT);
        fit.count_all(&found.response);
        let covariance = fit.covariance(&found.response, &found.parameters, lags);
        if !found.leave_out_absent(&covariance) {
            break covariance;
        }
    };
    found.estimate(axes, covariance)
}

/// Where a fit ended.
#[derive(Debug, Clone)]
struct Found {
    cost: f64,
    response: Response,
    /// What was free.
    parameters: Vec<Parameter>,
    /// Whether it is a minimum.
    is_converged: bool,
}

impl Found {
    /// Leaves out stiction and integral parts that are not above 0 by more than their interval; an
    /// axis without integral part has an offset. Whether there were any.
    fn leave_out_absent(&mut self, covariance: &DMatrix<f64>) -> bool {
        let mut is_any = false;
        for (index, parameter) in std::mem::take(&mut self.parameters).into_iter().enumerate() {
            let may_be_absent =
                matches!(parameter, Parameter::Stiction(_) | Parameter::Integral(_));
            let width = covariance[(index, index)].sqrt();
            if !may_be_absent || parameter.of(&self.response) > width {
                self.parameters.push(parameter);
                continue;
            }
            is_any = true;
            parameter.set(&mut self.response, 0.0);
            if let Parameter::Integral(axis) = parameter {
                self.parameters.push(Parameter::Offset(axis));
            }
        }
        is_any
    }

    fn estimate(self, axes: [bool; AXES], covariance: DMatrix<f64>) -> Estimate {
        let Self { response, parameters, is_converged, .. } = self;
        let estimated = parameters.iter().enumerate().map(|(index, &parameter)| Estimated {
            parameter,
            value: parameter.of(&response),
            half_width: covariance[(index, index)].sqrt(),
        });
        let parameters = estimated.collect();
        Estimate { response, axes, parameters, covariance, is_converged }
    }
}

/// The data of a fit.
struct Fit<'a> {
    simulations: &'a [Simulation<'a>],
    period_s: f64,
    /// Samples at the begin of each stretch that do not count.
    skipped: usize,
    axes: [bool; AXES],
    scale: Velocity,
    /// Periods of which the mean error counts.
    block: usize,
    noise: [Noise; AXES],
    /// Number of periods over which what counts is correlated.
    correlated: f64,
}

impl<'a> Fit<'a> {
    fn new(log: &Log, simulations: &'a [Simulation<'a>], axes: [bool; AXES]) -> Self {
        Self {
            simulations,
            period_s: log.period_s,
            skipped: skipped(log),
            axes,
            scale: [1.0; AXES],
            block: 1,
            noise: [noise::WHITE; AXES],
            correlated: (CORRELATED_S / log.period_s).max(1.0),
        }
    }

    /// Mean errors of each block, of each stretch and axis; 0 on an axis that is not moved
    /// \[m/s, m/s, rad/s\].
    fn errors(&self, response: &Response) -> Vec<[Vec<f64>; AXES]> {
        let of_stretch = |simulation: &Simulation<'_>| {
            let run = simulation.whole(response);
            let measured = simulation.samples().iter().skip(1);
            let pairs = || measured.clone().zip(&run).skip(self.skipped);
            std::array::from_fn(|axis| {
                let error = |(sample, motion): (&Sample, &Motion)| {
                    if self.axes[axis] {
                        sample.velocity[axis] - motion.velocity[axis]
                    } else {
                        0.0
                    }
                };
                let errors: Vec<f64> = pairs().map(error).collect();
                let blocks = errors.chunks_exact(self.block);
                blocks.map(|block| block.iter().sum::<f64>() / self.block as f64).collect()
            })
        };
        self.simulations.iter().map(of_stretch).collect()
    }

    /// What is new in the errors of each block \[m/s, m/s, rad/s\].
    fn innovations(&self, response: &Response) -> Vec<Velocity> {
        let mut all = Vec::new();
        for errors in self.errors(response) {
            let mut axis = 0..AXES;
            let [mut ahead, mut side, mut yaw] = errors.map(|errors| {
                let noise = axis.next().map_or(noise::WHITE, |axis| self.noise[axis]);
                noise.innovations(errors.into_iter())
            });
            while let (Some(ahead), Some(side), Some(yaw)) = (ahead.next(), side.next(), yaw.next())
            {
                all.push([ahead, side, yaw]);
            }
        }
        all
    }

    /// Scatter of what is new in the errors: 1.48 times its median magnitude.
    fn scatter(&self, response: &Response) -> Velocity {
        let errors = self.innovations(response);
        std::array::from_fn(|axis| {
            let mut sizes: Vec<f64> = errors.iter().map(|error| error[axis].abs()).collect();
            sizes.sort_by(f64::total_cmp);
            let median = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
            (1.4826 * median).max(SCATTER_MIN)
        })
    }

    /// From now on what is new in the mean errors of blocks counts, as it is with `response`.
    fn whiten(&mut self, response: &Response) {
        self.block = ((BLOCK_S / self.period_s).round() as usize).max(1);
        self.noise = [noise::WHITE; AXES];
        self.scale = self.scatter(response);
        let errors = self.errors(response);
        self.noise = std::array::from_fn(|axis| {
            let stretches = errors.iter().map(|errors| &errors[axis][..]);
            Noise::of(stretches, LARGE * self.scale[axis])
        });
        self.scale = self.scatter(response);
        self.correlated = 1.0;
    }

    /// From now on every error counts as it is.
    fn count_all(&mut self, response: &Response) {
        self.block = 1;
        self.noise = [noise::WHITE; AXES];
        self.scale = self.scatter(response);
        self.correlated = (CORRELATED_S / self.period_s).max(1.0);
    }

    /// Errors as they count, period by period and axis by axis, and last the distance from the
    /// prior.
    fn residuals(&self, response: &Response) -> DVector<f64> {
        let errors = self.innovations(response);
        let counted = errors.iter().flat_map(|error| {
            (0..AXES).map(|axis| {
                let error = error[axis] / self.scale[axis];
                let size = error / LARGE;
                let counted = error * (2.0 / (1.0 + (1.0 + size * size).sqrt())).sqrt();
                // A simulation that diverges must stay a number.
                if counted.is_finite() { counted } else { 1e6 }
            })
        });
        // One error in so many is independent, and the prior weighs as much as that one.
        let prior = self.correlated.sqrt() * response.drag_s_per_m / DRAG_PRIOR_S_PER_M;
        DVector::from_iterator(errors.len() * AXES + 1, counted.chain([prior]))
    }

    /// The least cost near `start`, to so small a share of cost and parameters.
    fn minimise(&self, start: &Response, parameters: Vec<Parameter>, share: f64) -> Found {
        let problem = Problem::new(self, start, &parameters);
        let method =
            LevenbergMarquardt::new().with_ftol(share).with_xtol(share).with_patience(PATIENCE);
        let (problem, report) = method.minimize(problem);
        let (cost, response) = (report.objective_function, problem.response());
        let is_converged = report.termination.was_successful();
        Found { cost, response, parameters, is_converged }
    }

    /// The best fit from starts without and with integral parts.
    fn best_of(&mut self, starts: [Vec<Response>; 2], progress: &mut dyn FnMut(&str)) -> Found {
        let first = starts[0].first().copied().unwrap_or_default();
        self.scale = self.scatter(&first);
        let [without, with] = starts.map(|starts| {
            let has_integral = starts.iter().any(Response::has_integral);
            let parameters = Parameter::of_axes(self.axes, has_integral);
            let tried = starts.iter().enumerate().map(|(number, start)| {
                progress(&format!("fit {} of {}", number + 1, starts.len()));
                self.minimise(start, parameters.clone(), COMPARED)
            });
            tried.min_by(|a, b| a.cost.total_cmp(&b.cost))
        });
        match (without, with) {
            (Some(without), Some(with)) if with.cost < (1.0 - WORTH) * without.cost => with,
            (Some(found), _) | (None, Some(found)) => found,
            (None, None) => self.minimise(&first, Parameter::of_axes(self.axes, false), COMPARED),
        }
    }
}
