//! Promise: whatever arrives at the port, the base reports measurements that the firmware has sent,
//! or an error with the name of the port.

use driver::{Base, BaseError, ProgramSettings, Start};
use process::Run;
use robot::Robot;
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};
use serial_base::line::{SensorLine, VelocityLine};
use serial_base::port::Lines;
use serial_base::{SerialBase, SerialSettings};
use std::error::Error;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;
use transport::Links;

type Outcome = Result<(), Box<dyn Error>>;

/// The base's end of a cable.
struct Cable {
    ours: OwnedFd,
    /// Open, so that what is written before the driver comes is kept.
    _theirs: OwnedFd,
    port: PathBuf,
}

impl Cable {
    fn new() -> Result<Self, Box<dyn Error>> {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        unlockpt(&ours)?;
        fcntl_setfl(&ours, OFlags::NONBLOCK)?;
        let port = PathBuf::from(ptsname(&ours, Vec::new())?.into_string()?);
        let theirs = open(&port, OFlags::RDWR | OFlags::NOCTTY, Mode::empty())?;
        Ok(Self { ours, _theirs: theirs, port })
    }

    fn write(&self, bytes: &[u8]) -> Outcome {
        rustix::io::write(&self.ours, bytes)?;
        Ok(())
    }

    fn send(&self, line: &SensorLine) -> Outcome {
        self.write(text(line).as_bytes())
    }

    /// The last velocity line that has arrived.
    fn received(&self) -> Result<VelocityLine, Box<dyn Error>> {
        let (mut lines, mut bytes, mut last) = (Lines::default(), [0; 4096], None);
        while let Ok(count) = rustix::io::read(&self.ours, &mut bytes) {
            lines.take(&bytes[..count], |line| last = Some(VelocityLine::decode(line)));
        }
        Ok(last.ok_or("no line")??)
    }

    /// The base at its other end. `first` is the first line, sent until the base is open.
    fn open(&self, first: &SensorLine) -> Result<SerialBase, Box<dyn Error>> {
        let settings = settings(&self.port);
        thread::scope(|scope| {
            let opened = scope.spawn(move || SerialBase::open(&settings));
            while !opened.is_finished() {
                self.send(first)?;
                thread::sleep(Duration::from_millis(5));
            }
            Ok(opened.join().map_err(|_| "a panic")??)
        })
    }
}

fn settings(port: &std::path::Path) -> ProgramSettings<SerialSettings> {
    let links = Links::on_this_machine("serial", "/tmp", false, 0);
    ProgramSettings {
        duration_s: 1.0,
        link_delay_millis: 0,
        recorded: false,
        armed: true,
        start: Start::default(),
        run: Run::new("/tmp", 20_000_000, links),
        robot: Robot::example(),
        map: None,
        lists: vec![],
        // So fast that thousands of lines are due within a second.
        base: SerialSettings { port: port.to_owned(), baud: 4_000_000 },
    }
}

fn text(line: &SensorLine) -> String {
    let mut text = String::new();
    line.encode(&mut text);
    text
}

fn numbered(sequence: u32) -> SensorLine {
    SensorLine { sequence, velocity: [sequence.cast_signed(), 0, 0], ..SensorLine::default() }
}

/// The error of the next read.
fn failure(base: &mut SerialBase) -> Result<BaseError, Box<dyn Error>> {
    base.read().err().ok_or_else(|| "it is read".into())
}

#[test]
fn velocities_arrive_with_the_time_for_which_they_are_valid() -> Outcome {
    let cable = Cable::new()?;
    let mut base = cable.open(&numbered(1))?;
    base.watchdog(100_000_000)?;
    base.drive([0.5, 0.0, -0.25], 2_000_000)?;
    let (velocity, valid_millis) = ([500_000, 0, -250_000], 100);
    assert_eq!(cable.received()?, VelocityLine { sequence: 0, velocity, valid_millis });
    drop(base);
    assert_eq!(cable.received()?.velocity, [0; 3], "a driver that ends stops the motors");
    Ok(())
}

#[test]
fn the_newest_measurement_counts_and_a_damaged_one_never() -> Outcome {
    let cable = Cable::new()?;
    let mut base = cable.open(&numbered(1))?;
    cable.send(&numbered(2))?;
    cable.write(&text(&numbered(3)).as_bytes()[..20])?;
    cable.write(text(&numbered(9)).replace(",9,", ",8,").as_bytes())?;
    cable.write(&[b'x'; 2000])?;
    assert_eq!(base.read()?.velocity[0], 2e-6);
    cable.write(b"\n")?;
    cable.send(&SensorLine { estop: true, ..numbered(7) })?;
    let sensors = base.read()?;
    assert_eq!((sensors.velocity[0], sensors.estop, sensors.wheel_speed), (7e-6, true, None));
    Ok(())
}

#[test]
fn a_base_that_is_silent_or_has_restarted_or_is_gone_ends_the_driver() -> Outcome {
    let cable = Cable::new()?;
    let mut base = cable.open(&numbered(5))?;
    thread::sleep(Duration::from_millis(600));
    let error = failure(&mut base)?;
    assert!(matches!(error, BaseError::Silent { .. }), "{error:?}");
    cable.send(&numbered(4))?;
    let error = failure(&mut base)?;
    assert!(matches!(error, BaseError::Ended { .. }), "{error:?}");
    drop(base);
    let mut base = cable.open(&numbered(1))?;
    drop(cable);
    let error = failure(&mut base)?;
    assert!(matches!(error, BaseError::Ended { .. }), "{error:?}");
    Ok(())
}

#[test]
fn a_base_with_other_wheels_or_without_lines_or_with_a_driver_is_rejected() -> Outcome {
    let cable = Cable::new()?;
    let error = cable.open(&SensorLine { wheels: 3, ..numbered(1) }).err().ok_or("it opens")?;
    assert!(matches!(error.downcast_ref(), Some(BaseError::Answer { .. })), "{error:?}");
    let silent = Cable::new()?;
    let error = SerialBase::open(&settings(&silent.port)).err().ok_or("it opens")?;
    assert!(matches!(error, BaseError::Silent { .. }), "{error:?}");
    let _first = cable.open(&numbered(1))?;
    let error = SerialBase::open(&settings(&cable.port)).err().ok_or("it opens")?;
    assert!(matches!(error, BaseError::Device { .. }), "{error:?}");
    Ok(())
}

/// The cable's buffer fills, and no call waits for it.
#[test]
fn a_base_that_does_not_read_does_not_stop_the_driver() -> Outcome {
    let cable = Cable::new()?;
    let mut base = cable.open(&numbered(1))?;
    let mut last = 1;
    for tick in 0..4_000_u32 {
        base.drive([f64::from(tick) * 1e-6, 0.0, 0.0], 2_000_000)?;
        if tick % 100 == 0 {
            last += 1;
            cable.send(&numbered(last))?;
            base.read()?;
        }
        thread::sleep(Duration::from_micros(250));
    }
    Ok(())
}
