//! The learned residual as the controller uses it: layout of the inputs, normalisation (eq. 36),
//! posterior, and a physical bound.
//!
//! Predictions use the whole mean. Linearisations use only the slope of the kernel's linear part.
//! The squared-exponential part is right where there is data. Its slope is steep where old and new
//! data disagree, and a plan that follows such a slope is wrong.

use crate::gp::kernel::PLACE_INPUTS;
use crate::gp::normalisation::Normalisation;
use crate::gp::posterior::{Posterior, VarianceScratch};
use crate::{AXES, State, Velocity};
use serde::{Deserialize, Serialize};

/// Number of inputs of the Gaussian processes without history or heading.
pub const INPUTS: usize = 6;

/// Number of inputs with history.
pub const INPUTS_WITH_HISTORY: usize = 9;

/// Number of inputs with the heading.
pub const INPUTS_WITH_HEADING: usize = 8;

/// Number of inputs with the place.
pub const INPUTS_WITH_PLACE: usize = INPUTS + PLACE_INPUTS;

/// One period as the Gaussian processes see it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moment {
    /// v: velocity at its start \[m/s, m/s, rad/s\].
    pub velocity: Velocity,
    /// u: input that acts in it \[m/s, m/s, rad/s\].
    pub input: Velocity,
    /// u₋: input that acted in the period before \[m/s, m/s, rad/s\].
    pub before: Velocity,
    /// θ: heading at its start \[rad\].
    pub heading: f64,
    /// (x, y): position at its start, in the world \[m\].
    pub position: [f64; 2],
}

impl Moment {
    /// The period that begins with `state`, under `input`.
    pub fn new(state: &State, input: &Velocity) -> Self {
        let State { pose: [x, y, heading], velocity, acted } = *state;
        Self { velocity, input: *input, before: acted, heading, position: [x, y] }
    }
}

/// What the Gaussian processes see of a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// (v, u): that of the paper.
    VelocityInput,
    /// (v, u − v): the slip between command and motion has axes of its own. This suits a kernel
    /// with one length scale per axis.
    VelocitySlip,
    /// (v, u − v, u₋ − v): with the input of the previous period, for motors whose response lasts
    /// longer than a period.
    VelocitySlipHistory,
    /// (v, u − v, cos θ, sin θ): a force that is fixed in the world, such as that of a sloping
    /// floor, is linear in the last two. Do not use it where wheels slip: there the heading varies
    /// with the residual and is taken for its cause.
    VelocitySlipHeading,
    /// (v, u − v) and the place (x, y, cos θ, sin θ), whose effect is added by a part of its own of
    /// the kernel: what the floor does at a place is learned from one lap for the next. For robots
    /// that come back to the same places, whose pose does not drift. It needs a kernel with a
    /// linear part.
    VelocitySlipPlace,
}

impl Layout {
    /// All layouts.
    pub const ALL: [Self; 5] = [
        Self::VelocityInput,
        Self::VelocitySlip,
        Self::VelocitySlipHistory,
        Self::VelocitySlipHeading,
        Self::VelocitySlipPlace,
    ];

    /// Name in settings and fingerprints.
    pub const fn name(self) -> &'static str {
        match self {
            Self::VelocityInput => "velocity-input",
            Self::VelocitySlip => "velocity-slip",
            Self::VelocitySlipHistory => "velocity-slip-history",
            Self::VelocitySlipHeading => "velocity-slip-heading",
            Self::VelocitySlipPlace => "velocity-slip-place",
        }
    }

    /// Number of inputs.
    pub const fn dimension(self) -> usize {
        match self {
            Self::VelocityInput | Self::VelocitySlip => INPUTS,
            Self::VelocitySlipHistory => INPUTS_WITH_HISTORY,
            Self::VelocitySlipHeading => INPUTS_WITH_HEADING,
            Self::VelocitySlipPlace => INPUTS_WITH_PLACE,
        }
    }

    /// Whether the last inputs are the place.
    pub const fn has_place(self) -> bool {
        matches!(self, Self::VelocitySlipPlace)
    }

    /// The first D inputs of the Gaussian processes, not normalised; zero beyond
    /// [`dimension`](Self::dimension).
    pub fn inputs<const D: usize>(self, at: &Moment) -> [f64; D] {
        std::array::from_fn(|i| {
            let (part, axis) = (i / AXES, i % AXES);
            let velocity = at.velocity[axis];
            match (self, part) {
                (_, 0) => velocity,
                (Self::VelocityInput, 1) => at.input[axis],
                (_, 1) => at.input[axis] - velocity,
                (Self::VelocitySlipHistory, 2) => at.before[axis] - velocity,
                (Self::VelocitySlipHeading, 2) if axis == 0 => at.heading.cos(),
                (Self::VelocitySlipHeading, 2) if axis == 1 => at.heading.sin(),
                (Self::VelocitySlipPlace, 2) if axis < 2 => at.position[axis],
                (Self::VelocitySlipPlace, 2) => at.heading.cos(),
                (Self::VelocitySlipPlace, 3) if axis == 0 => at.heading.sin(),
                _ => 0.0,
            }
        })
    }

    /// The period with these inputs, which are not normalised: the inverse of
    /// [`inputs`](Self::inputs). What the layout does not have is zero.
    pub fn moment<const D: usize>(self, inputs: &[f64; D]) -> Moment {
        let input =
            |part: usize, axis: usize| inputs.get(part * AXES + axis).copied().unwrap_or(0.0);
        let velocity: Velocity = std::array::from_fn(|axis| input(0, axis));
        let beyond = |part| std::array::from_fn(|axis| velocity[axis] + input(part, axis));
        Moment {
            velocity,
            input: match self {
                Self::VelocityInput => std::array::from_fn(|axis| input(1, axis)),
                _ => beyond(1),
            },
            before: match self {
                Self::VelocitySlipHistory => beyond(2),
                _ => [0.0; AXES],
            },
            heading: match self {
                Self::VelocitySlipHeading => input(2, 1).atan2(input(2, 0)),
                Self::VelocitySlipPlace => input(3, 0).atan2(input(2, 2)),
                _ => 0.0,
            },
            position: match self {
                Self::VelocitySlipPlace => [input(2, 0), input(2, 1)],
                _ => [0.0; 2],
            },
        }
    }
}

/// g with its Jacobians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// g \[m/s, m/s, rad/s\].
    pub mean: Velocity,
    /// ∂g/∂v, one row per axis of g.
    pub by_velocity: [Velocity; 3],
    /// ∂g/∂u, one row per axis of g.
    pub by_input: [Velocity; 3],
    /// ∂g/∂u₋, one row per axis of g.
    pub by_before: [Velocity; 3],
}

impl Response {
    /// No residual.
    pub const NONE: Self = Self {
        mean: [0.0; 3],
        by_velocity: [[0.0; 3]; 3],
        by_input: [[0.0; 3]; 3],
        by_before: [[0.0; 3]; 3],
    };
}

/// A model of g that a prediction can use.
pub trait Residual: std::fmt::Debug {
    /// g of one period. Does not allocate.
    fn mean(&self, at: &Moment) -> Velocity;

    /// g and its Jacobians. Does not allocate.
    fn response(&self, at: &Moment) -> Response;
}

/// A residual with a variance.
pub trait Uncertain: Residual {
    /// Variance of g, without the noise of an observation \[(m/s)², (m/s)², (rad/s)²\]. Does not
    /// allocate if the scratch is large enough.
    fn variance(&self, at: &Moment, scratch: &mut VarianceScratch) -> Velocity;

    /// Variance of a new sample \[(m/s)², (m/s)², (rad/s)²\]: that of g and that of the sample
    /// about it.
    fn sample_variance(&self, at: &Moment, scratch: &mut VarianceScratch) -> Velocity;
}

/// One learned model of g over D inputs. Constant after construction.
#[derive(Debug, Clone)]
pub struct Learned<const D: usize> {
    /// Layout of the inputs.
    pub layout: Layout,
    /// Scales of the inputs.
    pub normalisation: Normalisation<D>,
    /// Three Gaussian processes.
    pub posterior: Posterior<D>,
    /// Largest |g| that physics allows, per axis \[m/s, m/s, rad/s\].
    pub bound: Velocity,
    /// Variance of a sample beyond that of g \[(m/s)², (m/s)², (rad/s)²\].
    pub sample_variance: Velocity,
}

impl<const D: usize> Learned<D> {
    fn normalised(&self, at: &Moment) -> [f64; D] {
        self.normalisation.apply(&self.layout.inputs(at))
    }
}

impl<const D: usize> Residual for Learned<D> {
    /// O(n).
    fn mean(&self, at: &Moment) -> Velocity {
        let mean = self.posterior.mean(&self.normalised(at));
        std::array::from_fn(|axis| mean[axis].clamp(-self.bound[axis], self.bound[axis]))
    }

    /// O(n). The Jacobians are those of the kernel's linear part alone, and zero where the bound
    /// limits g. There is no Jacobian by heading and position: within a horizon they change little.
    fn response(&self, at: &Moment) -> Response {
        let mut response = Response { mean: self.mean(at), ..Response::NONE };
        let slope = self.posterior.slope();
        for axis in (0..AXES).filter(|&axis| response.mean[axis].abs() < self.bound[axis]) {
            for column in 0..AXES {
                let [by_first, by_second, by_third] = [0, 1, 2].map(|part| {
                    let slope = slope[axis]
                        .get(part * AXES + column)
                        .zip(self.normalisation.scale.get(part * AXES + column))
                        .filter(|_| part < 2 || self.layout == Layout::VelocitySlipHistory);
                    slope.map_or(0.0, |(slope, scale)| slope / scale)
                });
                response.by_input[axis][column] = by_second;
                response.by_before[axis][column] = by_third;
                response.by_velocity[axis][column] = match self.layout {
                    Layout::VelocityInput => by_first,
                    Layout::VelocitySlip
                    | Layout::VelocitySlipHistory
                    | Layout::VelocitySlipHeading
                    | Layout::VelocitySlipPlace => by_first - by_second - by_third,
                };
            }
        }
        response
    }
}

impl<const D: usize> Uncertain for Learned<D> {
    /// O(n²).
    fn variance(&self, at: &Moment, scratch: &mut VarianceScratch) -> Velocity {
        self.posterior.variance(&self.normalised(at), scratch)
    }

    /// O(n²).
    fn sample_variance(&self, at: &Moment, scratch: &mut VarianceScratch) -> Velocity {
        let variance = self.variance(at, scratch);
        std::array::from_fn(|axis| variance[axis] + self.sample_variance[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gp::hyperparameters::Hyperparameters;
    use crate::gp::posterior::PosteriorError;

    #[test]
    fn the_period_of_its_inputs_is_the_period() {
        let at = Moment {
            velocity: [1.0, -0.5, 0.2],
            input: [1.25, -0.25, 0.5],
            before: [0.5, 0.25, -1.0],
            heading: 2.0,
            position: [3.0, -4.0],
        };
        for layout in Layout::ALL {
            let inputs: [f64; INPUTS_WITH_PLACE] = layout.inputs(&at);
            let back = layout.moment(&inputs);
            assert_eq!((back.velocity, back.input), (at.velocity, at.input));
            let history = layout == Layout::VelocitySlipHistory;
            assert_eq!(back.before, if history { at.before } else { [0.0; AXES] });
            let heading = layout == Layout::VelocitySlipHeading || layout.has_place();
            assert!((back.heading - if heading { at.heading } else { 0.0 }).abs() < 1e-12);
            assert_eq!(back.position, if layout.has_place() { at.position } else { [0.0; 2] });
        }
    }

    /// A floor slopes along the world's x axis. The samples come from headings of a quarter turn.
    #[test]
    fn a_force_that_is_fixed_in_the_world_is_predicted_at_new_headings()
    -> Result<(), PosteriorError> {
        let layout = Layout::VelocitySlipHeading;
        let at = |heading: f64| Moment { heading, ..Moment::default() };
        let pull = |heading: f64| [0.1 * heading.cos(), -0.1 * heading.sin(), 0.0];
        let headings: Vec<f64> = (0..16).map(|i| 0.1 * f64::from(i)).collect();
        let inputs: Vec<[f64; INPUTS_WITH_HEADING]> =
            headings.iter().map(|&heading| layout.inputs(&at(heading))).collect();
        let targets: Vec<Velocity> = headings.iter().map(|&heading| pull(heading)).collect();
        let prior = Hyperparameters::new([3.0; INPUTS_WITH_HEADING], 1e-8, 1e-8).with_linear(0.01);
        let posterior = Posterior::new(&inputs, &targets, &[prior; AXES])?;
        let normalisation =
            Normalisation { mean: [0.0; INPUTS_WITH_HEADING], scale: [1.0; INPUTS_WITH_HEADING] };
        let learned = Learned {
            layout,
            normalisation,
            posterior,
            bound: [1.0; AXES],
            sample_variance: [0.0; AXES],
        };
        for heading in [-2.0, 2.5, 4.0] {
            for (predicted, is) in learned.mean(&at(heading)).into_iter().zip(pull(heading)) {
                assert!((predicted - is).abs() < 0.005, "{predicted} is not {is} at {heading}");
            }
        }
        Ok(())
    }

    /// A bump of the floor pushes a robot that drives over it, whatever its heading. The robot
    /// passes it in two directions.
    #[test]
    fn a_bump_is_predicted_where_it_is_and_nowhere_else() -> Result<(), PosteriorError> {
        let layout = Layout::VelocitySlipPlace;
        let at = |x: f64, heading: f64| Moment {
            velocity: [0.5, 0.0, 0.0],
            input: [0.6, 0.0, 0.0],
            heading,
            position: [x, 0.0],
            ..Moment::default()
        };
        let push = |x: f64| [0.01 + 0.1 * (-(x / 0.3).powi(2)).exp(), 0.0, 0.0];
        let places: Vec<f64> = (-20..=20).map(|i| 0.1 * f64::from(i)).collect();
        let passes: Vec<(f64, f64)> =
            places.iter().flat_map(|&x| [(x, 0.0), (x, std::f64::consts::PI)]).collect();
        let inputs: Vec<[f64; INPUTS_WITH_PLACE]> =
            passes.iter().map(|&(x, heading)| layout.inputs(&at(x, heading))).collect();
        let targets: Vec<Velocity> = passes.iter().map(|&(x, _)| push(x)).collect();
        let mut length_scale = [3.0; INPUTS_WITH_PLACE];
        length_scale[INPUTS] = 0.3;
        let prior =
            Hyperparameters::new(length_scale, 1e-8, 1e-8).with_linear(0.01).with_place(0.01);
        let learned = Learned {
            layout,
            normalisation: Normalisation {
                mean: [0.0; INPUTS_WITH_PLACE],
                scale: [1.0; INPUTS_WITH_PLACE],
            },
            posterior: Posterior::new(&inputs, &targets, &[prior; AXES])?,
            bound: [1.0; AXES],
            sample_variance: [0.0; AXES],
        };
        for x in [-1.55, -0.25, 0.05, 0.35, 1.25] {
            for heading in [0.0, 0.3, 3.0] {
                let [predicted, ..] = learned.mean(&at(x, heading));
                let [is, ..] = push(x);
                assert!(
                    (predicted - is).abs() < 0.003,
                    "{predicted} is not {is} at {x}, {heading}"
                );
            }
        }
        // It is not taken for an effect of the input.
        let response = learned.response(&at(0.0, 0.0));
        assert!(response.by_input[0][0].abs() < 0.2, "{response:?}");
        Ok(())
    }
}
