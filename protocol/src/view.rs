//! message → JSON: names, descriptions and values of each message's fields in one place, for
//! records and for telemetry.
//!
//! Of an array only the entries that count are written.

pub mod field;
pub mod words;

use crate::message::{
    Command, Health, ModelSnapshot, Participant, Plan, PlantState, ResidualSample, SnapshotRow,
    Truth,
};
use crate::topic::{OnTopic, TOPIC_COUNT, Topic};
use field::{Field, Shape};
use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value;

/// A message with a JSON view.
pub trait Viewable: OnTopic {
    /// What the message is.
    const ABOUT: &'static str;
    /// Its fields, behind its stamp.
    const FIELDS: &'static [Field];

    /// Appends one entry per field to `map`, in their order.
    fn entries<M: SerializeMap>(&self, map: &mut M) -> Result<(), M::Error>;
}

/// A message as a JSON object.
pub struct View<'a, T>(pub &'a T);

impl<T: Viewable> Serialize for View<'_, T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(T::FIELDS.len() + 1))?;
        map.serialize_entry("stamp", self.0.stamp())?;
        self.0.entries(&mut map)?;
        map.end()
    }
}

/// JSON Schema of `T`'s view.
pub fn schema<T: Viewable>() -> Value {
    field::schema(T::NAME, T::ABOUT, T::FIELDS)
}

/// `key: shape, meaning => value` for each field.
macro_rules! recorded {
    ($message:ident, $about:literal, |$this:ident| {
        $($name:literal: $shape:expr, $meaning:literal => $value:expr;)+
    }) => {
        impl Viewable for $message {
            const ABOUT: &'static str = $about;
            const FIELDS: &'static [Field] =
                &[$(Field { name: $name, shape: $shape, about: $meaning }),+];

            fn entries<M: SerializeMap>(&self, map: &mut M) -> Result<(), M::Error> {
                let $this = self;
                $(map.serialize_entry($name, &$value)?;)+
                Ok(())
            }
        }
    };
}

recorded!(PlantState, "plant → controller: what the sensors saw, and what the gate did.", |state| {
    "pose": Shape::Numbers, "pose in the world (x, y, yaw), yaw not wrapped [m, m, rad]"
        => state.pose;
    "velocity": Shape::Numbers, "body velocity (forward, left, yaw) [m/s, m/s, rad/s]"
        => state.velocity;
    "wheel_speed": Shape::Numbers,
        "wheel speeds, in the order of the robot file; empty if they are not measured [rad/s]"
        => state.wheel_speed();
    "current": Shape::Numbers,
        "motor currents, in the order of the wheels; empty if they are not measured [A]"
        => state.current();
    "input": Shape::Numbers, "output of the gate, mean over the past period [m/s, m/s, rad/s]"
        => state.input;
    "input_delay_s": Shape::Number,
        "dead time from the gate's output to the motors that the driver knows of [s]"
        => state.input_delay_s;
    "controller_epoch": Shape::Integer, "highest controller epoch that the gate has seen"
        => state.controller_epoch;
    "accepted_epoch": Shape::Integer, "epoch of the last accepted command, 0 before the first"
        => state.accepted_epoch;
    "accepted_tick": Shape::Integer, "tick that the last accepted command answered"
        => state.accepted_tick;
    "refused": Shape::Integer, "commands that the gate has refused so far" => state.refused;
    "fallback_level": Shape::Word(words::fallback_levels), "fallback level of the past period"
        => words::of_fallback_level(state.fallback_level);
    "reason": Shape::Word(words::reasons),
        "reason of that fallback level, or of the last refusal in the past period"
        => words::of_reason(state.reason);
    "wheels": Shape::Integer, "wheels of the robot" => state.wheels;
    "estop": Shape::Integer, "1 while the robot's own emergency stop is pressed" => state.estop;
    "gate": Shape::Word(words::gate_states), "state of the gate at the end of the past period"
        => state.gate().text();
    "stop": Shape::Word(words::reasons), "why the gate has stopped, while it has"
        => words::of_reason(state.stop);
});

recorded!(
    Command, "controller → plant: what the wheels do now, and if no further command arrives.",
|command| {
    "plant_epoch": Shape::Integer, "epoch of the plant whose state is answered"
        => command.plant_epoch;
    "model_version": Shape::Integer,
        "version of the learned model in use, 0 is the main model alone"
        => command.model_version;
    "input": Shape::Numbers,
        "body velocity for the period that the answered state began [m/s, m/s, rad/s]"
        => command.input;
    "tail": Shape::Rows, "the plan's next inputs, one per period [m/s, m/s, rad/s]"
        => command.tail();
    "fallback_level": Shape::Word(words::fallback_levels),
        "fallback level of the controller"
        => command.fallback_level().text();
    "stop": Shape::Word(words::reasons), "reason of the requested stop"
        => words::of_reason(command.stop);
});

recorded!(
    ResidualSample, "controller → learner: what the main model got wrong in one period.",
|sample| {
    "plant_epoch": Shape::Integer, "epoch of the plant" => sample.plant_epoch;
    "fingerprint": Shape::Integer, "fingerprint of the main model that the residual belongs to"
        => sample.fingerprint;
    "pose": Shape::Numbers, "pose at the start of the period [m, m, rad]" => sample.pose;
    "velocity": Shape::Numbers, "body velocity at the start of the period [m/s, m/s, rad/s]"
        => sample.velocity;
    "input": Shape::Numbers,
        "input that acted in the period, after the dead time that the controller has found [m/s, \
        m/s, rad/s]"
        => sample.input;
    "input_before": Shape::Numbers, "input that they got in the period before [m/s, m/s, rad/s]"
        => sample.input_before;
    "residual": Shape::Numbers,
        "velocity at its end, measured minus predicted by the main model [m/s, m/s, rad/s]"
        => sample.residual;
    "usable": Shape::Integer, "1 if the learner can use the period" => sample.usable;
});

recorded!(ModelSnapshot, "learner → controller: a better model, without its weights.", |snapshot| {
    "version": Shape::Integer, "counts the snapshots of one robot, from 1" => snapshot.head.version;
    "fingerprint": Shape::Integer, "fingerprint of robot parameters, period and input layout"
        => snapshot.head.fingerprint;
    "effective_tick": Shape::Integer,
        "in lock step the tick at which it takes effect, 0: when it is ready"
        => snapshot.head.effective_tick;
    "plant_epoch": Shape::Integer, "epoch of the plant that it was learnt from last"
        => snapshot.head.plant_epoch;
    "score_samples": Shape::Integer,
        "samples that the scores are taken on, newer than any it was trained on"
        => snapshot.head.score_samples;
    "input_mean": Shape::Numbers, "mean of each input, in its unit"
        => per_input(snapshot, &snapshot.head.input_mean);
    "input_scale": Shape::Numbers, "scale of each input, in its unit"
        => per_input(snapshot, &snapshot.head.input_scale);
    "length_scale": Shape::Rows, "length scale per velocity axis and normalised input"
        => snapshot.head.length_scale.each_ref().map(|axis| per_input(snapshot, axis));
    "signal_variance": Shape::Numbers, "per velocity axis [(m/s)², (m/s)², (rad/s)²]"
        => snapshot.head.signal_variance;
    "linear_variance": Shape::Numbers,
        "of the linear part of the kernel, per velocity axis [(m/s)², (m/s)², (rad/s)²]"
        => snapshot.head.linear_variance;
    "noise_variance": Shape::Numbers, "per velocity axis [(m/s)², (m/s)², (rad/s)²]"
        => snapshot.head.noise_variance;
    "sample_variance": Shape::Numbers,
        "of a new sample beyond that of the function, per velocity axis [(m/s)², (m/s)², (rad/s)²]"
        => snapshot.head.sample_variance;
    "log_likelihood": Shape::Numbers, "log marginal likelihood per velocity axis"
        => snapshot.head.log_likelihood;
    "jitter": Shape::Numbers, "diagonal added beyond the noise variance, per velocity axis"
        => snapshot.head.jitter;
    "score_learned": Shape::Numbers, "RMS one-step error with this model [m/s, m/s, rad/s]"
        => snapshot.head.score_learned;
    "score_main": Shape::Numbers, "RMS one-step error of the main model alone [m/s, m/s, rad/s]"
        => snapshot.head.score_main;
    "inputs": Shape::Rows, "normalised inputs of each data point"
        => Points { snapshot, part: |row| row.input };
    "targets": Shape::Rows, "residual of each data point [m/s, m/s, rad/s]"
        => Points { snapshot, part: |row| row.target };
});

recorded!(
    Plan, "controller → watchers: its plan, its model, and the time that the plan took.",
|plan| {
    "plant_epoch": Shape::Integer, "epoch of the plant" => plan.plant_epoch;
    "model_version": Shape::Integer,
        "version of the learned model in use, 0 is the main model alone"
        => plan.model_version;
    "horizon": Shape::Integer, "length of the horizon [periods]" => plan.horizon;
    "status": Shape::Word(words::statuses), "status of the optimiser" => plan.status().text();
    "iterations": Shape::Integer, "iterations of the optimiser" => plan.iterations;
    "fallback_level": Shape::Word(words::fallback_levels),
        "fallback level of the controller"
        => plan.fallback_level().text();
    "learned_axes": Shape::Integer,
        "velocity axes on which the learned model is used: 1 forward, 2 left, 4 yaw, added up"
        => plan.learned_axes;
    "delay_micros": Shape::Integer, "time from a command to the wheels, as the plan takes it [µs]"
        => plan.delay_micros;
    "tick_nanos": Shape::Integer, "state received to command worked out [ns]" => plan.tick_nanos;
    "linearise_nanos": Shape::Integer, "of it prediction and linearisation [ns]"
        => plan.linearise_nanos;
    "solve_nanos": Shape::Integer, "of it the quadratic program [ns]" => plan.solve_nanos;
    "disturbance": Shape::Numbers,
        "disturbance that the observer estimates, per period [m/s, m/s, rad/s]"
        => plan.disturbance;
    "innovation": Shape::Numbers,
        "one-step error of the whole model in the past period [m/s, m/s, rad/s]"
        => plan.innovation;
    "residual": Shape::Numbers, "the same of the main model alone [m/s, m/s, rad/s]"
        => plan.residual;
    "predicted": Shape::Rows,
        "x, y, yaw, forward, left, yaw velocity from the measured state on [m, m, rad, m/s, m/s, \
        rad/s]"
        => up_to(&plan.predicted, plan.horizon + 1);
    "reference": Shape::Rows,
        "the same of the reference, velocity in its own heading [m, m, rad, m/s, m/s, rad/s]"
        => up_to(&plan.reference, plan.horizon + 1);
    "variance": Shape::Rows,
        "of the learned residual at each predicted state [(m/s)², (m/s)², (rad/s)²]"
        => up_to(&plan.variance, plan.horizon + 1);
    "input": Shape::Rows, "planned inputs [m/s, m/s, rad/s]" => up_to(&plan.input, plan.horizon);
});

recorded!(
    Health, "every process → launcher and watchers: its condition. Counters are since its start.",
|health| {
    "participant": Shape::Word(words::participants), "who reports"
        => health.participant().map_or("?", Participant::text);
    "phase": Shape::Word(words::phases), "its phase" => health.phase().text();
    "pid": Shape::Integer, "process id" => health.pid;
    "exposure": Shape::Word(words::exposures), "what unauthenticated peers on the network can do"
        => health.exposure().text();
    "heartbeat": Shape::Integer, "rounds of its loop" => health.heartbeat;
    "deadlines_met": Shape::Integer, "periods served in time" => health.deadlines_met;
    "deadlines_missed": Shape::Integer, "periods not served in time" => health.deadlines_missed;
    "stalled_nanos": Shape::Integer,
        "time during which the machine suspended the simulator, subtracted from its clock [ns]"
        => health.stalled_nanos;
    "model_version": Shape::Integer,
        "version of the learned model in use, or last published, 0 is none"
        => health.model_version;
    "learned_axes": Shape::Integer,
        "velocity axes on which the controller uses it: 1 forward, 2 left, 4 yaw, added up"
        => health.learned_axes;
    "models_left": Shape::Integer,
        "how often the controller dropped a model on an axis, where it was worse than none"
        => health.models_left;
    "snapshots": Shape::Integer, "model snapshots published (learner) or adopted (controller)"
        => health.snapshots;
    "snapshots_refused": Shape::Integer, "model snapshots refused" => health.snapshots_refused;
    "sent": Shape::ByTopic, "messages sent in the present epoch" => ByTopic(&health.sent);
    "received": Shape::ByTopic, "messages received" => ByTopic(&health.received);
    "lost": Shape::ByTopic, "messages lost on the way to it" => ByTopic(&health.lost);
    "refused": Shape::ByTopic, "messages refused as malformed" => ByTopic(&health.refused);
    "dropped": Shape::ByTopic,
        "messages that its own queue to the network dropped for newer ones"
        => ByTopic(&health.dropped);
    "last_error": Shape::Text, "the last error, empty if there is none" => health.last_error();
});

recorded!(Truth, "plant-sim → recorder: the true state.", |truth| {
    "pose": Shape::Numbers, "true pose in the world (x, y, yaw) [m, m, rad]" => truth.pose;
    "velocity": Shape::Numbers, "true body velocity (forward, left, yaw) [m/s, m/s, rad/s]"
        => truth.velocity;
    "force": Shape::Numbers,
        "force and torque of the world beside the wheels, body frame [N, N, N m]"
        => truth.force;
    "wheel_command": Shape::Numbers, "wheel speeds that the motors are commanded [rad/s]"
        => truth.wheel_command;
    "wheel_peak": Shape::Numbers,
        "largest magnitude of each wheel's command in the past period [rad/s]"
        => truth.wheel_peak;
    "acting_epoch": Shape::Integer, "epoch of the controller whose command acts, 0 if none does"
        => truth.acting_epoch;
    "acting_writer": Shape::Integer, "writer of that command" => truth.acting_writer;
    "acting_tick": Shape::Integer, "tick that it answered" => truth.acting_tick;
    "acting_age_nanos": Shape::Integer,
        "greatest age of an answered state whose command acted in the past period [ns]"
        => truth.acting_age_nanos;
    "takeovers": Shape::Integer, "how often another controller took over in the past period"
        => truth.takeovers;
    "takeovers_back": Shape::Integer, "how many of those went to a smaller epoch"
        => truth.takeovers_back;
    "fallback_level": Shape::Word(words::fallback_levels), "fallback level of the past period"
        => words::of_fallback_level(truth.fallback_level);
    "reason": Shape::Word(words::reasons), "reason of that fallback level"
        => words::of_reason(truth.reason);
});

/// The first `count` rows, or all there are.
fn up_to<T>(rows: &[T], count: u32) -> &[T] {
    rows.get(..count as usize).unwrap_or(rows)
}

/// The entries of an array over all possible inputs that count.
fn per_input<'a>(snapshot: &ModelSnapshot, values: &'a [f64]) -> &'a [f64] {
    up_to(values, snapshot.head.inputs)
}

/// One part of every data point of a snapshot.
struct Points<'a> {
    snapshot: &'a ModelSnapshot,
    part: for<'r> fn(SnapshotRow<'r>) -> &'r [f64],
}

impl Serialize for Points<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.snapshot.rows().map(self.part))
    }
}

/// Counters of [`Health`] under the names of their topics.
struct ByTopic<'a>(&'a [u64; TOPIC_COUNT]);

impl Serialize for ByTopic<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(Topic::ALL.iter().map(|topic| topic.name()).zip(self.0))
    }
}
