//! The current belief (main model, residual, disturbance, dead time, pose) and its update by
//! measurements.
//!
//! The residual is explained in several ways side by side ([`Explanations`]). Per axis, the
//! explanation that has predicted best is used.

use crate::adopt::Candidate;
use crate::explanations::{Choice, Explanations, Model};
use crate::identified::{self, Identified};
use crate::pose::PoseFilter;
use crate::settings::{DelaySetting, Method, Settings};
use model::delay::{Acting, Delay, Sent};
use model::foresight::Foresight;
use model::learned::{Moment, Residual};
use model::main_model::{MainModel, fingerprint};
use model::physics::Physics;
use model::predict::Belief;
use model::residual::{bound, residual};
use model::response::ResponseEstimator;
use model::{AXES, State, Velocity};
use protocol::message::{Plan, ResidualSample};
use robot::{PerWheel, Wheels};

/// One past period.
#[derive(Debug, Clone, Copy)]
pub struct Period {
    /// Its tick.
    pub tick: u64,
    /// Believed state at its start.
    pub before: State,
    /// The gate's output; the mean of the period.
    pub given: Velocity,
    /// Measurements at its end.
    pub after: Measured,
}

/// Measurements of one moment.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Pose in the world.
    pub pose: [f64; 3],
    /// Body velocity.
    pub velocity: Velocity,
    /// Body velocity that the wheels' speeds give, J⁺ r ω, if they are measured.
    pub wheels: Option<Velocity>,
}

/// Everything that a prediction depends on. Does not allocate after set-up.
pub struct Knowledge {
    main: MainModel,
    method: Method,
    explanations: Explanations,
    /// Source of the true dynamics, which replaces the models.
    foresight: Option<Box<dyn Foresight>>,
    /// g of the last period.
    residual: Velocity,
    setting: DelaySetting,
    wheels: Wheels,
    response: ResponseEstimator,
    /// The response at the start of a run.
    first_response: ResponseEstimator,
    sent: Sent,
    delay: Delay,
    pose: PoseFilter,
    velocity: Velocity,
    /// Input that acted in the last period.
    acted: Velocity,
}

impl Knowledge {
    /// The main model without measurements yet, or the model of `foresight`.
    pub fn new(
        settings: &Settings,
        main: MainModel,
        foresight: Option<Box<dyn Foresight>>,
    ) -> Self {
        let choice = Choice {
            observer_gain: settings.mpc.observer_gain,
            observers: settings.mpc.observers,
            identify: settings.mpc.identify,
            blind: !settings.mpc.no_harm,
        };
        let response = ResponseEstimator::new(&main, &settings.robot.wheels)
            .with_dead_time(settings.robot.dead_time_s());
        let bound = bound(&main, &settings.robot);
        Self {
            method: settings.mpc.method,
            explanations: Explanations::new(
                choice,
                &main,
                bound,
                response.response(),
                Physics::new(&main, &settings.robot.wheels),
            ),
            foresight,
            residual: [0.0; AXES],
            setting: settings.mpc.delay,
            wheels: settings.robot.wheels,
            first_response: response.clone(),
            response,
            sent: Sent::default(),
            delay: Delay::default(),
            pose: PoseFilter::new(main.period),
            velocity: [0.0; AXES],
            acted: [0.0; AXES],
            main,
        }
    }

    /// The parameters identified so far. Allocates.
    pub fn identified(&self) -> Identified {
        Identified {
            main_model: self.main_model_name(),
            response: self.response.found(),
            physics: self.explanations.found_physics(),
        }
    }

    /// Starts, now and after each reset, from the parameters that an earlier run of the same robot
    /// identified. Returns false, and starts without them, if they have other dead times or are not
    /// finite.
    pub fn begin_with(&mut self, identified: &Identified) -> bool {
        let is_usable = self.first_response.begin_with(&identified.response)
            && (identified.physics.as_ref())
                .is_none_or(|found| self.explanations.begin_with(found));
        self.reset(0.0);
        is_usable
    }

    /// Name of the main model in a file of identified parameters.
    pub fn main_model_name(&self) -> String {
        identified::name_of(fingerprint(&self.main, ""))
    }

    /// The belief for predictions.
    pub fn belief(&self) -> Belief<'_> {
        let learned = match self.method {
            Method::Mpc => Some(&self.explanations as &dyn Residual),
            Method::FeedforwardP | Method::Oracle => None,
        };
        Belief {
            main: &self.main,
            learned,
            foresight: self.foresight.as_deref(),
            disturbance: self.explanations.disturbance(),
            split: self.delay.split(),
        }
    }

    /// Whether there is a foresight, so that nothing must be learned.
    pub fn foresees(&self) -> bool {
        self.foresight.is_some()
    }

    /// Lets the foresight, if there is one, read the world's state at `tick`.
    pub fn look(&mut self, tick: u64) {
        if let Some(foresight) = &mut self.foresight {
            foresight.look(tick);
        }
    }

    /// f.
    pub fn main(&self) -> &MainModel {
        &self.main
    }

    /// Residual of the main model in the last period \[m/s, m/s, rad/s\].
    pub fn residual(&self) -> Velocity {
        self.residual
    }

    /// d of the observer in use, per axis \[m/s, m/s, rad/s\].
    pub fn disturbance(&self) -> Velocity {
        self.explanations.disturbance()
    }

    /// Last one-step error of the explanation in use, per axis \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.explanations.innovation()
    }

    /// Largest rate at which the drive changes the rim speeds of its set points, if it ramps its
    /// command \[m/s²\].
    pub fn ramp_mps2(&self) -> Option<f64> {
        self.response.ramp_mps2()
    }

    /// The last command.
    pub fn last_command(&self) -> Velocity {
        self.sent.last()
    }

    /// Version of the learned model in use; 0 is the main model alone.
    pub fn version(&self) -> u64 {
        self.explanations.version()
    }

    /// Axes on which a learned model is used: the sum of 1 forward, 2 left, 4 yaw.
    pub fn learned_axes(&self) -> u32 {
        let models = self.explanations.models();
        (0..AXES).map(|axis| u32::from(models[axis].is_learned()) << axis).sum()
    }

    /// The model of the residual, per axis.
    pub fn models(&self) -> [Model; AXES] {
        self.explanations.models()
    }

    /// Number of times that a learned model became worse than none on an axis, and was abandoned.
    pub fn models_left(&self) -> u64 {
        self.explanations.left()
    }

    /// Dead time from a command to the wheels, as used in predictions.
    pub fn delay(&self) -> Delay {
        self.delay
    }

    /// From now on predictions use the present estimate of the delay.
    pub fn settle_delay(&mut self) {
        self.delay = match self.setting {
            DelaySetting::Estimated => self.response.delay(),
            DelaySetting::KnownS(seconds) => {
                Delay::of_periods(seconds / self.main.period, &self.main)
            }
            DelaySetting::Ignored => Delay::default(),
        };
    }

    /// The states from the measured one on, until a new command can act. Each has the input that
    /// acts in its period.
    pub fn under_way(&self, measured: &State) -> impl Iterator<Item = (State, Acting)> {
        let mut state = *measured;
        (0..self.delay.whole()).map(move |ahead| {
            let sent = self.response.ramped(&self.sent);
            let (here, acting) = (state, sent.under_way(self.delay, ahead));
            state = self.belief().predict(&here, acting);
            (here, acting)
        })
    }

    /// State of the robot when the next command begins to act.
    pub fn ahead(&self, measured: &State) -> State {
        self.under_way(measured)
            .last()
            .map_or(*measured, |(state, acting)| self.belief().predict(&state, acting))
    }

    /// Puts a model in use. Returns the one before, for another thread to free.
    pub fn adopt(&mut self, candidate: Box<Candidate>) -> Option<Box<Candidate>> {
        self.explanations.adopt(candidate)
    }

    /// Number of the robot's wheels; 0 if they are not known.
    pub fn wheels(&self) -> usize {
        self.wheels.count()
    }

    /// Whether the measured wheels follow the commands.
    pub fn wheels_follow(&self) -> bool {
        self.response.wheels_follow()
    }

    /// What was measured at one moment. `wheel_speed` is that of all wheels of the robot, if it was
    /// measured \[rad/s\].
    pub fn measured(
        &self,
        pose: [f64; 3],
        velocity: Velocity,
        wheel_speed: Option<&PerWheel>,
    ) -> Measured {
        let speeds = wheel_speed.filter(|_| self.wheels.count() > 0);
        Measured { pose, velocity, wheels: speeds.map(|speeds| self.wheels.body(speeds)) }
    }

    /// Processes one period: compares its measurements with each model's prediction.
    pub fn observe(&mut self, period: &Period) {
        let Period { tick, before, given, after } = period;
        self.sent.push(*given);
        self.response.update(&self.sent, &after.velocity, after.wheels.as_ref());
        let acted = self.response.ramped(&self.sent).acted(self.delay);
        self.acted = acted.input;
        self.residual = residual(&self.main, &before.velocity, &self.acted, &after.velocity);
        let known = if self.method == Method::Oracle {
            self.look(*tick);
            self.belief().residual(before, &self.acted)
        } else {
            [0.0; AXES]
        };
        let (at, newest) = (Moment::new(before, &self.acted), self.response.response());
        let under_way = self.delay.whole();
        self.explanations.update(&at, &self.residual, &known, newest, under_way);
        let mean = self.main.mean_velocity(&before.velocity, &after.velocity);
        let mean = std::array::from_fn(|axis| mean[axis] + acted.drift[axis]);
        self.pose.update(&mean, &after.pose);
        self.velocity = after.velocity;
    }

    /// Writes the last period, which began with `before`, and its residual into `sample`.
    pub fn write_sample(&self, before: &State, sample: &mut ResidualSample) {
        (sample.pose, sample.velocity) = (before.pose, before.velocity);
        (sample.input, sample.input_before) = (self.acted, before.acted);
        sample.dead_time_s = self.delay.periods() * self.main.period;
        sample.residual = self.residual;
    }

    /// Processes a missing period: only the measurements and the acting input are known.
    pub fn resume(&mut self, measured: &Measured, given: Velocity) {
        self.sent = Sent::always(given);
        self.acted = given;
        self.response.resume(&given, &measured.velocity, measured.wheels.as_ref());
        self.pose.resume(&measured.pose);
        self.explanations.resume();
        self.velocity = measured.velocity;
    }

    /// Processes a period in which only the gate's output can be trusted.
    pub fn drive_blind(&mut self, given: Velocity) {
        self.sent = Sent::always(given);
        self.response.settle(&given);
        self.acted = given;
    }

    /// Estimated pose and velocity, from all measurements.
    pub fn state(&self) -> State {
        State { pose: self.pose.estimate(), velocity: self.velocity, acted: self.acted }
    }

    /// Resets all but the learned model: another robot, or the same one moved to another place. Its
    /// driver reports this dead time \[s\]; 0 is none.
    pub fn reset(&mut self, reported_dead_time_s: f64) {
        self.residual = [0.0; AXES];
        self.response.clone_from(&self.first_response);
        self.response.begin_at_dead_time(reported_dead_time_s);
        self.explanations.reset(self.response.response());
    }

    /// Variance of the residual of one period, noise included \[(m/s)², (m/s)², (rad/s)²\].
    pub fn step_variance(&mut self, at: &Moment) -> Velocity {
        self.explanations.step_variance(at)
    }

    /// Writes the variance of the learned residual along a plan whose states and inputs are
    /// written; `acted` is the input before its first one.
    pub fn write_variance(&mut self, plan: &mut Plan, acted: &Velocity) {
        let periods = plan.predicted.iter().zip(&plan.input).take(plan.horizon as usize);
        let mut before = *acted;
        for (slot, (&[x, y, heading, forward, left, rate], &input)) in
            plan.variance.iter_mut().zip(periods)
        {
            let (velocity, position) = ([forward, left, rate], [x, y]);
            let at = Moment { velocity, input, before, heading, position };
            *slot = self.explanations.variance(&at);
            before = input;
        }
    }
}
