//! Promise: before each velocity the hardware of a base receives the time for which it may act.

use driver::gated::{GatedBase, WATCHDOG_NANOS};
use driver::{Base, BaseError, Sensors, Settings};
use process::Run;
use robot::Robot;
use std::cell::RefCell;
use std::rc::Rc;
use transport::Links;

/// Calls of a base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Call {
    Watchdog(u64),
    Drive,
}

/// A base that remembers its calls.
#[derive(Default)]
struct Remembering(Rc<RefCell<Vec<Call>>>);

impl Base for Remembering {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        Ok(Sensors::default())
    }

    fn drive(&mut self, _: [f64; 3], _: u64) -> Result<(), BaseError> {
        self.0.borrow_mut().push(Call::Drive);
        Ok(())
    }

    fn watchdog(&mut self, valid_nanos: u64) -> Result<(), BaseError> {
        self.0.borrow_mut().push(Call::Watchdog(valid_nanos));
        Ok(())
    }
}

#[test]
fn each_velocity_has_the_time_for_which_it_may_act() -> Result<(), BaseError> {
    let (robot, links) = (Robot::example(), Links::on_this_machine("watchdog", "/tmp", true, 0));
    let run = Run::new("/tmp", 20_000_000, links);
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
    let base = Remembering::default();
    let calls = Rc::clone(&base.0);
    let mut driver = GatedBase::new(base, &settings, 1);
    let sensors = driver.read()?;
    driver.begin_period(0, 0, &sensors);
    driver.end_period(20_000_000)?;
    let calls = calls.borrow();
    assert_eq!(calls.len(), 20, "10 slices of 2 ms");
    for pair in calls.chunks(2) {
        assert_eq!(pair, [Call::Watchdog(WATCHDOG_NANOS), Call::Drive]);
    }
    Ok(())
}
