//! The channels for public viewers: their names, types and schemas.

use serde_json::{Value, json};

/// Content of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// `tf`
    Transform,
    /// `pose`
    Pose,
    /// `path`
    Path,
    /// `horizon`
    Horizon,
    /// `reference`
    Reference,
    /// `tracking`
    Tracking,
}

impl Shown {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Transform, Self::Pose, Self::Path, Self::Horizon, Self::Reference, Self::Tracking];

    /// Name of its channel.
    pub const fn channel(self) -> &'static str {
        match self {
            Self::Transform => "tf",
            Self::Pose => "pose",
            Self::Path => "path",
            Self::Horizon => "horizon",
            Self::Reference => "reference",
            Self::Tracking => "tracking",
        }
    }

    /// Name of its type.
    pub const fn kind(self) -> &'static str {
        match self {
            Self::Transform => "foxglove.FrameTransform",
            Self::Pose => "foxglove.PoseInFrame",
            Self::Path | Self::Horizon | Self::Reference => "foxglove.PosesInFrame",
            Self::Tracking => "coxswain.Tracking",
        }
    }

    /// JSON Schema of its type.
    pub fn schema(self) -> Value {
        let pose = || object(&[("position", vector()), ("orientation", quaternion())]);
        let text = || json!({"type": "string"});
        let mut schema = match self {
            Self::Transform => object(&[
                ("timestamp", time()),
                ("parent_frame_id", text()),
                ("child_frame_id", text()),
                ("translation", vector()),
                ("rotation", quaternion()),
            ]),
            Self::Pose => object(&[("timestamp", time()), ("frame_id", text()), ("pose", pose())]),
            Self::Path | Self::Horizon | Self::Reference => object(&[
                ("timestamp", time()),
                ("frame_id", text()),
                ("poses", json!({"type": "array", "items": pose()})),
            ]),
            Self::Tracking => tracking(),
        };
        if let Value::Object(entries) = &mut schema {
            entries.insert("title".to_owned(), json!(self.kind()));
        }
        schema
    }
}

fn object(fields: &[(&str, Value)]) -> Value {
    let properties: serde_json::Map<String, Value> =
        fields.iter().map(|(name, schema)| ((*name).to_owned(), schema.clone())).collect();
    json!({"type": "object", "properties": properties})
}

fn time() -> Value {
    let mut schema = object(&[
        ("sec", json!({"type": "integer", "minimum": 0})),
        ("nsec", json!({"type": "integer", "minimum": 0})),
    ]);
    if let Value::Object(entries) = &mut schema {
        entries.insert("title".to_owned(), json!("time"));
    }
    schema
}

fn vector() -> Value {
    object(&["x", "y", "z"].map(|name| (name, json!({"type": "number"}))))
}

fn quaternion() -> Value {
    object(&["x", "y", "z", "w"].map(|name| (name, json!({"type": "number"}))))
}

fn tracking() -> Value {
    let number = |about: &str| json!({"type": "number", "description": about});
    object(&[
        ("timestamp", time()),
        ("tick", number("control period")),
        ("position_error", number("distance of the measured position from the reference [m]")),
        ("heading_error", number("measured yaw minus that of the reference, wrapped [rad]")),
        ("speed", number("measured speed over the ground [m/s]")),
        (
            "residual",
            number(
                "velocity after the past period, measured minus predicted by the main model, \
                 length in the plane [m/s]",
            ),
        ),
        ("innovation", number("the same of the whole model [m/s]")),
        (
            "standard_deviation",
            number(
                "of the learned residual at the measured state, \
                 larger one of forward and left [m/s]",
            ),
        ),
        ("model_version", number("learned model in use, 0 is the main model alone")),
        (
            "fallback_level",
            number(
                "of the controller: 1 fresh plan, 2 shifted plan, 3 simple controller, \
                 and so on down",
            ),
        ),
        ("tick_micros", number("from the receipt of the state to the finished command [us]")),
    ])
}
