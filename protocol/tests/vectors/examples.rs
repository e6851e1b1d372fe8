//! The messages of the vectors: a typical one, and the edges of each field.

use bytemuck::Zeroable;
use protocol::message::{
    Command, Credit, Exposure, FallbackLevel, GateState, Goal, GoalKind, GoalPhase, HORIZON_MAX,
    Health, INPUTS_MAX, ModelSnapshot, OBSTACLE_NUMBERS, OBSTACLES_MAX, ObstacleSource, Obstacles,
    Participant, Phase, Plan, PlantState, Reason, ResidualSample, SnapshotHead, SolverStatus,
    Stamp, TAIL_MAX, Truth, WHEELS_MAX,
};
use protocol::topic::OnTopic;
use serde_json::{Value, json};

fn typical() -> Stamp {
    Stamp {
        writer: 0x1234_5678_9abc_def0,
        epoch: 3,
        sequence: 1041,
        tick: 1040,
        sent_nanos: 52_000_123_456_789,
        ..Stamp::default()
    }
}

fn extreme() -> Stamp {
    Stamp {
        writer: u64::MAX,
        epoch: u64::MAX,
        sequence: u64::MAX,
        tick: u64::MAX,
        sent_nanos: u64::MAX,
        ..Stamp::default()
    }
}

const EDGES: [f64; 3] = [f64::MAX, f64::MIN_POSITIVE, -0.0];

/// A message with examples, each with a name.
pub(crate) trait Examples: OnTopic + PartialEq + std::fmt::Debug {
    fn examples() -> Vec<(&'static str, Self)>;

    /// Its fields, those of the data points included.
    fn in_json(&self) -> Value;
}

macro_rules! examples {
    ($($message:ident: $examples:expr,)+) => {
        $(impl Examples for $message {
            fn examples() -> Vec<(&'static str, Self)> {
                $examples
            }

            fn in_json(&self) -> Value {
                json!(self)
            }
        })+
    };
}

examples! {
    PlantState: vec![
        ("typical", PlantState {
            stamp: typical(),
            pose: [1.25, -0.5, 3.0],
            velocity: [0.8, 0.1, -0.2],
            wheel_speed: [10.0, 11.0, 10.5, 9.75, 0.0, 0.0, 0.0, 0.0],
            current: [1.5, 1.25, 1.0, 0.75, 0.0, 0.0, 0.0, 0.0],
            input: [0.85, 0.1, -0.25],
            input_delay_s: 0.02,
            controller_epoch: 2,
            accepted_epoch: 2,
            accepted_tick: 1039,
            refused: 1,
            fallback_level: FallbackLevel::FreshPlan.code(),
            reason: Reason::None.code(),
            wheels: 4,
            wheel_speed_valid: 1,
            current_valid: 1,
            gate: GateState::Driving.code(),
            ..PlantState::zeroed()
        }),
        ("before the first command", PlantState {
            stamp: Stamp {
                writer: 7,
                epoch: 1,
                sequence: 1,
                tick: 0,
                sent_nanos: 1,
                ..Stamp::default()
            },
            fallback_level: FallbackLevel::Waiting.code(),
            reason: Reason::NoCommandYet.code(),
            wheels: 4,
            gate: GateState::Armed.code(),
            ..PlantState::zeroed()
        }),
        ("three omni wheels, no currents", PlantState {
            stamp: typical(),
            pose: [-2.0, 0.75, -1.5],
            velocity: [0.25, -0.5, 0.75],
            wheel_speed: [-5.5, 3.25, 15.5, 0.0, 0.0, 0.0, 0.0, 0.0],
            input: [0.25, -0.5, 1.0],
            controller_epoch: 4,
            accepted_epoch: 4,
            accepted_tick: 1038,
            fallback_level: FallbackLevel::StoredTail.code(),
            reason: Reason::Missing.code(),
            wheels: 3,
            wheel_speed_valid: 1,
            gate: GateState::Driving.code(),
            ..PlantState::zeroed()
        }),
        ("a base without wheels that it knows", PlantState {
            stamp: typical(),
            pose: [0.5, 0.5, 0.0],
            velocity: [0.125, 0.0, 0.0],
            input_delay_s: 0.06,
            controller_epoch: 1,
            accepted_epoch: 1,
            accepted_tick: 900,
            fallback_level: FallbackLevel::LatchedStop.code(),
            reason: Reason::EmergencyStop.code(),
            estop: 1,
            gate: GateState::Stopped.code(),
            stop: Reason::EmergencyStop.code(),
            ..PlantState::zeroed()
        }),
        ("extreme", PlantState {
            stamp: extreme(),
            pose: EDGES,
            refused: u64::MAX,
            fallback_level: FallbackLevel::LatchedStop.code(),
            reason: Reason::Recovering.code(),
            wheels: WHEELS_MAX as u32,
            wheel_speed: [f64::MIN; WHEELS_MAX],
            wheel_speed_valid: 1,
            estop: 1,
            gate: GateState::Stopped.code(),
            stop: Reason::EmergencyStop.code(),
            ..PlantState::zeroed()
        }),
    ],
    Command: vec![
        ("typical", Command {
            stamp: typical(),
            plant_epoch: 1,
            model_version: 12,
            input: [0.5, -0.25, 0.125],
            tail: [[0.5, -0.25, 0.0], [0.25, 0.0, 0.0], [0.0; 3], [0.0; 3]],
            tail_len: 3,
            fallback_level: FallbackLevel::FreshPlan.code(),
            ..Command::zeroed()
        }),
        ("without a tail", Command {
            stamp: typical(),
            fallback_level: FallbackLevel::Brake.code(),
            ..Command::zeroed()
        }),
        ("extreme", Command {
            stamp: extreme(),
            plant_epoch: u64::MAX,
            model_version: u64::MAX,
            input: EDGES,
            tail: [EDGES; TAIL_MAX],
            tail_len: TAIL_MAX as u32,
            fallback_level: FallbackLevel::LatchedStop.code(),
            stop: Reason::HeadingError.code(),
            ..Command::zeroed()
        }),
    ],
    ResidualSample: vec![
        ("typical", ResidualSample {
            stamp: typical(),
            plant_epoch: 1,
            fingerprint: 0xfeed_beef,
            pose: [1.0, 2.0, 0.5],
            velocity: [0.75, 0.0, 0.25],
            input: [1.0, 0.0, 0.25],
            input_before: [0.875, 0.0, 0.5],
            dead_time_s: 0.0625,
            residual: [-0.03125, 0.0, 0.015_625],
            usable: 1,
            reserved: 0,
        }),
        ("extreme", ResidualSample {
            stamp: extreme(),
            fingerprint: u64::MAX,
            residual: EDGES,
            ..ResidualSample::zeroed()
        }),
    ],
    Credit: vec![
        ("typical", Credit {
            stamp: typical(),
            through_tick: 1064,
            participant: Participant::Recorder.code(),
            reserved: 0,
        }),
        ("extreme", Credit {
            stamp: extreme(),
            through_tick: u64::MAX,
            participant: Participant::Gateway.code(),
            reserved: 0,
        }),
    ],
    Goal: vec![
        ("typical", Goal {
            stamp: typical(),
            id: 7,
            plant_epoch: 1,
            begins_at_tick: 1000,
            ends_at_tick: 1100,
            target: [2.0, 1.0, 1.5],
            progress: 0.5,
            left_m: 1.25,
            left_s: 1.2,
            kind: GoalKind::Pose.code(),
            phase: GoalPhase::Active.code(),
        }),
        ("extreme", Goal {
            stamp: extreme(),
            id: u64::MAX,
            ends_at_tick: u64::MAX,
            target: EDGES,
            ..Goal::zeroed()
        }),
    ],
    Obstacles: vec![
        ("typical", Obstacles {
            stamp: typical(),
            plant_epoch: 1,
            age_s: 0.05,
            valid_s: 0.5,
            source: ObstacleSource::Planner.code(),
            count: 2,
            obstacles: {
                let mut rows = [[0.0; OBSTACLE_NUMBERS]; OBSTACLES_MAX];
                // A disc that moves, and a rectangle that stands.
                rows[0] = [
                    0.5, -0.25, 0.3, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0,
                    2.0, 1.0, 2.0, 1.0,
                ];
                rows[1] = [
                    0.0, 0.0, 0.0, 3.0, 0.0, 4.0, 0.0, 4.0, 0.5, 3.0, 0.5, 3.0, 0.5, 3.0, 0.5, 3.0,
                    0.5, 3.0, 0.5,
                ];
                rows
            },
        }),
        ("extreme", Obstacles {
            stamp: extreme(),
            plant_epoch: u64::MAX,
            valid_s: f64::MAX,
            count: OBSTACLES_MAX as u32,
            obstacles: [[-0.0; OBSTACLE_NUMBERS]; OBSTACLES_MAX],
            ..Obstacles::zeroed()
        }),
    ],
    Truth: vec![
        ("typical", Truth {
            stamp: typical(),
            pose: [1.25, -0.5, 3.0],
            velocity: [0.8, 0.1, -0.2],
            force: [4.0, 0.0, 0.5],
            wheel_command: [10.0, 11.0, 10.5, 9.75, 0.0, 0.0, 0.0, 0.0],
            wheel_peak: [10.0, 11.25, 10.5, 9.75, 0.0, 0.0, 0.0, 0.0],
            acting_epoch: 2,
            acting_writer: 0x1234_5678_9abc_def0,
            acting_tick: 1039,
            acting_age_nanos: 150_000_000,
            takeovers: 1,
            takeovers_back: 0,
            fallback_level: FallbackLevel::StoredTail.code(),
            reason: Reason::Missing.code(),
            wheels: 4,
            reserved: 0,
        }),
        ("extreme", Truth {
            stamp: extreme(),
            force: EDGES,
            acting_tick: u64::MAX,
            ..Truth::zeroed()
        }),
    ],
    Plan: vec![
        ("typical", {
            let mut plan = Plan {
                stamp: typical(),
                plant_epoch: 1,
                model_version: 12,
                horizon: 2,
                status: SolverStatus::Solved.code(),
                iterations: 9,
                fallback_level: FallbackLevel::FreshPlan.code(),
                learned_axes: 5,
                delay_micros: 20_000,
                tick_nanos: 1_250_000,
                linearise_nanos: 250_000,
                solve_nanos: 750_000,
                disturbance: [0.5, 0.25, 0.125],
                innovation: [0.0625, 0.0, 0.0],
                residual: [-0.03125, 0.0, 0.0],
                ..Plan::zeroed()
            };
            plan.predicted[0] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
            plan.predicted[2] = [1.5; 6];
            plan.reference[1] = [-1.0; 6];
            plan.variance[2] = [0.01; 3];
            plan.input[1] = [0.5, 0.25, 0.0];
            plan
        }),
        ("without a horizon", Plan { stamp: typical(), ..Plan::zeroed() }),
        ("extreme", Plan {
            stamp: extreme(),
            horizon: HORIZON_MAX as u32,
            iterations: u32::MAX,
            solve_nanos: u64::MAX,
            disturbance: EDGES,
            input: [EDGES; HORIZON_MAX],
            ..Plan::zeroed()
        }),
    ],
    Health: vec![
        ("typical", {
            let mut health = Health {
                stamp: typical(),
                participant: Participant::Controller.code(),
                phase: Phase::Degraded.code(),
                pid: 4711,
                exposure: Exposure::Driven.code(),
                heartbeat: 1040,
                deadlines_met: 1038,
                deadlines_missed: 2,
                model_version: 12,
                learned_axes: 5,
                models_left: 3,
                snapshots: 12,
                snapshots_refused: 1,
                sent: [0, 1040, 1040, 0, 1040, 104, 0, 0, 0, 0],
                received: [1041, 0, 0, 13, 0, 0, 0, 0, 0, 0],
                dropped: [0, 2, 0, 0, 0, 0, 0, 0, 0, 0],
                ..Health::zeroed()
            };
            health.set_last_error("snapshot 9 refused: α differs");
            health
        }),
        ("extreme", {
            let mut health = Health {
                stamp: extreme(),
                pid: u32::MAX,
                lost: [u64::MAX; 10],
                ..Health::zeroed()
            };
            health.set_last_error(&"x".repeat(120));
            health
        }),
    ],
}

impl Examples for ModelSnapshot {
    fn examples() -> Vec<(&'static str, Self)> {
        let mut head = SnapshotHead {
            stamp: typical(),
            version: 12,
            fingerprint: 0xfeed_beef,
            effective_tick: 1060,
            plant_epoch: 1,
            inputs: 2,
            score_samples: 40,
            signal_variance: [1.0, 2.0, 3.0],
            linear_variance: [0.5, 0.25, 0.0],
            place_variance: [0.125, 0.0, 0.0],
            noise_variance: [0.01; 3],
            sample_variance: [0.02; 3],
            score_learned: [0.125; 3],
            score_main: [0.25; 3],
            ..SnapshotHead::zeroed()
        };
        head.input_scale = [1.0; INPUTS_MAX];
        head.length_scale[0][1] = 0.5;
        head.length_scale[2][0] = 1.5;
        let mut typical = Self::new(head);
        for (input, target, noise_scale, weight) in [
            ([1.0, -1.0], [0.1, 0.2, 0.3], 1.0, [4.0, 5.0, 6.0]),
            ([0.5, 0.25], EDGES, 2.5, [7.0, 8.0, 9.0]),
        ] {
            typical.push_with_noise(&input, target, weight, noise_scale).unwrap_or_default();
        }
        let empty =
            SnapshotHead { stamp: extreme(), inputs: INPUTS_MAX as u32, ..SnapshotHead::zeroed() };
        vec![("typical", typical), ("without points", Self::new(empty))]
    }

    fn in_json(&self) -> Value {
        let rows = self.rows().map(|row| (row.input, row.target, row.noise_scale, row.weight));
        json!({"head": self.head, "rows": rows.map(|row| json!(row)).collect::<Vec<_>>()})
    }
}
