//! PlantState in, Command out: the learning model predictive controller.
//!
//! | module             | what it does                                                         |
//! |--------------------|----------------------------------------------------------------------|
//! | [`settings`]       | settings of the controller                                           |
//! | [`mod@reference`]  | the reference: pose and velocity per tick                            |
//! | [`goal`]           | a goal that is given while the robot drives → a reference            |
//! | [`mpc`]            | state, reference and belief in, plan out: one real-time iteration    |
//! | [`currents`]       | whether motors carry the current that the current rows predict       |
//! | [`adopt`]          | model snapshots in: checked and prepared beside the control thread   |
//! | [`fallback`]       | the command when the optimiser has no answer                         |
//! | [`sensors`]        | measurements that cannot be true: not finite, or stuck               |
//! | [`tracking`]       | tracking error at which the gate is requested to stop the robot      |
//! | [`complaints`]     | errors of driver or robot file that show in the states               |
//! | [`control`]        | one tick: answer the state, then publish the residual                |
//! | [`knowledge`]      | the current belief, and its update by measurements                   |
//! | [`explanations`]   | no harm: models with observers, and the one in use on each axis      |
//! | [`identified`]     | identified parameters, saved for a later run                         |
//! | [`loop_judge`]     | whether plans hold the robot, or the simple controller must drive    |
//! | [`pose`]           | the robot's pose, from measured poses and velocities                 |
//! | [`run`]            | the loop: the only place with a clock and a stop signal              |

pub mod adopt;
pub mod complaints;
pub mod control;
pub mod currents;
pub mod explanations;
pub mod fallback;
pub mod goal;
pub mod grip;
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
