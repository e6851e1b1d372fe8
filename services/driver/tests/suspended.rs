//! Promise: no command drives a real robot that is older than three periods, also if the machine
//! has suspended the driver. A simulated robot stands still in that time.

use driver::gated::GatedBase;
use driver::{Base, BaseError, Sensors, Settings, TrueState};
use process::Run;
use protocol::message::{Command, FallbackLevel, Reason};
use robot::Robot;
use std::cell::Cell;
use std::error::Error;
use std::rc::Rc;
use transport::Links;

const PERIOD: u64 = 20_000_000;
const EPOCH: u64 = 7;

/// Takes every velocity, and measures its own one.
struct Still {
    is_simulated: bool,
    measured: Rc<Cell<f64>>,
    driven: Rc<Cell<f64>>,
}

impl Base for Still {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        Ok(Sensors { velocity: [self.measured.get(), 0.0, 0.0], ..Sensors::default() })
    }

    fn drive(&mut self, velocity: [f64; 3], _: u64) -> Result<(), BaseError> {
        self.driven.set(velocity[0]);
        Ok(())
    }

    fn truth(&self) -> Option<TrueState> {
        self.is_simulated.then(TrueState::default)
    }
}

fn command() -> Command {
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.stamp.epoch, command.plant_epoch) = (1, EPOCH);
    (command.fallback_level, command.input) = (FallbackLevel::FreshPlan.code(), [1.0, 0.0, 0.0]);
    (command.tail, command.tail_len) = ([command.input; 4], 4);
    command
}

/// Velocity of a robot 4 ms after its driver was suspended for `millis` in its first period, at
/// 1 m/s, and the verdict on a further command that answers the state of that period. Afterwards the
/// robot measures `measured` \[m/s\].
fn suspended(
    is_simulated: bool,
    millis: u64,
    measured: f64,
) -> Result<(f64, Result<(), Reason>), Box<dyn Error>> {
    let (robot, links) = (Robot::example(), Links::on_this_machine("suspended", "/tmp", true, 0));
    let run = Run::new("/tmp", PERIOD, links);
    let settings = Settings {
        run: &run,
        duration_s: 1.0,
        link_delay_millis: 0,
        recorded: false,
        robot: &robot,
        armed: true,
        surroundings: None,
        lists: &[],
    };
    let (now, driven) = (Rc::default(), Rc::default());
    let base = Still { is_simulated, measured: Rc::clone(&now), driven: Rc::clone(&driven) };
    let mut gated = GatedBase::new(base, &settings, EPOCH);
    let sensors = gated.read()?;
    gated.begin_period(0, 0, &sensors);
    gated.offer(&command(), 1_000_000)?.map_err(Reason::text)?;
    gated.advance(4_000_000)?;
    assert_eq!(driven.get(), 1.0);
    now.set(measured);
    let nanos = millis * 1_000_000;
    let lost = if gated.pass_over(nanos)? { nanos } else { 0 };
    gated.advance(8_000_000 + lost)?;
    let velocity = driven.get();
    // It answers the same state once more, after a restart of the controller.
    let mut again = command();
    again.stamp.epoch = 2;
    Ok((velocity, gated.offer(&again, 8_000_000 + lost)?))
}

/// Speed that the ramp of the brake takes in one slice \[m/s\].
fn ramp() -> f64 {
    Robot::example().limits.brake_mps2 * 2e-3
}

#[test]
fn commands_of_a_real_robot_get_older_while_its_driver_is_suspended() -> Result<(), Box<dyn Error>>
{
    // Shorter than the watchdog of a base: the ramp begins after the stall, without a leap.
    let (velocity, verdict) = suspended(false, 80, 0.0)?;
    assert!((1.0 - velocity - ramp()).abs() < 1e-9, "{velocity}");
    assert_eq!(verdict, Err(Reason::TooOld));
    Ok(())
}

#[test]
fn a_base_that_its_watchdog_has_stopped_is_not_driven_again() -> Result<(), Box<dyn Error>> {
    for (measured, begins_at) in [(0.0, 0.0), (0.4, 0.4), (-0.4, 0.0), (1.5, 1.0), (f64::NAN, 1.0)]
    {
        let (velocity, verdict) = suspended(false, 300, measured)?;
        let expected = (begins_at - ramp()).max(0.0);
        assert!((velocity - expected).abs() < 1e-9, "{measured}: {velocity}");
        assert_eq!(verdict, Err(Reason::TooOld));
    }
    Ok(())
}

#[test]
fn a_simulated_robot_stands_still_while_its_process_is_suspended() -> Result<(), Box<dyn Error>> {
    assert_eq!(suspended(true, 300, 0.0)?, (1.0, Ok(())));
    Ok(())
}
