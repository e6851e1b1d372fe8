//! Whether motors carry the current that the limits on a plan foretell.
//!
//! A row of the program bounds |k_p J (u − v)/r| of a wheel by i_max, both as the robot file has
//! them. Where that file is wrong, or the wheel slips, a row can bind while the motor carries far
//! less. Such a row is dropped until the motor is at its limit indeed.

use robot::Robot;

/// A row whose current is foretold with this share of the limit binds, and a motor that carries it
/// is at the limit.
const BINDS: f64 = 0.95;
/// A motor that carries less than this share of what is foretold contradicts the row.
const CONTRADICTS: f64 = 0.7;
/// One that carries more than this share of it agrees with the row.
const AGREES: f64 = 0.9;
/// Of less than this share of the limit nothing is concluded.
const TELLS: f64 = 0.3;
/// Time over which periods fade \[s\].
const MEMORY_S: f64 = 0.5;
/// The least of it \[periods\].
const PERIODS_LEAST: f64 = 10.0;
/// Share of the periods from which on a row is dropped.
const OFTEN: f64 = 0.6;

/// Currents that a plan foretells of the motors in one period, in shares of their limit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Foretold {
    /// At its start, which is what the rows bound.
    pub start: [f64; 4],
    /// At its end, which is when they are measured.
    pub end: [f64; 4],
}

/// Rows that are dropped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contradicted {
    /// Whether that of each wheel is, in the robot file's order.
    pub wheels: [bool; 4],
    /// What the motors of these rows carry at most, in shares of the limit.
    pub carried: f64,
}

/// One wheel's row.
#[derive(Debug, Clone, Copy, Default)]
struct Watched {
    /// Share of the periods that contradict the row, faded.
    contradicts: f64,
    /// Mean of the measured share, faded likewise.
    carried: f64,
    dropped: bool,
}

/// Watches the rows of all wheels. Does not allocate.
#[derive(Debug, Clone)]
pub struct Currents {
    fading: f64,
    limit_a: f64,
    wheels: [Watched; 4],
}

impl Currents {
    /// Those of `robot` in periods of `period` \[s\]: no row is dropped.
    pub fn new(robot: &Robot, period: f64) -> Self {
        Self {
            fading: (period / MEMORY_S).min(1.0 / PERIODS_LEAST),
            limit_a: robot.drive.current_limit_a,
            wheels: [Watched::default(); 4],
        }
    }

    /// Begins anew: no row is dropped.
    pub fn reset(&mut self) {
        self.wheels = [Watched::default(); 4];
    }

    /// Takes in one period: what the plan foretold, and what was `measured` at its end \[A\]; of a
    /// driver that measures no currents it is empty.
    pub fn look(&mut self, foretold: &Foretold, measured: &[f64]) {
        let wheels = self.wheels.iter_mut().zip(measured).enumerate();
        for (index, (wheel, amps)) in wheels.filter(|(_, (_, amps))| amps.is_finite()) {
            let carries = amps.abs() / self.limit_a;
            let end = foretold.end[index].abs().min(1.0);
            let contradicts =
                foretold.start[index].abs() >= BINDS && end >= TELLS && carries < CONTRADICTS * end;
            wheel.carried += self.fading * (carries - wheel.carried);
            wheel.contradicts += self.fading * (f64::from(contradicts) - wheel.contradicts);
            if carries >= BINDS || (end >= TELLS && carries >= AGREES * end) {
                *wheel = Watched { carried: wheel.carried, ..Watched::default() };
            }
            wheel.dropped |= wheel.contradicts > OFTEN;
        }
    }

    /// Whether the row of each wheel is dropped.
    pub fn dropped(&self) -> [bool; 4] {
        self.wheels.map(|wheel| wheel.dropped)
    }

    /// The rows that are dropped, if any are.
    pub fn contradicted(&self) -> Option<Contradicted> {
        let dropped = self.wheels.iter().filter(|wheel| wheel.dropped);
        let carried = dropped.map(|wheel| wheel.carried).reduce(f64::max)?;
        Some(Contradicted { wheels: self.dropped(), carried })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: [f64; 4] = [1.0, 0.2, 0.2, 0.2];

    /// After so many seconds in which plans foretold `start`, a third less at the end of each
    /// period, and motors carried `shares` of their limit.
    fn watched(seconds: f64, start: [f64; 4], shares: &[f64]) -> Currents {
        let robot = Robot::example();
        let amps: Vec<f64> =
            shares.iter().map(|share| share * robot.drive.current_limit_a).collect();
        let mut currents = Currents::new(&robot, 0.02);
        for _ in 0..(seconds / 0.02) as usize {
            currents.look(&Foretold { start, end: start.map(|share| 0.67 * share) }, &amps);
        }
        currents
    }

    #[test]
    fn a_row_that_binds_while_its_motor_carries_little_is_dropped_within_a_second() {
        let currents = watched(1.0, FULL, &[0.33; 4]);
        assert_eq!(currents.dropped(), [true, false, false, false]);
        let contradicted = currents.contradicted().map(|rows| (rows.wheels, rows.carried < 0.4));
        assert_eq!(contradicted, Some(([true, false, false, false], true)));
    }

    #[test]
    fn a_row_is_kept_where_the_motor_carries_what_is_foretold_or_nothing_binds_or_nothing_is_measured()
     {
        let as_foretold: &[f64] = &[0.6; 4];
        for (foretold, shares) in [(FULL, as_foretold), ([0.9; 4], &[0.33; 4]), (FULL, &[])] {
            let dropped = watched(5.0, foretold, shares).dropped();
            assert_eq!(dropped, [false; 4], "{foretold:?} {shares:?}");
        }
    }

    #[test]
    fn a_dropped_row_is_back_as_soon_as_the_motor_is_at_its_limit() {
        let mut currents = watched(1.0, FULL, &[0.33; 4]);
        let limit = Robot::example().drive.current_limit_a;
        currents.look(&Foretold::default(), &[-limit; 4]);
        assert_eq!(currents.dropped(), [false; 4]);
        assert_eq!(currents.contradicted(), None);
    }

    #[test]
    fn a_current_that_is_no_number_says_nothing() {
        let mut currents = watched(1.0, FULL, &[0.33; 4]);
        let before = currents.contradicted();
        currents.look(&Foretold { start: FULL, end: FULL }, &[f64::NAN; 4]);
        assert_eq!(currents.contradicted(), before);
    }

    #[test]
    fn of_another_robot_nothing_is_known() {
        let mut currents = watched(1.0, FULL, &[0.33; 4]);
        currents.reset();
        assert_eq!(currents.dropped(), [false; 4]);
    }
}
