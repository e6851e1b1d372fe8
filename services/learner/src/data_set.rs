//! ResidualSample in, data set out: the samples that a fit learns from, and the units of their
//! inputs.

use crate::fit::FitSettings;
use crate::settings::Settings;
use crate::snapshot;
use model::gp::dictionary::{Dictionary, Observation, Outcome, Selection};
use model::gp::hyperparameters::Hyperparameters;
use model::learned::{INPUTS, Layout};
use model::main_model::{MainModel, fingerprint};
use model::residual::bound;
use model::{AXES, Velocity};
use protocol::message::ResidualSample;

/// Velocity unit of the kernel inputs, as a share of the velocity's physical range.
const VELOCITY_SHARE: f64 = 0.2;
/// Slip unit of the kernel inputs, as a share of the physical range of the velocity.
const SLIP_SHARE: f64 = 0.1;
/// Unit of the position inputs of the kernel \[m\]. The effect of a place changes over about three
/// units, which is about the size of a robot.
const POSITION_UNIT_M: f64 = 0.15;
/// Unit of the heading inputs of the kernel beside a position.
const HEADING_UNIT: f64 = 0.5;
/// Prior variance of the effect of a place, of that of the smooth function, for the selection of
/// samples.
const PLACE_SHARE: f64 = 0.1;
/// Age at which a sample has half its weight \[s\].
const MEMORY_S: f64 = 5.0;
/// Innovations that are never surprising, as a share of the largest plausible residual.
const NOISE_SHARE: f64 = 0.005;

/// Samples whose dead times differ by less belong together \[periods\].
const DEAD_TIME_PERIODS: f64 = 0.25;

/// The samples that a fit learns from.
#[derive(Debug)]
pub struct DataSet<const D: usize> {
    layout: Layout,
    bound: Velocity,
    period_s: f64,
    /// Dead time of the samples of this run, once there is one \[s\].
    dead_time_s: Option<f64>,
    /// The samples.
    pub dictionary: Dictionary<D>,
}

impl<const D: usize> DataSet<D> {
    /// An empty data set of a learner, in which samples age.
    pub fn new(settings: &Settings, fit_settings: &FitSettings<D>) -> Self {
        let memory_samples = MEMORY_S * 1e9 / settings.run.period_nanos as f64;
        Self::with_memory(settings, fit_settings, memory_samples)
    }

    /// An empty data set in which a sample has half its weight after `memory_samples` more. Without
    /// an end, samples do not age.
    pub fn with_memory(
        settings: &Settings,
        fit_settings: &FitSettings<D>,
        memory_samples: f64,
    ) -> Self {
        // It has about the curvature of friction, in the units of the inputs.
        let kernel = Hyperparameters::new([1.0; D], 1.0, 0.01).with_linear(1.0);
        let has_place = fit_settings.layout.has_place();
        let selection = Selection {
            capacity: settings.learner.points_max,
            normalisation: fit_settings.normalisation(),
            kernel: if has_place { kernel.with_place(PLACE_SHARE) } else { kernel },
            memory_samples,
            noise_floor: fit_settings.bound.map(|bound| NOISE_SHARE * bound),
        };
        Self {
            layout: fit_settings.layout,
            bound: fit_settings.bound,
            period_s: settings.run.period_nanos as f64 * 1e-9,
            dead_time_s: None,
            dictionary: Dictionary::new(selection),
        }
    }

    /// Drops the samples of this run if `sample` is of another dead time: their inputs, and so
    /// their residuals, are those of another time. Samples of an earlier run stay. Returns whether
    /// it dropped them.
    pub fn follow_dead_time(&mut self, sample: &ResidualSample) -> bool {
        if sample.usable == 0 || !sample.dead_time_s.is_finite() {
            return false;
        }
        let known = *self.dead_time_s.get_or_insert(sample.dead_time_s);
        let is_other = (sample.dead_time_s - known).abs() > DEAD_TIME_PERIODS * self.period_s;
        if is_other {
            self.dead_time_s = Some(sample.dead_time_s);
            self.dictionary.forget_inserted();
        }
        is_other
    }

    /// Inserts a sample, if its input was chosen by the controller, and if it is finite and
    /// plausible. Returns what became of it.
    pub fn add(&mut self, sample: &ResidualSample) -> Option<Outcome> {
        let believable = (sample.residual.iter().zip(self.bound))
            .all(|(residual, bound)| residual.abs() <= bound);
        // One number that is not finite would spoil every fit while it is in the data set.
        let mut inputs = sample.velocity.iter().chain(&sample.input).chain(&sample.input_before);
        let finite = inputs.all(|value| value.is_finite());
        (sample.usable == 1 && believable && finite).then(|| {
            let input = self.layout.inputs(&snapshot::moment(sample));
            self.dictionary.insert(Observation { input, target: sample.residual })
        })
    }

    /// The samples, each with the scale of its noise.
    pub fn observations(&self) -> Vec<(Observation<D>, f64)> {
        let observations = self.dictionary.observations();
        observations.map(|(observation, scale)| (*observation, scale)).collect()
    }
}

/// What a fit for the robot, the period and the learning of `settings` knows beforehand.
pub fn fit_settings<const D: usize>(settings: &Settings) -> FitSettings<D> {
    let limits = &settings.robot.limits;
    let range = [limits.input_mps, limits.input_mps, limits.yaw_input_radps];
    let layout = settings.learner.layout;
    let scale = |input: usize| match (layout, input / AXES) {
        (Layout::VelocitySlipHeading, 2) => 1.0,
        (Layout::VelocitySlipPlace, 2) if input < INPUTS + 2 => POSITION_UNIT_M,
        (Layout::VelocitySlipPlace, 2 | 3) => HEADING_UNIT,
        (_, 0) | (Layout::VelocityInput, _) => VELOCITY_SHARE * range[input % AXES],
        _ => SLIP_SHARE * range[input % AXES],
    };
    FitSettings {
        layout,
        kernel: settings.learner.kernel,
        input_scale: std::array::from_fn(scale),
        bound: bound(&main_model(settings), &settings.robot),
        evaluations_max: settings.learner.evaluations_max,
    }
}

/// The main model of the robot and the period of `settings`.
pub fn main_model(settings: &Settings) -> MainModel {
    MainModel::new(&settings.robot, settings.run.period_nanos as f64 * 1e-9)
}

/// Fingerprint of the snapshots of this learner.
pub fn fingerprint_of(settings: &Settings) -> u64 {
    fingerprint(&main_model(settings), settings.learner.layout.name())
}
