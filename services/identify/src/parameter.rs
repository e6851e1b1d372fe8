//! The free parameters of an estimate, as a vector of numbers without bounds.

use crate::log::AXIS_NAMES;
use crate::response::Response;
use robot::AXES;
use std::fmt::{self, Display, Formatter};

/// One number of a [`Response`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// K_ij.
    Gain(usize, usize),
    /// C_ij.
    Cross(usize, usize),
    /// τ.
    TimeConstant(usize),
    /// d.
    DeadTime(usize),
    /// ρ.
    Integral(usize),
    /// c.
    Friction(usize),
    /// e.
    Stiction(usize),
    /// v_s.
    FrictionSpeed,
    /// D.
    Drag,
    /// b.
    Offset(usize),
    /// s.
    Turning,
    /// Largest acceleration.
    Acceleration(usize),
    /// Largest deceleration.
    Braking(usize),
    /// l.
    Saturation,
}

impl Parameter {
    /// Those of a robot of which only `axes` are moved, with integral parts or with offsets. There
    /// are no limits, no saturation and no stiction.
    pub fn of_axes(axes: [bool; AXES], has_integral: bool) -> Vec<Self> {
        let moved = || (0..AXES).filter(|&axis| axes[axis]);
        let mut all = Vec::new();
        for axis in moved() {
            all.extend([
                Self::Gain(axis, axis),
                Self::TimeConstant(axis),
                Self::DeadTime(axis),
                Self::Friction(axis),
                // An integral part makes up for an offset: the two are one.
                if has_integral { Self::Integral(axis) } else { Self::Offset(axis) },
            ]);
            for other in moved().filter(|&other| other != axis) {
                all.extend([Self::Gain(axis, other), Self::Cross(axis, other)]);
            }
        }
        all.push(Self::FrictionSpeed);
        if axes[0] || axes[1] {
            all.push(Self::Drag);
        }
        if axes == [true; AXES] {
            all.push(Self::Turning);
        }
        all
    }

    fn value_in(self, response: &mut Response) -> &mut f64 {
        match self {
            Self::Gain(axis, other) => &mut response.gain[axis][other],
            Self::Cross(axis, other) => &mut response.cross[axis][other],
            Self::TimeConstant(axis) => &mut response.time_constant_s[axis],
            Self::DeadTime(axis) => &mut response.dead_time_s[axis],
            Self::Integral(axis) => &mut response.integral_per_s[axis],
            Self::Friction(axis) => &mut response.friction[axis],
            Self::Stiction(axis) => &mut response.stiction[axis],
            Self::FrictionSpeed => &mut response.friction_speed_mps,
            Self::Drag => &mut response.drag_s_per_m,
            Self::Offset(axis) => &mut response.offset[axis],
            Self::Turning => &mut response.turning,
            Self::Acceleration(axis) => &mut response.acceleration[axis],
            Self::Braking(axis) => &mut response.braking[axis],
            Self::Saturation => &mut response.saturation_mps,
        }
    }

    /// Whether its logarithm is free: it is positive.
    const fn is_positive(self) -> bool {
        matches!(
            self,
            Self::TimeConstant(_)
                | Self::FrictionSpeed
                | Self::Acceleration(_)
                | Self::Braking(_)
                | Self::Saturation
        )
    }

    /// Its value.
    pub fn of(self, response: &Response) -> f64 {
        *self.value_in(&mut response.clone())
    }

    /// The free number of its value.
    pub fn free(self, response: &Response) -> f64 {
        let value = self.of(response);
        if self.is_positive() { value.ln() } else { value }
    }

    /// Sets its value to that of a free number.
    pub fn set(self, response: &mut Response, free: f64) {
        // Bounds keep a trial step of the optimiser finite.
        let value = match self {
            // Below, friction is a switch, and has no derivative.
            Self::FrictionSpeed => free.exp().clamp(0.005, 0.5),
            _ if self.is_positive() => free.clamp(-12.0, 12.0).exp(),
            _ => free,
        };
        *self.value_in(response) = value;
    }

    /// Change of the value per change of the free number.
    pub fn slope(self, response: &Response) -> f64 {
        if self.is_positive() { self.of(response) } else { 1.0 }
    }

    /// Unit of the value.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::TimeConstant(_) | Self::DeadTime(_) => "s",
            Self::Integral(_) => "1/s",
            Self::Friction(2) | Self::Stiction(2) | Self::Offset(2) => "rad/s",
            Self::Friction(_)
            | Self::Stiction(_)
            | Self::Offset(_)
            | Self::FrictionSpeed
            | Self::Saturation => "m/s",
            Self::Acceleration(2) | Self::Braking(2) => "rad/s²",
            Self::Acceleration(_) | Self::Braking(_) => "m/s²",
            Self::Drag => "s/m",
            Self::Gain(..) | Self::Cross(..) | Self::Turning => "1",
        }
    }
}

impl Display for Parameter {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let name = |axis: &usize| AXIS_NAMES.get(*axis).copied().unwrap_or("?");
        match self {
            Self::Gain(axis, other) if axis == other => write!(f, "gain, {}", name(axis)),
            Self::Gain(axis, other) => write!(f, "{} per input {}", name(axis), name(other)),
            Self::Cross(axis, other) => write!(f, "{} per velocity {}", name(axis), name(other)),
            Self::TimeConstant(axis) => write!(f, "time constant, {}", name(axis)),
            Self::DeadTime(axis) => write!(f, "dead time, {}", name(axis)),
            Self::Integral(axis) => write!(f, "integral part, {}", name(axis)),
            Self::Friction(axis) => write!(f, "dry friction, {}", name(axis)),
            Self::Stiction(axis) => write!(f, "more friction at standstill, {}", name(axis)),
            Self::FrictionSpeed => write!(f, "speed of full dry friction"),
            Self::Drag => write!(f, "drag"),
            Self::Offset(axis) => write!(f, "offset, {}", name(axis)),
            Self::Turning => write!(f, "share of the turning frame"),
            Self::Acceleration(axis) => write!(f, "largest acceleration, {}", name(axis)),
            Self::Braking(axis) => write!(f, "largest deceleration, {}", name(axis)),
            Self::Saturation => write!(f, "rim behind its command, saturated"),
        }
    }
}
