//! Messages of ROS 2 (CDR) → the numbers that are used.
//!
//! A message begins with two bytes that name its representation and two that are unused. The rest
//! is the message, in plain CDR of either byte order. A length field never makes this code allocate
//! more than the message has.

use super::super::is_finite;
use byteorder::{BigEndian, ByteOrder, LittleEndian};
use robot::{AXES, Velocity};
use serde::Deserialize;

/// What a compressed message begins with (Zstandard).
pub(super) const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Least and largest length of a quaternion that is taken as a rotation.
const QUATERNION_LENGTH: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// Why a message cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// It has no representation.
    #[error("{0} bytes: expected at least 4, of its CDR representation")]
    Short(usize),
    /// It is compressed.
    #[error(
        "the message is compressed: expected plain messages, as `ros2 bag convert` writes without \
         compression_mode"
    )]
    Compressed,
    /// It is not in plain CDR.
    #[error("representation 0x{0:04x}: expected 0x0000 or 0x0001 (plain CDR)")]
    Representation(u16),
    /// It ends early, or a text is not UTF-8.
    #[error("not a message of this type: {0}")]
    Cdr(#[from] cdr_encoding::Error),
    /// Its time is out of range.
    #[error("its time is {0} ns: expected a time from 1970 on")]
    Time(i64),
    /// A number is infinite or none.
    #[error("{0} is not finite")]
    NotFinite(&'static str),
    /// The orientation is no rotation.
    #[error("the quaternion has a length of {0}: expected 1")]
    Quaternion(f64),
}

type Vector = (f64, f64, f64);
/// Row by row. Not used.
type Covariance = [[f64; 6]; 6];

#[derive(Deserialize)]
struct Header {
    seconds: i32,
    nanoseconds: u32,
    _frame: String,
}

#[derive(Deserialize)]
struct Twist {
    linear: Vector,
    angular: Vector,
}

#[derive(Deserialize)]
struct TwistStamped {
    header: Header,
    twist: Twist,
}

#[derive(Deserialize)]
struct Odometry {
    header: Header,
    _child_frame: String,
    position: Vector,
    /// x, y, z, w.
    orientation: [f64; 4],
    _pose_covariance: Covariance,
    twist: Twist,
    _twist_covariance: Covariance,
}

#[derive(Deserialize)]
struct JointState {
    header: Header,
    name: Vec<String>,
    _position: Vec<f64>,
    velocity: Vec<f64>,
    _effort: Vec<f64>,
}

/// A message with the time of its header \[ns\]; none if the header has no time.
pub(super) struct Stamped<T> {
    pub(super) nanos: Option<i64>,
    pub(super) value: T,
}

/// nav_msgs/msg/Odometry → x, y, yaw in its frame and the velocity in the body
/// \[m, m, rad, m/s, m/s, rad/s\].
pub(super) fn odometry(bytes: &[u8]) -> Result<Stamped<[f64; 2 * AXES]>, MessageError> {
    let message: Odometry = decode(bytes)?;
    let yaw = yaw(message.orientation)?;
    let [forward, left, turn] = message.twist.planar()?;
    let (x, y, _) = message.position;
    if !is_finite(&[x, y]) {
        return Err(MessageError::NotFinite("the position"));
    }
    message.header.stamp([x, y, yaw, forward, left, turn])
}

/// geometry_msgs/msg/Twist → velocity in the body \[m/s, m/s, rad/s\].
pub(super) fn twist(bytes: &[u8]) -> Result<Stamped<Velocity>, MessageError> {
    let value = decode::<Twist>(bytes)?.planar()?;
    Ok(Stamped { nanos: None, value })
}

/// geometry_msgs/msg/TwistStamped → velocity in the body \[m/s, m/s, rad/s\].
pub(super) fn twist_stamped(bytes: &[u8]) -> Result<Stamped<Velocity>, MessageError> {
    let message: TwistStamped = decode(bytes)?;
    let value = message.twist.planar()?;
    message.header.stamp(value)
}

/// sensor_msgs/msg/JointState → name and speed of each joint that has a speed \[rad/s\].
pub(super) fn joints(bytes: &[u8]) -> Result<Stamped<Vec<(String, f64)>>, MessageError> {
    let message: JointState = decode(bytes)?;
    let joints = message.name.into_iter().zip(message.velocity).collect();
    message.header.stamp(joints)
}

fn decode<'bytes, T: Deserialize<'bytes>>(bytes: &'bytes [u8]) -> Result<T, MessageError> {
    if bytes.starts_with(&ZSTD_MAGIC) {
        return Err(MessageError::Compressed);
    }
    let Some(([first, second, _, _], message)) = bytes.split_first_chunk::<4>() else {
        return Err(MessageError::Short(bytes.len()));
    };
    match u16::from_be_bytes([*first, *second]) {
        0 => decode_as::<T, BigEndian>(message),
        1 => decode_as::<T, LittleEndian>(message),
        other => Err(MessageError::Representation(other)),
    }
}

fn decode_as<'bytes, T, Order>(message: &'bytes [u8]) -> Result<T, MessageError>
where
    T: Deserialize<'bytes>,
    Order: ByteOrder,
{
    Ok(cdr_encoding::from_bytes::<T, Order>(message)?.0)
}

impl Header {
    /// `value` with this time. ROS 2 writes zero where there is none.
    fn stamp<T>(&self, value: T) -> Result<Stamped<T>, MessageError> {
        let nanos = i64::from(self.seconds) * 1_000_000_000 + i64::from(self.nanoseconds);
        if nanos < 0 {
            return Err(MessageError::Time(nanos));
        }
        Ok(Stamped { nanos: (nanos > 0).then_some(nanos), value })
    }
}

impl Twist {
    fn planar(&self) -> Result<Velocity, MessageError> {
        let planar = [self.linear.0, self.linear.1, self.angular.2];
        if is_finite(&planar) { Ok(planar) } else { Err(MessageError::NotFinite("the twist")) }
    }
}

/// Yaw of a rotation, whatever the length of its quaternion \[rad\].
fn yaw([x, y, z, w]: [f64; 4]) -> Result<f64, MessageError> {
    let length = (x * x + y * y + z * z + w * w).sqrt();
    if !QUATERNION_LENGTH.contains(&length) {
        return Err(MessageError::Quaternion(length));
    }
    Ok((2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A message of joints in little endian, with a time and no frame, that claims `length` names.
    fn joints_that_claim(length: u32) -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend([1_u32, 0, 1, 0, length].iter().flat_map(|number| number.to_le_bytes()));
        bytes
    }

    #[test]
    fn a_length_beyond_the_message_is_an_error_and_no_allocation() {
        for length in [1, 1000, u32::MAX] {
            let decoded = joints(&joints_that_claim(length));
            assert!(matches!(decoded, Err(MessageError::Cdr(_))));
        }
    }

    #[test]
    fn another_representation_or_none_is_an_error() {
        assert!(matches!(twist(&[0, 1, 0]), Err(MessageError::Short(3))));
        let of_parameters = [[0, 3, 0, 0].as_slice(), &[0; 48]].concat();
        assert!(matches!(twist(&of_parameters), Err(MessageError::Representation(3))));
        assert!(matches!(twist(&[0, 1, 0, 0, 1]), Err(MessageError::Cdr(_))));
    }

    #[test]
    fn the_yaw_of_a_rotation_does_not_depend_on_the_length_of_its_quaternion() {
        let (sin, cos) = 0.6_f64.sin_cos();
        for length in [0.8, 1.0, 1.5] {
            let found = yaw([0.0, 0.0, length * sin, length * cos]);
            assert!(found.is_ok_and(|found| (found - 1.2).abs() < 1e-12));
        }
        assert!(matches!(yaw([0.0; 4]), Err(MessageError::Quaternion(_))));
        assert!(matches!(yaw([f64::NAN; 4]), Err(MessageError::Quaternion(_))));
    }
}
