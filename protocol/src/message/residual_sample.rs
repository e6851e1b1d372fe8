//! controller → learner: what the main model got wrong in one period.

use super::{Stamp, check_count, fixed_message};
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// One observation of the residual g (eq. 28), sent every tick so that the learner knows the
/// current tick.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct ResidualSample {
    /// Writer and time; `tick` is the one that ended the period.
    pub stamp: Stamp,
    /// Epoch of the plant.
    pub plant_epoch: u64,
    /// Fingerprint of the main model that the residual belongs to.
    pub fingerprint: u64,
    /// Pose at the start of the period \[m, m, rad\].
    pub pose: [f64; 3],
    /// Body velocity at the start of the period \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Input that acted on the wheels in the period \[m/s, m/s, rad/s\].
    pub input: [f64; 3],
    /// Input that acted in the period before \[m/s, m/s, rad/s\].
    pub input_before: [f64; 3],
    /// Velocity at the end of the period, measured minus predicted by the main model
    /// \[m/s, m/s, rad/s\].
    pub residual: [f64; 3],
    /// 1 if the sample can be learnt from, 0 if the gate chose its input or no period has passed.
    pub usable: u32,
    /// Always zero; not sent over the network.
    #[serde(skip)]
    pub reserved: u32,
}

fixed_message!(ResidualSample, 3, [pose, velocity, input, input_before, residual], |sample| {
    check_count("ResidualSample", "usable", sample.usable, 1)
});
