//! model
pub mod gp;
