//! A snapshot of another robot file as prior knowledge: its data, for this main model, with more
//! noise.
//!
//! The measured velocity does not depend on the main model, so with f of each of the two:
//!
//! ```text
//! v⁺ = f_from(v, u) + g_from = f(v, u) + g      ⇒      g = g_from + f_from(v, u) − f(v, u)
//! ```

use model::gp::dictionary::Observation;
use model::learned::Layout;
use model::main_model::MainModel;
use model::{AXES, Velocity};
use protocol::message::ModelSnapshot;

/// Noise of the carried data, per noise that it has: close relatives, and distant ones.
pub const NOISES: [f64; 2] = [3.0, 30.0];

/// Observations with the scale of their noise.
pub type Prior<const D: usize> = Vec<(Observation<D>, f64)>;

/// The data of `snapshot`, which was learned with the main model `from`, for the main model `to`.
/// Residuals beyond `bound` are left out.
pub fn carried<const D: usize>(
    snapshot: &ModelSnapshot,
    layout: Layout,
    [from, to]: [&MainModel; 2],
    bound: &Velocity,
    noise: f64,
) -> Prior<D> {
    let head = &snapshot.head;
    let observation = |input: &[f64], target: &[f64]| {
        let mut inputs = [0.0; D];
        let scales = head.input_mean.iter().zip(&head.input_scale);
        for ((input, normalised), (mean, scale)) in inputs.iter_mut().zip(input).zip(scales) {
            *input = mean + scale * normalised;
        }
        let at = layout.moment(&inputs);
        let [before, after] = [from, to].map(|main| main.next_velocity(&at.velocity, &at.input));
        let mut residual = [0.0; AXES];
        for (axis, (residual, target)) in residual.iter_mut().zip(target).enumerate() {
            *residual = target + before[axis] - after[axis];
        }
        Observation { input: inputs, target: residual }
    };
    snapshot
        .rows()
        .map(|row| (observation(row.input, row.target), noise * row.noise_scale))
        .filter(|(observation, _)| {
            observation.target.iter().zip(bound).all(|(target, bound)| target.abs() <= *bound)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::learned::{INPUTS, Moment};
    use model::residual::residual;
    use protocol::message::SnapshotHead;

    /// What both main models and their residuals predict is the same velocity.
    #[test]
    fn carried_data_predict_the_same_velocity() -> Result<(), Box<dyn std::error::Error>> {
        let layout = Layout::VelocitySlip;
        let from = MainModel::lagging(&[0.2; AXES], 0.05);
        let to = MainModel::lagging(&[0.3, 0.1, 0.15], 0.05);
        let at =
            Moment { velocity: [0.5, -0.25, 1.0], input: [0.75, 0.0, 0.5], ..Moment::default() };
        let after = [0.6, -0.2, 0.8];
        let mut head: SnapshotHead = bytemuck::Zeroable::zeroed();
        head.inputs = INPUTS as u32;
        head.input_scale = [0.5; 12];
        let mut snapshot = ModelSnapshot::new(head);
        let inputs = layout.inputs::<INPUTS>(&at).map(|input| input / 0.5);
        let target = residual(&from, &at.velocity, &at.input, &after);
        snapshot.push_with_noise(&inputs, target, [0.0; AXES], 2.0)?;
        let carried = carried::<INPUTS>(&snapshot, layout, [&from, &to], &[1.0; AXES], 3.0);
        let expected = residual(&to, &at.velocity, &at.input, &after);
        let [(observation, noise)] = carried.as_slice() else { return Err("one point".into()) };
        assert!((noise - 6.0).abs() < 1e-12);
        for axis in 0..AXES {
            assert!((observation.target[axis] - expected[axis]).abs() < 1e-12);
        }
        Ok(())
    }
}
