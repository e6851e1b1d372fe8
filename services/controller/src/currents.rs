//! Whether motors carry the current that the limits on a plan predict.
//!
//! A row of the program bounds |k_p J (u − v)/r| of a wheel by i_max, both from the robot file.
//! Where that file is wrong, or the wheel slips, a row can be active while the motor carries far
//! less current. Such a row is dropped until the motor is at its limit.

use robot::{PerWheel, Robot, WHEELS_MAX};

/// From this share of the limit on, a predicted current counts as an active row, and a measured
/// current as a motor at its limit.
const BINDS: f64 = 0.95;
/// A motor that carries less than this share of the predicted current contradicts the row.
const CONTRADICTS: f64 = 0.7;
/// A motor that carries more than this share of the predicted current agrees with the row.
const AGREES: f64 = 0.9;
/// Below this share of the limit, a current is not evaluated.
const TELLS: f64 = 0.3;
/// Time over which periods decay \[s\].
const MEMORY_S: f64 = 0.5;
/// Minimum of this time \[periods\].
const PERIODS_LEAST: f64 = 10.0;
/// From this share of the periods on, a row is dropped.
const OFTEN: f64 = 0.6;

/// Motor currents that a plan predicts for one period, as shares of their limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foretold {
    /// At the start of the period; the rows bound these.
    pub start: PerWheel,
    /// At the end of the period, when currents are measured.
    pub end: PerWheel,
    /// The bound of the rows, without the grip of the floor.
    pub most: f64,
}

impl Default for Foretold {
    /// Of no plan.
    fn default() -> Self {
        Self { start: PerWheel::default(), end: PerWheel::default(), most: 1.0 }
    }
}

/// Rows that are dropped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contradicted {
    /// Whether the row of each wheel is dropped, in the robot file's order.
    pub wheels: [bool; WHEELS_MAX],
    /// Largest current that the motors of these rows carry, as a share of the limit.
    pub carried: f64,
}

/// One wheel's row.
#[derive(Debug, Clone, Copy, Default)]
struct Watched {
    /// Share of the periods that contradict the row, decayed.
    contradicts: f64,
    /// Mean of the measured share, decayed likewise.
    carried: f64,
    dropped: bool,
}

/// Watches the rows of all wheels. Does not allocate.
#[derive(Debug, Clone)]
pub struct Currents {
    fading: f64,
    limit_a: f64,
    wheels: [Watched; WHEELS_MAX],
}

impl Currents {
    /// The rows of `robot` for periods of `period` \[s\]: no row is dropped.
    pub fn new(robot: &Robot, period: f64) -> Self {
        Self {
            fading: (period / MEMORY_S).min(1.0 / PERIODS_LEAST),
            limit_a: robot.current_limit_a().unwrap_or(f64::INFINITY),
            wheels: [Watched::default(); WHEELS_MAX],
        }
    }

    /// Resets: no row is dropped.
    pub fn reset(&mut self) {
        self.wheels = [Watched::default(); WHEELS_MAX];
    }

    /// Processes one period: the predicted currents, and the currents `measured` at its end \[A\].
    /// `measured` is empty for a driver without current measurement. `grip` is the share of the
    /// limit that the floor can hold; a motor that carries it is at its limit.
    pub fn look(&mut self, foretold: &Foretold, measured: &[f64], grip: f64) {
        let wheels = self.wheels.iter_mut().zip(measured).enumerate();
        for (index, (wheel, amps)) in wheels.filter(|(_, (_, amps))| amps.is_finite()) {
            let carries = amps.abs() / self.limit_a;
            let end = foretold.end[index].abs().min(1.0);
            let binds = foretold.start[index].abs() >= BINDS * foretold.most;
            let contradicts = binds && end >= TELLS && carries < CONTRADICTS * end;
            wheel.carried += self.fading * (carries - wheel.carried);
            wheel.contradicts += self.fading * (f64::from(contradicts) - wheel.contradicts);
            if carries >= BINDS * grip || (end >= TELLS && carries >= AGREES * end) {
                *wheel = Watched { carried: wheel.carried, ..Watched::default() };
            }
            wheel.dropped |= wheel.contradicts > OFTEN;
        }
    }

    /// Whether the row of each wheel is dropped.
    pub fn dropped(&self) -> [bool; WHEELS_MAX] {
        self.wheels.map(|wheel| wheel.dropped)
    }

    /// The dropped rows, if there are any.
    pub fn contradicted(&self) -> Option<Contradicted> {
        let dropped = self.wheels.iter().filter(|wheel| wheel.dropped);
        let carried = dropped.map(|wheel| wheel.carried).reduce(f64::max)?;
        Some(Contradicted { wheels: self.dropped(), carried })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the first wheel alone.
    const FIRST: [bool; WHEELS_MAX] = [true, false, false, false, false, false, false, false];

    const FULL: PerWheel = [1.0, 0.2, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0];

    /// Runs for this number of seconds. Plans predict `start` and a third less at the end of each
    /// period; motors carry `shares` of their limit.
    fn watched(seconds: f64, start: PerWheel, shares: &[f64]) -> Currents {
        let robot = Robot::example();
        let amps: Vec<f64> = shares
            .iter()
            .map(|share| share * robot.current_limit_a().unwrap_or_default())
            .collect();
        let mut currents = Currents::new(&robot, 0.02);
        for _ in 0..(seconds / 0.02) as usize {
            let end = start.map(|share| 0.67 * share);
            currents.look(&Foretold { start, end, most: 1.0 }, &amps, 1.0);
        }
        currents
    }

    #[test]
    fn an_active_row_whose_motor_carries_little_is_dropped_within_a_second() {
        let currents = watched(1.0, FULL, &[0.33; 4]);
        assert_eq!(currents.dropped(), FIRST);
        let contradicted = currents.contradicted().map(|rows| (rows.wheels, rows.carried < 0.4));
        assert_eq!(contradicted, Some((FIRST, true)));
    }

    #[test]
    fn a_row_is_kept_if_the_motor_agrees_or_nothing_is_active_or_nothing_is_measured() {
        let as_foretold: &[f64] = &[0.6; 4];
        for (foretold, shares) in
            [(FULL, as_foretold), ([0.9; WHEELS_MAX], &[0.33; 4]), (FULL, &[])]
        {
            let dropped = watched(5.0, foretold, shares).dropped();
            assert_eq!(dropped, [false; WHEELS_MAX], "{foretold:?} {shares:?}");
        }
    }

    #[test]
    fn a_row_whose_bound_is_higher_is_not_active_at_the_limit() {
        let robot = Robot::example();
        let amps = [0.33 * robot.current_limit_a().unwrap_or_default(); 4];
        let mut currents = Currents::new(&robot, 0.1);
        for (most, dropped) in [(1.8, [false; WHEELS_MAX]), (1.0, FIRST)] {
            (0..50).for_each(|_| {
                currents.look(&Foretold { start: FULL, end: FULL, most }, &amps, 1.0);
            });
            assert_eq!(currents.dropped(), dropped, "{most}");
        }
    }

    #[test]
    fn a_dropped_row_is_back_as_soon_as_the_motor_is_at_its_limit() {
        let mut currents = watched(1.0, FULL, &[0.33; 4]);
        let limit = Robot::example().current_limit_a().unwrap_or_default();
        currents.look(&Foretold::default(), &[-limit; 4], 1.0);
        assert_eq!(currents.dropped(), [false; WHEELS_MAX]);
        assert_eq!(currents.contradicted(), None);
    }

    #[test]
    fn a_dropped_row_is_back_as_soon_as_the_motor_carries_what_the_floor_holds() {
        let mut currents = watched(1.0, FULL, &[0.33; 4]);
        let limit = Robot::example().current_limit_a().unwrap_or_default();
        currents.look(&Foretold::default(), &[0.33 * limit; 4], 1.0);
        assert_eq!(currents.dropped(), FIRST);
        currents.look(&Foretold::default(), &[0.33 * limit; 4], 0.33);
        assert_eq!(currents.dropped(), [false; WHEELS_MAX]);
    }

    #[test]
    fn a_current_that_is_not_finite_is_ignored() {
        let mut currents = watched(1.0, FULL, &[0.33; 4]);
        let before = currents.contradicted();
        let foretold = Foretold { start: FULL, end: FULL, most: 1.0 };
        currents.look(&foretold, &[f64::NAN; 4], 1.0);
        assert_eq!(currents.contradicted(), before);
    }

    #[test]
    fn after_a_reset_no_row_is_dropped() {
        let mut currents = watched(1.0, FULL, &[0.33; 4]);
        currents.reset();
        assert_eq!(currents.dropped(), [false; WHEELS_MAX]);
    }
}
