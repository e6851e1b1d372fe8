//! PlantState in, Command out: the learning model predictive controller.
//!
//! | module        | what it does                                                              |
//! |---------------|---------------------------------------------------------------------------|
//! | [`settings`]  | what a person may set                                                     |
//! | [`mod@reference`] | what to follow: pose and velocity per tick                                |
//! | [`mpc`]       | state, reference and belief in, plan out: one real-time iteration         |
//! | [`currents`]  | whether motors carry what the current rows foretell                       |
//! | [`adopt`]     | model snapshots in: checked and prepared beside the control thread        |
//! | [`fallback`]  | what to command when the optimiser has no answer                          |
//! | [`sensors`]   | what cannot have been measured: no numbers, or stuck ones                 |
//! | [`tracking`]  | how far from the reference the robot may be before the gate is asked to stop |
//! | [`complaints`] | what is wrong with driver or robot file, as far as states tell           |
//! | [`control`]   | one tick: answer the state, then say what was learnt                      |
//! | [`knowledge`] | what is believed at one moment, and how it follows what is seen           |
//! | [`explanations`] | no harm: models with observers, and the one that is used on each axis  |
//! | [`identified`] | what was identified, kept for a later run                                |
//! | [`loop_judge`] | whether plans hold the robot, or the simple controller shall drive       |
//! | [`pose`]      | where the robot is, by measured poses and velocities                      |
//! | [`run`]       | the loop: the only place with a clock and a stop signal                   |

pub mod adopt;
pub mod complaints;
pub mod control;
pub mod currents;
pub mod explanations;
pub mod fallback;
pub mod identified;
pub mod knowledge;
pub mod loop_judge;
pub mod mpc;
pub mod pose;
pub mod reference;
pub mod run;
pub mod sensors;
pub mod settings;
#[cfg(test)]
mod told_in_health;
pub mod tracking;

pub use settings::Settings;
