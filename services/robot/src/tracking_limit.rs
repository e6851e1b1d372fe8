//! Largest distance of a robot from its reference before it is stopped.

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt::{self, Formatter};

/// A limit of the tracking error: a number, `"none"`, or absent for the default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum TrackingLimit {
    /// The default, which scales with the size of the robot.
    #[default]
    Default,
    /// No limit.
    Off,
    /// This limit \[m, or rad\].
    At(f64),
}

impl TrackingLimit {
    /// The limit, if there is one.
    pub fn or(self, default: f64) -> Option<f64> {
        match self {
            Self::Default => Some(default),
            Self::Off => None,
            Self::At(limit) => Some(limit),
        }
    }
}

impl Serialize for TrackingLimit {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Default => serializer.serialize_str("default"),
            Self::Off => serializer.serialize_str("none"),
            Self::At(limit) => serializer.serialize_f64(*limit),
        }
    }
}

impl<'de> Deserialize<'de> for TrackingLimit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Limit;
        impl Visitor<'_> for Limit {
            type Value = TrackingLimit;

            fn expecting(&self, f: &mut Formatter<'_>) -> fmt::Result {
                f.write_str("a number greater than 0, \"none\" or \"default\"")
            }

            fn visit_f64<E: Error>(self, limit: f64) -> Result<TrackingLimit, E> {
                Ok(TrackingLimit::At(limit))
            }

            fn visit_i64<E: Error>(self, limit: i64) -> Result<TrackingLimit, E> {
                Ok(TrackingLimit::At(limit as f64))
            }

            fn visit_u64<E: Error>(self, limit: u64) -> Result<TrackingLimit, E> {
                Ok(TrackingLimit::At(limit as f64))
            }

            fn visit_str<E: Error>(self, word: &str) -> Result<TrackingLimit, E> {
                match word {
                    "none" => Ok(TrackingLimit::Off),
                    "default" => Ok(TrackingLimit::Default),
                    _ => Err(E::invalid_value(serde::de::Unexpected::Str(word), &self)),
                }
            }
        }
        deserializer.deserialize_any(Limit)
    }
}
