//! plant-sim
pub mod truth;
