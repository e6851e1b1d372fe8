//! driver ↔ base: the lines of the protocol, in ASCII.
//!
//! ```text
//! $V1,sequence,forward,left,yaw,valid*checksum                                    driver ─▶ base
//! $S1,sequence,x,y,heading,forward,left,yaw,flags,rejected,wheel…*checksum        base ─▶ driver
//! ```
//! Numbers are decimal integers in millionths of SI units (µm, µrad, µm/s, µrad/s), `valid` in ms.
//! The checksum is the CRC-32C of the characters between `$` and `*`, as 8 lower-case hexadecimal
//! digits. `\n` ends a line. A receiver ignores characters before the last `$`.
//!
//! `docs/how-to/serial-base.md` has the table of the fields.

use std::fmt::Write;
use std::str::{FromStr, Split};

/// Number of wheels in a line at most.
pub const WHEELS_MAX: usize = robot::WHEELS_MAX;
/// Length of a line at most, without its end \[bytes\].
pub const LINE_MAX: usize = 320;
/// Largest value of a place \[millionths\]: a thousand kilometres.
const PLACE_MAX: i64 = 1_000_000_000_000;
/// Bits of the field `flags`.
const ESTOP: u8 = 1;
const WATCHDOG: u8 = 2;

/// Why a line is not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Refusal {
    /// It is damaged or incomplete.
    #[error("damaged: expected $…*, and the CRC-32C of what is between as 8 hexadecimal digits")]
    Damaged,
    /// It is complete, and not of this kind or version.
    #[error("of another kind or version")]
    Foreign,
    /// It is complete, and its fields are not those of its kind.
    #[error("with other fields than those of its kind")]
    Fields,
}

/// driver → base: a velocity, and the time for which it may act.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct VelocityLine {
    /// Greater by 1 than that of the line before.
    pub sequence: u32,
    /// Body velocity (forward, left, yaw) \[µm/s, µm/s, µrad/s\].
    pub velocity: [i32; 3],
    /// Watchdog: without another line for this time the base stops its motors \[ms\].
    pub valid_millis: u16,
}

/// base → driver: measurements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SensorLine {
    /// Greater by 1 than that of the line before. It begins again when the base restarts.
    pub sequence: u32,
    /// x, y and heading in the frame of the base's odometry \[µm, µm, µrad\]; not wrapped.
    pub pose: [i64; 3],
    /// Body velocity (forward, left, yaw) \[µm/s, µm/s, µrad/s\].
    pub velocity: [i32; 3],
    /// Whether the emergency stop is pressed.
    pub estop: bool,
    /// Whether the watchdog has stopped the motors.
    pub watchdog: bool,
    /// Number of velocity lines that the base has rejected since its start.
    pub rejected: u32,
    /// Number of measured wheels; 0 if wheel speeds are not measured.
    pub wheels: usize,
    /// Their speeds \[µrad/s\]; 0 beyond `wheels`.
    pub wheel_speed: [i32; WHEELS_MAX],
}

/// `value` in millionths; the nearest possible one if it is too large.
pub fn millionths(value: f64) -> i32 {
    (value * 1e6).round() as i32
}

impl VelocityLine {
    /// Appends the line with its end to `text`.
    pub fn encode(&self, text: &mut String) {
        let [forward, left, yaw] = self.velocity;
        let Self { sequence, valid_millis, .. } = self;
        close(text, |text| write!(text, "V1,{sequence},{forward},{left},{yaw},{valid_millis}"));
    }

    /// The content of `line`.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn decode(line: &[u8]) -> Result<Self, Refusal> {
        let mut fields = fields_of("V1", line)?;
        let decoded = Self {
            sequence: next(&mut fields)?,
            velocity: three(&mut fields)?,
            valid_millis: next(&mut fields)?,
        };
        end(&mut fields).map(|()| decoded)
    }
}

impl SensorLine {
    /// Appends the line with its end to `text`.
    pub fn encode(&self, text: &mut String) {
        let ([x, y, heading], [forward, left, yaw]) = (self.pose, self.velocity);
        let flags = u8::from(self.estop) * ESTOP + u8::from(self.watchdog) * WATCHDOG;
        let Self { sequence, rejected, .. } = self;
        close(text, |text| {
            write!(text, "S1,{sequence},{x},{y},{heading},{forward},{left},{yaw}")?;
            write!(text, ",{flags},{rejected}")?;
            let mut speeds = self.wheel_speed.iter().take(self.wheels);
            speeds.try_for_each(|speed| write!(text, ",{speed}"))
        });
    }

    /// The content of `line`.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn decode(line: &[u8]) -> Result<Self, Refusal> {
        let mut fields = fields_of("S1", line)?;
        let (sequence, pose) = (next(&mut fields)?, three::<i64>(&mut fields)?);
        let (velocity, flags): (_, u8) = (three(&mut fields)?, next(&mut fields)?);
        let rejected = next(&mut fields)?;
        let is_possible = |value: &i64| value.abs() <= PLACE_MAX;
        if flags > ESTOP + WATCHDOG || !pose.iter().all(is_possible) {
            return Err(Refusal::Fields);
        }
        let (mut wheels, mut wheel_speed) = (0, [0; WHEELS_MAX]);
        for field in fields {
            let place = wheel_speed.get_mut(wheels).ok_or(Refusal::Fields)?;
            (*place, wheels) = (number(field)?, wheels + 1);
        }
        let (estop, watchdog) = (flags & ESTOP > 0, flags & WATCHDOG > 0);
        Ok(Self { sequence, pose, velocity, estop, watchdog, rejected, wheels, wheel_speed })
    }
}

/// Appends `$`, the body, and its checksum.
fn close(text: &mut String, write_body: impl FnOnce(&mut String) -> std::fmt::Result) {
    text.push('$');
    let begin = text.len();
    // A String takes everything.
    let _ = write_body(text);
    let checksum = crc32c::crc32c(text.as_bytes().get(begin..).unwrap_or_default());
    let _ = writeln!(text, "*{checksum:08x}");
}

/// The fields of an undamaged line of this kind, after the kind.
fn fields_of<'a>(kind: &str, line: &'a [u8]) -> Result<Split<'a, char>, Refusal> {
    let text = std::str::from_utf8(line).map_err(|_| Refusal::Damaged)?;
    let (_, text) = text.rsplit_once('$').ok_or(Refusal::Damaged)?;
    let (body, checksum) = text.split_once('*').ok_or(Refusal::Damaged)?;
    if hexadecimal(checksum) != Some(crc32c::crc32c(body.as_bytes())) {
        return Err(Refusal::Damaged);
    }
    let mut fields = body.split(',');
    if fields.next() == Some(kind) { Ok(fields) } else { Err(Refusal::Foreign) }
}

/// Exactly 8 lower-case digits, so that each number has one spelling.
fn hexadecimal(text: &str) -> Option<u32> {
    let is_digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    let is_one = text.len() == 8 && text.bytes().all(is_digit);
    is_one.then(|| u32::from_str_radix(text, 16).ok())?
}

fn number<T: FromStr>(field: &str) -> Result<T, Refusal> {
    field.parse().map_err(|_| Refusal::Fields)
}

fn next<T: FromStr>(fields: &mut Split<'_, char>) -> Result<T, Refusal> {
    fields.next().ok_or(Refusal::Fields).and_then(number)
}

fn three<T: FromStr>(fields: &mut Split<'_, char>) -> Result<[T; 3], Refusal> {
    Ok([next(fields)?, next(fields)?, next(fields)?])
}

fn end(fields: &mut Split<'_, char>) -> Result<(), Refusal> {
    fields.next().map_or(Ok(()), |_| Err(Refusal::Fields))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    prop_compose! {
        fn velocity_line()(
            sequence in any::<u32>(),
            velocity in any::<[i32; 3]>(),
            valid_millis in any::<u16>(),
        ) -> VelocityLine {
            VelocityLine { sequence, velocity, valid_millis }
        }
    }

    prop_compose! {
        fn sensor_line()(
            sequence in any::<u32>(),
            pose in [-PLACE_MAX..=PLACE_MAX, -PLACE_MAX..=PLACE_MAX, -PLACE_MAX..=PLACE_MAX],
            velocity in any::<[i32; 3]>(),
            (estop, watchdog, rejected) in any::<(bool, bool, u32)>(),
            wheels in 0..=WHEELS_MAX,
            speeds in any::<[i32; WHEELS_MAX]>(),
        ) -> SensorLine {
            let mut wheel_speed = [0; WHEELS_MAX];
            wheel_speed.iter_mut().zip(speeds).take(wheels).for_each(|(to, from)| *to = from);
            SensorLine {
                sequence, pose, velocity, estop, watchdog, rejected, wheels, wheel_speed,
            }
        }
    }

    fn text(encode: impl FnOnce(&mut String)) -> Vec<u8> {
        let mut text = String::new();
        encode(&mut text);
        assert_eq!(text.pop(), Some('\n'));
        assert!(text.len() <= LINE_MAX, "{}", text.len());
        text.into_bytes()
    }

    /// `line` with another byte at one place.
    fn changed(line: &[u8], place: prop::sample::Index, to: u8) -> Vec<u8> {
        let mut changed = line.to_vec();
        let place = place.index(line.len());
        changed[place] = if changed[place] == to { to.wrapping_add(1) } else { to };
        changed
    }

    proptest! {
        #[test]
        fn every_velocity_line_decodes_to_what_was_encoded(sent in velocity_line()) {
            prop_assert_eq!(VelocityLine::decode(&text(|text| sent.encode(text))), Ok(sent));
        }

        #[test]
        fn every_sensor_line_decodes_to_what_was_encoded(sent in sensor_line()) {
            prop_assert_eq!(SensorLine::decode(&text(|text| sent.encode(text))), Ok(sent));
        }

        #[test]
        fn no_velocity_line_with_a_changed_byte_is_accepted(
            sent in velocity_line(), place in any::<prop::sample::Index>(), to in any::<u8>(),
        ) {
            let line = changed(&text(|text| sent.encode(text)), place, to);
            prop_assert!(VelocityLine::decode(&line).is_err());
        }

        #[test]
        fn no_sensor_line_with_a_changed_byte_is_accepted(
            sent in sensor_line(), place in any::<prop::sample::Index>(), to in any::<u8>(),
        ) {
            let line = changed(&text(|text| sent.encode(text)), place, to);
            prop_assert!(SensorLine::decode(&line).is_err());
        }

        #[test]
        fn no_incomplete_line_is_accepted(
            sent in sensor_line(), place in any::<prop::sample::Index>(),
        ) {
            let line = text(|text| sent.encode(text));
            let part = &line[..place.index(line.len())];
            prop_assert_eq!(SensorLine::decode(part), Err(Refusal::Damaged));
        }

        #[test]
        fn a_line_after_the_rest_of_a_damaged_one_is_accepted(
            sent in sensor_line(), rest in any::<Vec<u8>>(),
        ) {
            let rest: Vec<u8> = rest.into_iter().map(|byte| byte & 0x7f).collect();
            let line = [rest, text(|text| sent.encode(text))].concat();
            prop_assert_eq!(SensorLine::decode(&line), Ok(sent));
        }

        #[test]
        fn any_bytes_are_rejected_without_a_panic(bytes in any::<Vec<u8>>()) {
            prop_assert!(SensorLine::decode(&bytes).is_err());
            prop_assert!(VelocityLine::decode(&bytes).is_err());
        }
    }

    #[test]
    fn the_examples_of_the_documents_are_valid() {
        let page = include_str!("../../../docs/how-to/serial-base.md");
        let velocity =
            VelocityLine { sequence: 17, velocity: [500_000, 0, -250_000], valid_millis: 100 };
        let sensed = SensorLine {
            sequence: 812,
            pose: [1_204_511, -300_127, 1_570_802],
            velocity: [498_203, 12, -249_876],
            rejected: 3,
            wheels: 4,
            wheel_speed: [11_340_010, 8_588_110, 8_588_640, 11_339_480, 0, 0, 0, 0],
            ..SensorLine::default()
        };
        for line in [text(|text| velocity.encode(text)), text(|text| sensed.encode(text))] {
            let line = String::from_utf8_lossy(&line);
            assert!(page.contains(&*line), "{line}");
        }
    }

    #[test]
    fn an_undamaged_line_of_another_kind_or_with_other_fields_is_rejected_as_such() {
        let sealed = |body: &str| text(|text| close(text, |text| write!(text, "{body}")));
        for (body, refusal) in [
            ("V2,1,2,3,4,5", Refusal::Foreign),
            ("S1,1,2,3,4,5,6,7,0,0", Refusal::Foreign),
            ("V1,1,2,3,4", Refusal::Fields),
            ("V1,1,2,3,4,5,6", Refusal::Fields),
            ("V1,1,2,3,NaN,5", Refusal::Fields),
            ("V1,1,2,3,4,70000", Refusal::Fields),
        ] {
            assert_eq!(VelocityLine::decode(&sealed(body)), Err(refusal), "{body}");
        }
        for body in [
            "S1,1,9000000000000,3,4,5,6,7,0,0",
            "S1,1,2,3,4,5,6,7,4,0",
            "S1,1,2,3,4,5,6,7,0,0,1,2,3,4,5,6,7,8,9",
        ] {
            assert_eq!(SensorLine::decode(&sealed(body)), Err(Refusal::Fields), "{body}");
        }
    }
}
