//! The models that are compared, each with the controller's own explanations: its disturbance
//! observers, and their choice.

use controller::Settings;
use controller::adopt::Candidate;
use controller::explanations::{Choice, Explanations};
use controller::settings::Identify;
use model::gp::posterior::VarianceScratch;
use model::learned::{Moment, Residual, Response, Uncertain};
use model::main_model::MainModel;
use model::physics::Physics;
use model::predict::Belief;
use model::residual::bound;
use model::response::ResponseEstimator;
use model::{State, Velocity};

use crate::periods::Period;

/// Least squares over physical features, with weights that stay.
#[derive(Debug, Clone)]
pub struct LeastSquares(Physics);

impl LeastSquares {
    /// The weights of `periods`.
    pub fn fit<'p>(settings: &Settings, periods: impl IntoIterator<Item = &'p Period>) -> Self {
        let main = MainModel::new(&settings.robot, settings.run.period_nanos as f64 * 1e-9);
        let mut physics = Physics::new(&main, &settings.robot.wheels).lasting();
        for period in periods {
            physics.update(&Moment::new(&period.state, &period.acted), &period.sample.residual);
        }
        Self(physics)
    }
}

impl Residual for LeastSquares {
    fn mean(&self, at: &Moment) -> Velocity {
        self.0.mean(at)
    }

    fn response(&self, at: &Moment) -> Response {
        self.0.response(at)
    }
}

/// Its variance is not used.
impl Uncertain for LeastSquares {
    fn variance(&self, _: &Moment, _: &mut VarianceScratch) -> Velocity {
        Velocity::default()
    }

    fn sample_variance(&self, _: &Moment, _: &mut VarianceScratch) -> Velocity {
        Velocity::default()
    }
}

/// A main model with a model of its residual, and an observer for the rest.
#[derive(Debug)]
pub struct Contender {
    main: MainModel,
    explanations: Explanations,
    estimator: ResponseEstimator,
}

impl Contender {
    /// The main model, with `model` for its residual if there is one, and with the controller's
    /// observer or without one.
    pub fn new(
        settings: &Settings,
        model: Option<Box<dyn Uncertain + Send>>,
        has_observer: bool,
    ) -> Self {
        let main = MainModel::new(&settings.robot, settings.run.period_nanos as f64 * 1e-9);
        let choice = Choice {
            observer_gain: if has_observer { settings.mpc.offset_free_gain() } else { 0.0 },
            observers: settings.mpc.observers,
            identify: Identify::Off,
            blind: model.is_some(),
        };
        let estimator = ResponseEstimator::new(&main, &settings.robot.wheels);
        let mut explanations = Explanations::new(
            choice,
            &main,
            bound(&main, &settings.robot),
            estimator.response(),
            Physics::new(&main, &settings.robot.wheels),
        );
        if let Some(learned) = model {
            explanations.adopt(Box::new(Candidate {
                version: 1,
                plant_epoch: 0,
                effective_tick: 0,
                learned,
                scratch: VarianceScratch::new(0),
            }));
        }
        Self { main, explanations, estimator }
    }

    /// Forgets what the observers have estimated.
    pub fn reset(&mut self) {
        self.explanations.reset(self.estimator.response());
    }

    /// Updates the observers with one period.
    pub fn observe(&mut self, period: &Period) {
        let at = Moment::new(&period.state, &period.acted);
        let (residual, response) = (&period.sample.residual, self.estimator.response());
        self.explanations.update(&at, residual, &[0.0; 3], response, period.under_way);
    }

    /// The velocities at the end of each of `periods`, of which only the first state and the inputs
    /// are used \[m/s, m/s, rad/s\].
    pub fn predict<'p>(&'p self, periods: &'p [Period]) -> impl Iterator<Item = Velocity> + 'p {
        let belief = Belief {
            learned: Some(&self.explanations),
            disturbance: self.explanations.disturbance(),
            ..Belief::of(&self.main)
        };
        let begin = periods.first().map_or(State::default(), |period| period.state);
        periods.iter().scan(begin, move |state, period| {
            *state = belief.predict(state, &period.acted);
            Some(state.velocity)
        })
    }
}
