//! State of the gate: whether commands may drive the wheels.
//!
//! ```text
//!  disarmed ── arm ──▶ armed ── an accepted command acts ──▶ driving
//!                       ▲  │                                    │
//!                  resume  └──── stop(reason), stop order ──────┤
//!                       │                                       ▼
//!                       └──────────────────────────────────── stopped
//! ```
//! A stop is latched: only an operator's order leaves it, neither a command nor another controller.
//! A stop order stops in every state: a disarmed gate has to be resumed then, and is armed by that.

use protocol::message::{GateState, Reason};

/// An operator's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Disarmed → armed.
    Arm,
    /// Stopped → armed.
    Resume,
    /// Any state → stopped.
    Stop,
}

impl Order {
    /// All orders.
    pub const ALL: [Self; 3] = [Self::Arm, Self::Resume, Self::Stop];

    /// Its name on the command line and in its file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Arm => "arm",
            Self::Resume => "resume",
            Self::Stop => "stop",
        }
    }

    /// The only state in which it is valid; `None` if it is valid in all.
    pub const fn leaves(self) -> Option<GateState> {
        match self {
            Self::Arm => Some(GateState::Disarmed),
            Self::Resume => Some(GateState::Stopped),
            Self::Stop => None,
        }
    }
}

/// The order is invalid in the present state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum OrderError {
    /// The order belongs to another state.
    #[error("the gate is {found}, expected {expected}")]
    WrongState {
        /// State of the gate.
        found: GateState,
        /// State in which the order is valid.
        expected: GateState,
    },
    /// The robot's own emergency stop is still pressed.
    #[error("the emergency stop of the robot is pressed; release it first")]
    EmergencyStop,
}

/// State of the gate, and why it has stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Machine {
    state: GateState,
    stop: Reason,
    estop: bool,
}

impl Machine {
    /// Armed: the first accepted command drives.
    pub const fn armed() -> Self {
        Self { state: GateState::Armed, stop: Reason::None, estop: false }
    }

    /// Disarmed: waits for an order.
    pub const fn disarmed() -> Self {
        Self { state: GateState::Disarmed, ..Self::armed() }
    }

    /// Present state.
    pub const fn state(&self) -> GateState {
        self.state
    }

    /// Why the gate has stopped; [`Reason::None`] if it has not.
    pub const fn stop_reason(&self) -> Reason {
        self.stop
    }

    /// Whether the emergency stop is pressed.
    pub const fn estop(&self) -> bool {
        self.estop
    }

    /// Notes that an accepted command acts.
    pub fn drive(&mut self) {
        if self.state == GateState::Armed {
            self.state = GateState::Driving;
        }
    }

    /// Stops and latches. The first reason stays until the gate is resumed.
    pub fn stop(&mut self, reason: Reason) {
        if self.state != GateState::Stopped {
            (self.state, self.stop) = (GateState::Stopped, reason);
        }
    }

    /// Sets whether the robot's own emergency stop is pressed. Pressing it stops the gate;
    /// releasing it leaves the gate stopped.
    pub fn set_estop(&mut self, pressed: bool) {
        self.estop = pressed;
        if pressed {
            self.stop(Reason::EmergencyStop);
        }
    }

    /// Executes an operator's order.
    ///
    /// # Errors
    /// [`OrderError`] if the order is invalid in the present state; the state stays.
    pub fn order(&mut self, order: Order) -> Result<(), OrderError> {
        let Some(expected) = order.leaves() else {
            self.stop(Reason::OperatorStop);
            return Ok(());
        };
        if self.state != expected {
            return Err(OrderError::WrongState { found: self.state, expected });
        }
        if self.estop {
            return Err(OrderError::EmergencyStop);
        }
        (self.state, self.stop) = (GateState::Armed, Reason::None);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_resume_leaves_a_stop_which_keeps_its_first_reason() {
        let mut machine = Machine::armed();
        machine.drive();
        assert_eq!(machine.state(), GateState::Driving);
        machine.stop(Reason::PositionError);
        machine.stop(Reason::HeadingError);
        machine.drive();
        assert_eq!(
            (machine.state(), machine.stop_reason()),
            (GateState::Stopped, Reason::PositionError)
        );
        assert!(machine.order(Order::Arm).is_err());
        assert_eq!(machine.order(Order::Resume), Ok(()));
        assert_eq!((machine.state(), machine.stop_reason()), (GateState::Armed, Reason::None));
    }

    #[test]
    fn only_arm_leaves_the_disarmed_state() {
        let mut machine = Machine::disarmed();
        machine.drive();
        let found = GateState::Disarmed;
        assert_eq!(
            machine.order(Order::Resume),
            Err(OrderError::WrongState { found, expected: GateState::Stopped })
        );
        assert_eq!(machine.state(), found);
        assert_eq!(machine.order(Order::Arm), Ok(()));
        machine.drive();
        assert_eq!(machine.state(), GateState::Driving);
    }

    #[test]
    fn a_stop_order_stops_in_every_state_and_keeps_the_reason_of_an_earlier_stop() {
        let mut driving = Machine::armed();
        driving.drive();
        for mut machine in [Machine::disarmed(), Machine::armed(), driving] {
            assert_eq!(machine.order(Order::Stop), Ok(()));
            assert_eq!(
                (machine.state(), machine.stop_reason()),
                (GateState::Stopped, Reason::OperatorStop)
            );
        }
        let mut machine = Machine::armed();
        machine.stop(Reason::HeadingError);
        assert_eq!(machine.order(Order::Stop), Ok(()));
        assert_eq!(machine.stop_reason(), Reason::HeadingError);
    }

    #[test]
    fn no_order_overrides_a_pressed_emergency_stop() {
        for mut machine in [Machine::armed(), Machine::disarmed()] {
            machine.set_estop(true);
            assert_eq!(machine.stop_reason(), Reason::EmergencyStop);
            assert_eq!(machine.order(Order::Resume), Err(OrderError::EmergencyStop));
            machine.set_estop(false);
            assert_eq!(machine.state(), GateState::Stopped);
            assert_eq!(machine.order(Order::Resume), Ok(()));
        }
    }
}
