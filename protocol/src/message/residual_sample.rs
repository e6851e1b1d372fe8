//! controller → learner: what the main model got wrong in one period.

use super::define::message;

message! {
    /// One observation of the residual g (eq. 28), sent every tick so that the learner knows the
    /// current tick.
    ResidualSample = 3 {
        /// Epoch of the plant.
        plant_epoch: u64,
        /// Fingerprint of the main model that the residual belongs to.
        fingerprint: u64,
        /// Pose at the start of the period \[m, m, rad\].
        pose: [f64; 3],
        /// Body velocity at the start of the period \[m/s, m/s, rad/s\].
        velocity: [f64; 3],
        /// Input that acted on the wheels in the period \[m/s, m/s, rad/s\].
        input: [f64; 3],
        /// Input that acted in the period before \[m/s, m/s, rad/s\].
        input_before: [f64; 3],
        /// Dead time from a command to the first response, of which `input` and `input_before` take
        /// account \[s\].
        dead_time_s: f64,
        /// Velocity at the end of the period, measured minus predicted by the main model
        /// \[m/s, m/s, rad/s\].
        residual: [f64; 3],
        /// 1 if the sample can be learnt from, 0 if the gate chose its input, the robot slides or
        /// no period has passed.
        usable: u32 = flag,
        /// Always zero; not sent over the network.
        reserved: u32 = unused,
    }
}
