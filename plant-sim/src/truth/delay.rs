//! The delay of a command from the gate to the motors.

use nalgebra::Vector3;

/// A ring of the commands under way, one per step.
#[derive(Debug, Clone)]
pub(super) struct DelayLine {
    under_way: Vec<Vector3<f64>>,
    oldest: usize,
}

impl DelayLine {
    /// A delay of this many steps, filled with zero commands. Allocates, here only.
    pub(super) fn new(steps: usize) -> Self {
        Self { under_way: vec![Vector3::zeros(); steps], oldest: 0 }
    }

    /// Stores the command of this step and returns the one that arrives. O(1); does not allocate.
    pub(super) fn pass(&mut self, command: Vector3<f64>) -> Vector3<f64> {
        let Some(slot) = self.under_way.get_mut(self.oldest) else {
            return command;
        };
        let arrived = core::mem::replace(slot, command);
        self.oldest = (self.oldest + 1) % self.under_way.len();
        arrived
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_arrives_once_after_exactly_the_delay() {
        for delay in [0_u32, 1, 2, 7] {
            let mut line = DelayLine::new(delay as usize);
            for step in 0..20_u32 {
                let arrived = line.pass(Vector3::repeat(f64::from(step + 1)));
                let expected = f64::from((step + 1).saturating_sub(delay));
                assert_eq!(arrived, Vector3::repeat(expected), "delay {delay}, step {step}");
            }
        }
    }
}
