//! Period, horizon and weights that fit a response: a variant of a scenario.
//!
//! The period is at most half of the shortest time constant, so that the controller sees a response
//! while it happens, but not below 10 ms. The horizon covers the dead time and twice the longest
//! time constant, and has 5 to 40 periods. Inputs are free for 0.2 s. The weights are those of the
//! profiles, which are not searched anew: `docs/results.md` has their rule.

use protocol::message::HORIZON_MAX;
use robot::{AXES, Response};

/// Periods that are recommended \[ms\].
const PERIODS_MILLIS: [f64; 4] = [10.0, 20.0, 50.0, 100.0];
/// Shortest recommended horizon \[periods\].
const HORIZON_MIN: usize = 5;
/// Time for which inputs are free \[ms\].
const FREE_MILLIS: f64 = 200.0;
/// Below this period the noise of the sensors would change the inputs too much with the weight of
/// the longer ones \[ms\].
const AGILE_BELOW_MILLIS: f64 = 50.0;

/// Period, horizon and the profile whose weights fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recommendation {
    /// T \[ms\].
    pub period_millis: f64,
    /// N \[periods\].
    pub horizon_steps: usize,
    /// Periods in which the inputs are free.
    pub control_horizon_steps: usize,
    /// Profile whose weights fit: `paper` or `agile`.
    pub profile: &'static str,
    /// Weight on the change of the input, which is the weight in which the profiles differ.
    pub input_change: f64,
}

/// What fits a robot with this response, of which `axes` are moved.
pub fn recommendation(response: &Response, axes: [bool; AXES]) -> Recommendation {
    let constants = || (0..AXES).filter(|&axis| axes[axis]).map(|it| response.time_constant_s[it]);
    let shortest = constants().fold(f64::INFINITY, f64::min);
    let longest = constants().fold(0.0, f64::max);
    let dead = response.dead_time_s;
    let fits = |period: &&f64| **period * 1e-3 <= 0.5 * shortest;
    let period_millis = PERIODS_MILLIS.iter().rev().find(fits).copied().unwrap_or(10.0);
    let horizon = ((dead + 2.0 * longest) / (period_millis * 1e-3)).ceil() as usize;
    let horizon_steps = horizon.clamp(HORIZON_MIN, HORIZON_MAX);
    let is_agile = period_millis < AGILE_BELOW_MILLIS;
    Recommendation {
        period_millis,
        horizon_steps,
        control_horizon_steps: ((FREE_MILLIS / period_millis) as usize)
            .clamp(HORIZON_MIN, horizon_steps),
        profile: if is_agile { "agile" } else { "paper" },
        input_change: if is_agile { 0.3 } else { 0.05 },
    }
}

/// The variant, as TOML. The learner fits a model every half second.
pub fn variant(recommended: &Recommendation, source: &str) -> String {
    let Recommendation { period_millis, horizon_steps, control_horizon_steps, .. } = recommended;
    let Recommendation { profile, input_change, .. } = recommended;
    let every_ticks = (500.0 / period_millis).round();
    let delay_ticks = (100.0 / period_millis).ceil().max(3.0);
    let is_agile = *period_millis < AGILE_BELOW_MILLIS;
    // At so short a period the heading as an input brings nothing.
    let layout = if is_agile { "layout = \"velocity-slip\"\n" } else { "" };
    format!(
        "# Period, horizon and weights for the robot that `coxswain identify` has identified from\n\
         # {source}.\n\
         # Put this file into the folder `variants` beside a scenario, and launch\n\
         # `SCENARIO+tuned`.\n\n\
         period_millis = {period_millis}\n\n\
         [mpc]\n\
         horizon_steps = {horizon_steps}\n\
         control_horizon_steps = {control_horizon_steps}\n\n\
         # Those of the profile {profile}.\n\
         [mpc.weights]\n\
         position = 300.0\n\
         heading = 5.0\n\
         velocity = 10.0\n\
         yaw_rate = 1.0\n\
         input = 0.05\n\
         input_change = {input_change}\n\
         terminal_factor = 3.0\n\n\
         # A fit every half second.\n\
         [learner]\n\
         every_ticks = {every_ticks}\n\
         delay_ticks = {delay_ticks}\n\
         {layout}"
    )
}
