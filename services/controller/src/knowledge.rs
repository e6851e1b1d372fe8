//! What is believed at one moment: main model, learned residual, disturbance, transport delay; and how that follows what is seen.
//!
//! The residual is explained in several ways side by side ([`Ways`]); per axis, the one that has foretold best is used.

use crate::adopt::Candidate;
use crate::settings::{DelaySetting, Method, Settings};
use crate::trust::{Trust, Way};
use crate::ways::Ways;
use model::delay::{Delay, DelayEstimator, Sent};
use model::explanation::Sample;
use model::foresight::Foresight;
use model::learned::{Moment, Residual};
use model::least_squares::LeastSquares;
use model::main_model::MainModel;
use model::observer::Observer;
use model::predict::Belief;
use model::residual::{bound, residual};
use model::{AXES, State, Velocity};
use protocol::message::Plan;

/// Time over which recursive least squares forgets \[s\].
const LEAST_SQUARES_MEMORY_S: f64 = 6.0;

/// One period that is over.
#[derive(Debug, Clone, Copy)]
pub struct Period {
    /// Its tick.
    pub tick: u64,
    /// State at its start.
    pub before: State,
    /// What was commanded for it.
    pub commanded: Velocity,
    /// The input that acted, as the driver says; the mean of the period.
    pub acted: Velocity,
    /// Velocity at its end.
    pub after: Velocity,
    /// Whether the gate played this controller's answer.
    pub ours: bool,
}

/// Everything that a prediction rests on. Does not allocate after set-up.
pub struct Knowledge {
    main: MainModel,
    method: Method,
    ways: Ways,
    /// The cheap alternative to what is learned, which controllers are compared with.
    least_squares: LeastSquares,
    /// Somebody who knows better than all of them.
    foresight: Option<Box<dyn Foresight>>,
    /// g of the last period.
    residual: Velocity,
    setting: DelaySetting,
    estimator: DelayEstimator,
    sent: Sent,
    delay: Delay,
}

impl Knowledge {
    /// The main model, and nothing else yet; or whatever `foresight` knows.
    pub fn new(settings: &Settings, main: MainModel, foresight: Option<Box<dyn Foresight>>) -> Self {
        let bound = bound(&main, &settings.robot);
        let observer = Observer::new(settings.mpc.observer_gain, bound);
        Self {
            method: settings.mpc.method,
            ways: Ways::new(observer, if settings.mpc.no_harm { Trust::default() } else { Trust::blind() }),
            least_squares: LeastSquares::new(1.0 - main.period / LEAST_SQUARES_MEMORY_S, bound),
            main,
            foresight,
            residual: [0.0; AXES],
            setting: settings.mpc.delay,
            estimator: DelayEstimator::default(),
            sent: Sent::default(),
            delay: Delay::default(),
        }
    }

    /// What predictions are made with.
    pub fn belief(&self) -> Belief<'_> {
        let learned = match self.method {
            Method::Mpc => Some(&self.ways as &dyn Residual),
            Method::LeastSquaresMpc => Some(&self.least_squares as &dyn Residual),
            Method::FeedforwardP | Method::Oracle => None,
        };
        Belief {
            main: &self.main,
            learned,
            foresight: self.foresight.as_deref(),
            disturbance: self.ways.disturbance(),
            carry: self.delay.carry(),
        }
    }

    /// Whether nothing has to be learnt.
    pub fn foresees(&self) -> bool {
        self.foresight.is_some()
    }

    /// Lets the foresight, if there is one, take the world as it is at `tick`.
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
        self.ways.disturbance()
    }

    /// Last one-step error of the model that is used, per axis \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.ways.innovation()
    }

    /// The last command.
    pub fn last_command(&self) -> Velocity {
        self.sent.last()
    }

    /// Version of the learned model in use; 0 is the main model alone.
    pub fn version(&self) -> u64 {
        self.ways.version()
    }

    /// Axes on which a learned model is used: 1 forward, 2 left, 4 yaw, added up.
    pub fn learned_axes(&self) -> u32 {
        self.ways.chosen().iter().enumerate().map(|(axis, &way)| u32::from(way == Way::Learned) << axis).sum()
    }

    /// How often a learned model was left on an axis, where it had turned worse than none.
    pub fn models_left(&self) -> u64 {
        self.ways.left()
    }

    /// Time from a command to the wheels, as predictions take it.
    pub fn delay(&self) -> Delay {
        self.delay
    }

    /// From now on predictions take the delay as it is known by now.
    pub fn settle_delay(&mut self) {
        self.delay = match self.setting {
            DelaySetting::Estimated => self.estimator.delay(),
            DelaySetting::KnownS(seconds) => Delay::of_periods(seconds / self.main.period),
            DelaySetting::Ignored => Delay::default(),
        };
    }

    /// The states from the measured one on, for as long as nothing that is commanded now acts, each with the input that acts in its period.
    pub fn under_way(&self, measured: &State) -> impl Iterator<Item = (State, Velocity)> {
        let mut state = *measured;
        (0..self.delay.whole()).map(move |ahead| {
            let (here, acting) = (state, self.sent.under_way(self.delay, ahead));
            state = self.belief().predict(&here, &acting);
            (here, acting)
        })
    }

    /// Where the robot will be when the next command begins to act.
    pub fn ahead(&self, measured: &State) -> State {
        self.under_way(measured).last().map_or(*measured, |(state, acting)| self.belief().predict(&state, &acting))
    }

    /// Puts a model in use, and gives back the one before, for somebody else to free.
    pub fn adopt(&mut self, candidate: Box<Candidate>) -> Option<Box<Candidate>> {
        self.ways.adopt(candidate)
    }

    /// Takes in one period: what there was, against what each model said of it.
    pub fn observe(&mut self, period: &Period) {
        self.sent.push(if period.ours { period.commanded } else { period.acted });
        if period.ours {
            self.estimator.update(&self.sent, &period.acted);
        }
        self.residual = residual(&self.main, &period.before.velocity, &period.acted, &period.after);
        let sample = Sample { at: Moment::new(&period.before, &period.acted), residual: self.residual };
        let known = match self.method {
            Method::Oracle => {
                self.look(period.tick);
                self.belief().residual(&period.before, &period.acted)
            }
            Method::LeastSquaresMpc => self.least_squares.mean(&sample.at),
            Method::Mpc | Method::FeedforwardP => [0.0; AXES],
        };
        self.ways.update(&sample, known);
        if self.method == Method::LeastSquaresMpc {
            self.least_squares.update(&sample.at, &sample.residual);
        }
    }

    /// A period is missing: nothing is known but the input that acts.
    pub fn resume(&mut self, acted: Velocity) {
        self.sent = Sent::always(acted);
    }

    /// Forgets all but the learned model: another robot, or the same one put somewhere else.
    pub fn reset(&mut self, acted: Velocity) {
        self.resume(acted);
        self.residual = [0.0; AXES];
        self.ways.reset();
        self.least_squares.reset();
        self.estimator.reset();
    }

    /// Variance of the residual of one period, noise included \[(m/s)², (m/s)², (rad/s)²\].
    pub fn step_variance(&mut self, at: &Moment) -> Velocity {
        self.ways.step_variance(at)
    }

    /// Writes the variance of the learned residual along a plan whose states and inputs are written; `acted` is the input before its first.
    pub fn write_variance(&mut self, plan: &mut Plan, acted: &Velocity) {
        let Some(active) = self.ways.active_mut() else {
            plan.variance.fill([0.0; AXES]);
            return;
        };
        let periods = plan.predicted.iter().zip(&plan.input).take(plan.horizon as usize);
        let mut before = *acted;
        for (slot, (&[_, _, _, forward, left, rate], &input)) in plan.variance.iter_mut().zip(periods) {
            *slot = active.learned.variance(&Moment { velocity: [forward, left, rate], input, before }, &mut active.scratch);
            before = input;
        }
    }
}
