//! States and plans → channels for public viewers, in the standard visual types of Foxglove: poses,
//! path, horizon and scalars.
//!
//! | channel     | type                    | what it shows                       | how often     |
//! |-------------|-------------------------|-------------------------------------|---------------|
//! | `tf`        | foxglove.FrameTransform | the robot's frame in the world      | each state    |
//! | `pose`      | foxglove.PoseInFrame    | the measured pose                   | each state    |
//! | `path`      | foxglove.PosesInFrame   | the last part of the driven path    | each second   |
//! | `horizon`   | foxglove.PosesInFrame   | the predicted poses of the plan     | 10 per second |
//! | `reference` | foxglove.PosesInFrame   | the poses of the reference          | 10 per second |
//! | `tracking`  | coxswain.Tracking       | error, level, model, cost, residual | each plan     |
//!
//! They are made from recorded messages, hold no other data, and have the lowest priority: a
//! drawing that cannot be written is not counted.

mod channel;

pub use channel::Shown;

use protocol::message::{Plan, PlantState};
use serde::Serialize;

/// Name of the world frame.
const WORLD: &str = "world";
/// Name of the robot frame.
const ROBOT: &str = "robot";
/// Smallest distance between two poses of a path \[m\].
const PATH_STEP: f64 = 0.1;
/// Largest number of poses of a path.
const PATH_MAX: usize = 200;
/// Interval between two paths \[ns\].
const PATH_EVERY: u64 = 1_000_000_000;
/// Interval between two horizons \[ns\].
const HORIZON_EVERY: u64 = 100_000_000;
/// Drawings are rounded to this fraction of a metre or of 1.
const GRAINS: f64 = 1e5;

/// A time in two parts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Time {
    sec: u64,
    nsec: u64,
}

impl Time {
    const fn of(nanos: u64) -> Self {
        Self { sec: nanos / 1_000_000_000, nsec: nanos % 1_000_000_000 }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Pose {
    position: Vector3,
    orientation: Quaternion,
}

impl Pose {
    /// Of x, y, yaw \[m, m, rad\].
    fn plane(x: f64, y: f64, yaw: f64) -> Self {
        let (sin, cos) = (0.5 * yaw).sin_cos();
        let position = Vector3 { x: rounded(x), y: rounded(y), z: 0.0 };
        Self {
            position,
            orientation: Quaternion { x: 0.0, y: 0.0, z: rounded(sin), w: rounded(cos) },
        }
    }
}

fn rounded(value: f64) -> f64 {
    (value * GRAINS).round() / GRAINS
}

/// A drawing of one time, ready to be written.
#[derive(Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub(crate) enum Drawing {
    /// Pose of a frame.
    Transform(FrameTransform),
    /// One pose.
    Pose(PoseInFrame),
    /// Poses in a row.
    Poses(PosesInFrame),
    /// Plain numbers.
    Tracking(Tracking),
}

#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct FrameTransform {
    timestamp: Time,
    parent_frame_id: &'static str,
    child_frame_id: &'static str,
    translation: Vector3,
    rotation: Quaternion,
}

#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct PoseInFrame {
    timestamp: Time,
    frame_id: &'static str,
    pose: Pose,
}

#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct PosesInFrame {
    timestamp: Time,
    frame_id: &'static str,
    poses: Vec<Pose>,
}

#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Tracking {
    timestamp: Time,
    tick: u64,
    position_error: f64,
    heading_error: f64,
    speed: f64,
    residual: f64,
    innovation: f64,
    standard_deviation: f64,
    model_version: u64,
    fallback_level: u32,
    tick_micros: f64,
}

/// State of the drawings.
#[derive(Debug)]
pub(crate) struct Easel {
    /// T \[ns\].
    period_nanos: u64,
    path: Vec<Pose>,
    plant_epoch: u64,
    path_at: Option<u64>,
    horizon_at: Option<u64>,
}

impl Easel {
    /// No drawings yet, for a robot with this control period \[ns\].
    pub(crate) fn new(period_nanos: u64) -> Self {
        Self { period_nanos, path: Vec::new(), plant_epoch: 0, path_at: None, horizon_at: None }
    }

    /// Drawings of a state. Numbers that are not finite give none.
    pub(crate) fn draw_state(&mut self, state: &PlantState) -> Vec<(Shown, Drawing)> {
        let [x, y, yaw] = state.pose;
        if !state.pose.iter().all(|value| value.is_finite()) {
            return Vec::new();
        }
        let (timestamp, pose) = (Time::of(state.stamp.sent_nanos), Pose::plane(x, y, yaw));
        let (translation, rotation) = (pose.position, pose.orientation);
        let transform = FrameTransform {
            timestamp,
            parent_frame_id: WORLD,
            child_frame_id: ROBOT,
            translation,
            rotation,
        };
        let mut drawn = vec![
            (Shown::Transform, Drawing::Transform(transform)),
            (Shown::Pose, Drawing::Pose(PoseInFrame { timestamp, frame_id: WORLD, pose })),
        ];
        self.lengthen_path(state.stamp.epoch, pose);
        if is_due(&mut self.path_at, state.stamp.tick.saturating_mul(self.period_nanos), PATH_EVERY)
        {
            drawn.push((
                Shown::Path,
                Drawing::Poses(PosesInFrame {
                    timestamp,
                    frame_id: WORLD,
                    poses: self.path.clone(),
                }),
            ));
        }
        drawn
    }

    /// Extends the path; a plant of another epoch begins a new one.
    fn lengthen_path(&mut self, plant_epoch: u64, pose: Pose) {
        if plant_epoch != self.plant_epoch {
            (self.plant_epoch, self.path, self.path_at) = (plant_epoch, Vec::new(), None);
        }
        let apart = |last: &Pose| {
            (pose.position.x - last.position.x).hypot(pose.position.y - last.position.y)
        };
        if self.path.last().is_none_or(|last| apart(last) >= PATH_STEP) {
            if self.path.len() == PATH_MAX {
                self.path.remove(0);
            }
            self.path.push(pose);
        }
    }

    /// Drawings of a plan.
    pub(crate) fn draw_plan(&mut self, plan: &Plan) -> Vec<(Shown, Drawing)> {
        let rows = plan.horizon as usize + 1;
        let (predicted, reference) = (first(&plan.predicted, rows), first(&plan.reference, rows));
        let finite = |rows: &[[f64; 6]]| rows.iter().flatten().all(|value| value.is_finite());
        let errors = [plan.residual, plan.innovation];
        if !finite(predicted)
            || !finite(reference)
            || !errors.iter().flatten().all(|value| value.is_finite())
        {
            return Vec::new();
        }
        let timestamp = Time::of(plan.stamp.sent_nanos);
        let mut drawn = vec![(Shown::Tracking, Drawing::Tracking(tracked(plan, timestamp)))];
        if is_due(
            &mut self.horizon_at,
            plan.stamp.tick.saturating_mul(self.period_nanos),
            HORIZON_EVERY,
        ) {
            for (shown, rows) in [(Shown::Horizon, predicted), (Shown::Reference, reference)] {
                let poses = rows.iter().map(|&[x, y, yaw, ..]| Pose::plane(x, y, yaw)).collect();
                drawn.push((
                    shown,
                    Drawing::Poses(PosesInFrame { timestamp, frame_id: WORLD, poses }),
                ));
            }
        }
        drawn
    }
}

fn tracked(plan: &Plan, timestamp: Time) -> Tracking {
    let ([state, ..], [target, ..], [variance, ..]) =
        (plan.predicted, plan.reference, plan.variance);
    let length = |[forward, left, _]: [f64; 3]| forward.hypot(left);
    Tracking {
        timestamp,
        tick: plan.stamp.tick,
        position_error: plan.position_error(),
        heading_error: wrapped(state[2] - target[2]),
        speed: state[3].hypot(state[4]),
        residual: length(plan.residual),
        innovation: length(plan.innovation),
        standard_deviation: variance[0].max(variance[1]).max(0.0).sqrt(),
        model_version: plan.model_version,
        fallback_level: plan.fallback_level,
        tick_micros: plan.tick_nanos as f64 * 1e-3,
    }
}

/// To −π to π.
fn wrapped(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}

fn first<T>(rows: &[T], count: usize) -> &[T] {
    rows.get(..count).unwrap_or(rows)
}

/// Whether a drawing is due by the robot's clock \[ns\], which then counts from now on. A clock
/// that went back belongs to another plant.
fn is_due(last: &mut Option<u64>, now: u64, every: u64) -> bool {
    let due = last.is_none_or(|last| now < last || now - last >= every);
    if due {
        *last = Some(now);
    }
    due
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use std::f64::consts::TAU;

    fn state(tick: u64, pose: [f64; 3]) -> PlantState {
        let mut state = PlantState::zeroed();
        (state.stamp.epoch, state.stamp.tick, state.stamp.sent_nanos, state.pose) =
            (1, tick, 5, pose);
        state
    }

    fn shown(drawn: &[(Shown, Drawing)]) -> Vec<Shown> {
        drawn.iter().map(|(shown, _)| *shown).collect()
    }

    #[test]
    fn a_pose_is_drawn_with_each_state_and_a_bounded_path_once_a_second() {
        let mut easel = Easel::new(20_000_000);
        let mut paths = Vec::new();
        for tick in 0..1000 {
            let drawn = easel.draw_state(&state(tick, [0.03 * tick as f64, 0.0, 3.0]));
            assert_eq!(shown(&drawn)[..2], [Shown::Transform, Shown::Pose]);
            paths.extend(drawn.into_iter().filter_map(|(_, drawing)| match drawing {
                Drawing::Poses(path) => Some(path.poses.len()),
                _ => None,
            }));
        }
        assert_eq!(paths.len(), 20, "of 20 s");
        assert!(paths.is_sorted() && paths.last() == Some(&PATH_MAX), "{paths:?}");
        assert_eq!(easel.draw_state(&state(1000, [f64::NAN, 0.0, 0.0])), []);
    }

    #[test]
    fn a_restarted_plant_begins_another_path() {
        let mut easel = Easel::new(20_000_000);
        for tick in 0..10 {
            easel.draw_state(&state(tick, [tick as f64, 0.0, 0.0]));
        }
        let mut reborn = state(0, [0.0; 3]);
        reborn.stamp.epoch = 2;
        let drawn = easel.draw_state(&reborn);
        assert!(
            matches!(
                &drawn[..],
                [.., (Shown::Path, Drawing::Poses(path))] if path.poses.len() == 1
            ),
            "{drawn:?}"
        );
    }

    #[test]
    fn heading_is_a_rotation_about_the_vertical_and_what_is_drawn_has_few_digits()
    -> Result<(), serde_json::Error> {
        let half_turn = Pose::plane(1.234_567_89, -2.0, std::f64::consts::PI);
        let text = serde_json::to_string(&half_turn)?;
        assert!(text.len() < 130, "{text}");
        assert_eq!((half_turn.orientation.z, half_turn.orientation.w), (1.0, 0.0));
        Ok(())
    }

    #[test]
    fn a_plan_gives_plain_numbers_each_time_and_its_poses_ten_times_a_second() {
        let mut plan: Box<Plan> = Box::new(Plan::zeroed());
        plan.horizon = 4;
        plan.predicted[0] = [3.0, 4.0, 3.0, 0.6, 0.8, 0.0];
        plan.reference[0][2] = -3.0;
        plan.variance[0] = [0.04, 0.01, 0.0];
        let mut easel = Easel::new(20_000_000);
        let mut horizons = 0;
        for tick in 0..50 {
            plan.stamp.tick = tick;
            let drawn = easel.draw_plan(&plan);
            horizons += drawn.iter().filter(|(shown, _)| *shown == Shown::Horizon).count();
            assert!(
                matches!(&drawn[0], (Shown::Tracking, Drawing::Tracking(tracking))
                    if (tracking.position_error, tracking.speed, tracking.standard_deviation)
                        == (5.0, 1.0, 0.2)
                        && (tracking.heading_error - (6.0 - TAU)).abs() < 1e-12),
                "{drawn:?}"
            );
        }
        assert_eq!(horizons, 10);
        plan.predicted[2][1] = f64::INFINITY;
        assert_eq!(easel.draw_plan(&plan), []);
    }

    #[test]
    fn every_channel_has_its_own_name_and_a_schema_with_its_title() {
        let mut names: Vec<&str> = Shown::ALL.iter().map(|shown| shown.channel()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Shown::ALL.len());
        for shown in Shown::ALL {
            assert_eq!(shown.schema()["title"], shown.kind());
            assert!(
                protocol::topic::Topic::ALL.iter().all(|topic| topic.name() != shown.channel())
            );
        }
    }
}
