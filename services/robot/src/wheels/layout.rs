//! `[wheels]` of a robot file → each wheel's place, radius and row of J.

use super::{ImpossibleWheels, WHEELS_MAX};
use crate::Velocity;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::f64::consts::TAU;
use std::fmt;

/// The wheels, as in a robot file: one of these keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Keys", rename_all = "kebab-case")]
#[expect(clippy::large_enum_variant, reason = "a robot has one, and it is copied at the start")]
pub enum Layout {
    /// Four mecanum wheels in a rectangle: front-right, front-left, rear-left, rear-right.
    Mecanum(Mecanum),
    /// Omni wheels on a circle, evenly spaced, counter-clockwise from the front. Each rolls
    /// counter-clockwise around the centre.
    Omni(Omni),
    /// 3 to 8 wheels of any kind.
    List(WheelList),
    /// A base that takes a body velocity, and whose wheels are not known.
    Twist(Twist),
}

/// What a file may have, so that an error can name all that it has.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    mecanum: Option<Mecanum>,
    omni: Option<Omni>,
    list: Option<WheelList>,
    twist: Option<Twist>,
}

impl TryFrom<Keys> for Layout {
    type Error = ImpossibleWheels;

    fn try_from(Keys { mecanum, omni, list, twist }: Keys) -> Result<Self, ImpossibleWheels> {
        let found = [
            mecanum.map(Self::Mecanum),
            omni.map(Self::Omni),
            list.map(Self::List),
            twist.map(Self::Twist),
        ];
        match found.into_iter().flatten().collect::<Vec<_>>()[..] {
            [only] => Ok(only),
            ref all => Err(ImpossibleWheels::Kinds(all.iter().map(Self::kind).collect())),
        }
    }
}

/// Mecanum wheels in a rectangle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mecanum {
    /// r \[m\].
    pub radius_m: f64,
    /// From the front axle to the rear axle: twice the paper's b \[m\].
    pub wheelbase_m: f64,
    /// From the left wheels to the right wheels: twice the paper's a \[m\].
    pub track_m: f64,
    /// Figure of the rollers' axes on the floor, seen from above.
    #[serde(default)]
    pub rollers: Rollers,
}

/// Figure of the rollers' axes on the floor, seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Rollers {
    /// An O: the wheels turn the robot with the lever a + b.
    #[default]
    O,
    /// An X: the lever is a − b.
    X,
}

/// Omni wheels on a circle around the centre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Omni {
    /// r \[m\].
    pub radius_m: f64,
    /// From the centre to a wheel's contact with the floor \[m\].
    pub centre_to_wheel_m: f64,
    /// Number of wheels, 3 to 8.
    pub count: usize,
}

/// Size of a base without known wheels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Twist {
    /// Extent forward \[m\].
    pub length_m: f64,
    /// Extent to the side \[m\].
    pub width_m: f64,
}

/// One wheel.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wheel {
    /// Contact with the floor, forward and left of the centre \[m\].
    pub position_m: [f64; 2],
    /// β: direction in which it rolls, counter-clockwise from forward \[deg\].
    #[serde(default)]
    pub direction_deg: f64,
    /// γ: angle from its axle to the axis of the roller on the floor: 0 for an omni wheel, ±45 for
    /// a mecanum wheel \[deg\].
    #[serde(default)]
    pub roller_deg: f64,
    /// r \[m\].
    pub radius_m: f64,
}

/// Up to 8 wheels. In a file: an array of tables.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelList {
    wheels: [Wheel; WHEELS_MAX],
    /// Number of wheels in the file; it may be too large.
    count: usize,
}

impl FromIterator<Wheel> for WheelList {
    fn from_iter<I: IntoIterator<Item = Wheel>>(wheels: I) -> Self {
        let mut list = Self { wheels: Default::default(), count: 0 };
        for wheel in wheels {
            if let Some(place) = list.wheels.get_mut(list.count) {
                *place = wheel;
            }
            list.count += 1;
        }
        list
    }
}

impl WheelList {
    fn wheels(&self) -> &[Wheel] {
        self.wheels.get(..self.count).unwrap_or_default()
    }
}

impl Serialize for WheelList {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.wheels())
    }
}

impl<'de> Deserialize<'de> for WheelList {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Wheels;
        impl<'de> Visitor<'de> for Wheels {
            type Value = WheelList;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("3 to 8 wheels")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut wheels: A) -> Result<WheelList, A::Error> {
                let mut list = WheelList { wheels: Default::default(), count: 0 };
                while let Some(wheel) = wheels.next_element()? {
                    *list
                        .wheels
                        .get_mut(list.count)
                        .ok_or_else(|| A::Error::invalid_length(WHEELS_MAX + 1, &self))? = wheel;
                    list.count += 1;
                }
                Ok(list)
            }
        }
        deserializer.deserialize_seq(Wheels)
    }
}

/// One wheel's place, radius and row of J.
pub(super) struct Contact {
    pub(super) row: Velocity,
    pub(super) radius_m: f64,
    pub(super) position_m: [f64; 2],
    pub(super) direction_rad: f64,
}

impl Layout {
    /// Its key in a robot file.
    pub(super) const fn kind(&self) -> &'static str {
        match self {
            Self::Mecanum(_) => "mecanum",
            Self::Omni(_) => "omni",
            Self::List(_) => "list",
            Self::Twist(_) => "twist",
        }
    }

    /// Each wheel; none if they are not known.
    ///
    /// # Errors
    /// [`ImpossibleWheels`] if a number or the number of wheels is impossible.
    pub(super) fn contacts(&self) -> Result<Vec<Contact>, ImpossibleWheels> {
        match self {
            Self::Mecanum(mecanum) => mecanum.contacts(),
            Self::Omni(omni) => omni.contacts(),
            Self::List(list) => list.contacts(),
            Self::Twist(Twist { length_m, width_m }) => {
                is_length("twist.length_m", *length_m)?;
                is_length("twist.width_m", *width_m)?;
                Ok(Vec::new())
            }
        }
    }
}

impl Mecanum {
    fn contacts(&self) -> Result<Vec<Contact>, ImpossibleWheels> {
        is_length("mecanum.radius_m", self.radius_m)?;
        is_length("mecanum.wheelbase_m", self.wheelbase_m)?;
        is_length("mecanum.track_m", self.track_m)?;
        Ok(self.places().into())
    }

    /// The wheels, without a check of the numbers.
    pub(super) fn places(&self) -> [Contact; 4] {
        let [ahead, side] = [0.5 * self.wheelbase_m, 0.5 * self.track_m];
        // +1: the roller on the floor of the front-right wheel points forward and left.
        let [sign, lever] = match self.rollers {
            Rollers::O => [1.0, ahead + side],
            Rollers::X => [-1.0, side - ahead],
        };
        let wheel = |row, position_m| Contact {
            row,
            radius_m: self.radius_m,
            position_m,
            direction_rad: 0.0,
        };
        [
            wheel([1.0, sign, lever], [ahead, -side]),
            wheel([1.0, -sign, -lever], [ahead, side]),
            wheel([1.0, sign, -lever], [-ahead, side]),
            wheel([1.0, -sign, lever], [-ahead, -side]),
        ]
    }
}

impl Omni {
    fn contacts(&self) -> Result<Vec<Contact>, ImpossibleWheels> {
        is_length("omni.radius_m", self.radius_m)?;
        is_length("omni.centre_to_wheel_m", self.centre_to_wheel_m)?;
        are_enough("omni.count", self.count)?;
        let wheel = |index: usize| {
            let angle = TAU * index as f64 / self.count as f64;
            let (sin, cos) = angle.sin_cos();
            let position_m = [self.centre_to_wheel_m * cos, self.centre_to_wheel_m * sin];
            let row = [-sin, cos, self.centre_to_wheel_m];
            Contact { row, radius_m: self.radius_m, position_m, direction_rad: angle + TAU / 4.0 }
        };
        Ok((0..self.count).map(wheel).collect())
    }
}

impl WheelList {
    fn contacts(&self) -> Result<Vec<Contact>, ImpossibleWheels> {
        are_enough("list", self.count)?;
        let contact = |(index, wheel): (usize, &Wheel)| {
            let Wheel { position_m: [x, y], direction_deg, roller_deg, radius_m } = *wheel;
            let key = |name: &str| format!("list.{index}.{name}");
            is_length(&key("radius_m"), radius_m)?;
            for value in [x, y] {
                is_within(&key("position_m"), value, 1e3, "numbers from -1000 to 1000")?;
            }
            is_within(&key("direction_deg"), direction_deg, 360.0, "a number from -360 to 360")?;
            is_within(&key("roller_deg"), roller_deg, 80.0, "a number from -80 to 80")?;
            let (sin, cos) = direction_deg.to_radians().sin_cos();
            // The tangent of π/4 is not exactly 1 in floating point.
            let tan = match roller_deg.abs() {
                45.0 => roller_deg.signum(),
                _ => roller_deg.to_radians().tan(),
            };
            let [forward, left] = [cos - tan * sin, sin + tan * cos];
            let row = [forward, left, x * left - y * forward];
            let direction_rad = direction_deg.to_radians();
            Ok(Contact { row, radius_m, position_m: wheel.position_m, direction_rad })
        };
        self.wheels().iter().enumerate().map(contact).collect()
    }
}

fn are_enough(key: &'static str, count: usize) -> Result<(), ImpossibleWheels> {
    if (3..=WHEELS_MAX).contains(&count) {
        return Ok(());
    }
    Err(ImpossibleWheels::Count { key, count })
}

fn is_length(key: &str, value: f64) -> Result<(), ImpossibleWheels> {
    if (1e-4..=1e3).contains(&value) {
        return Ok(());
    }
    let expected = "a number of metres from 0.0001 to 1000";
    Err(ImpossibleWheels::Value { key: key.to_owned(), value, expected })
}

fn is_within(
    key: &str,
    value: f64,
    most: f64,
    expected: &'static str,
) -> Result<(), ImpossibleWheels> {
    if value.abs() <= most {
        return Ok(());
    }
    Err(ImpossibleWheels::Value { key: key.to_owned(), value, expected })
}
