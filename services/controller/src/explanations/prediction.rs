//! The explanations in use → the residual of the next periods, and its variance.

use super::{Explanations, Model};
use crate::adopt::Candidate;
use model::learned::{Moment, Residual, Response};
use model::{AXES, Velocity};

impl Explanations {
    /// Variance of the learned residual, per axis, by the model in use or else the newest; 0
    /// without a model. O(n²) \[(m/s)², (m/s)², (rad/s)²\].
    pub fn variance(&mut self, at: &Moment) -> Velocity {
        self.of_learned(|of| of.learned.variance(at, &mut of.scratch))
    }

    /// Result of `say` for the newest learned model, and for the last good one on axes that use it.
    fn of_learned(&mut self, say: impl Fn(&mut Candidate) -> Velocity) -> Velocity {
        let models = self.models();
        let mut result = self.active.as_deref_mut().map_or([0.0; AXES], &say);
        if models.contains(&Model::LastGood)
            && let Some(last_good) = &mut self.last_good
        {
            let instead = say(last_good);
            for axis in (0..AXES).filter(|&axis| models[axis] == Model::LastGood) {
                result[axis] = instead[axis];
            }
        }
        result
    }

    /// Variance of the residual of one period, per axis: from the learned model if it is in use,
    /// else from the recent innovations. O(n²) \[(m/s)², (m/s)², (rad/s)²\].
    pub fn step_variance(&mut self, at: &Moment) -> Velocity {
        let (models, mut variance) = (self.models(), self.axes.map(|axis| axis.spread));
        if models.iter().any(|model| model.is_learned()) {
            let learned = self.of_learned(|of| of.learned.sample_variance(at, &mut of.scratch));
            for axis in (0..AXES).filter(|&axis| models[axis].is_learned()) {
                variance[axis] = learned[axis];
            }
        }
        variance
    }
}

impl Residual for Explanations {
    fn mean(&self, at: &Moment) -> Velocity {
        self.response(at).mean
    }

    fn response(&self, at: &Moment) -> Response {
        let models = self.models();
        let mut response = Response::NONE;
        let mut take = |of: Model, of_model: Response| {
            for axis in (0..AXES).filter(|&axis| models[axis] == of) {
                response.mean[axis] = of_model.mean[axis];
                response.by_velocity[axis] = of_model.by_velocity[axis];
                response.by_input[axis] = of_model.by_input[axis];
                response.by_before[axis] = of_model.by_before[axis];
            }
        };
        if models.contains(&Model::Response) {
            take(Model::Response, self.response.response(at));
        }
        if models.contains(&Model::Physics) {
            take(Model::Physics, self.physics.response(at));
        }
        for (of, learned) in [(Model::Learned, &self.active), (Model::LastGood, &self.last_good)] {
            if let Some(learned) = learned.as_ref().filter(|_| models.contains(&of)) {
                take(of, learned.learned.response(at));
            }
        }
        response
    }
}
