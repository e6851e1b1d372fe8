//! The present motion → a curve that joins a path.
//!
//! Between two places p₀ and p₁ a curve of length L has one polynomial of degree 5 per axis with the
//! first and second derivatives of both. With ṡ = √x and s̈ = u at its begin, a motion along it has
//! the velocity q' √x and the acceleration q' u + q'' x there. So the derivatives q' and q'' follow
//! from the present velocity and acceleration: u is the part of the acceleration along the
//! velocity.

use crate::curve::Place;
use crate::timing::SHARE;
use crate::{Limits, Moment};
use robot::AXES;

/// Slowest motion that an entry begins with \[m/s\]. A slower robot has stopped sooner.
const SLOWEST_MPS: f64 = 0.02;
/// Corrections of the length of an entry, so that its parameter counts samples of the path.
const CORRECTIONS: usize = 3;
/// Smallest share of the acceleration that is available along an entry.
const ALONG_MIN: f64 = 0.3;
/// Pieces in which its length is measured.
const PIECES: u32 = 16;

/// How a motion begins along a curve whose parameter counts samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Begin {
    /// Place on the curve with its derivatives.
    place: Place,
    /// ṡ \[1/s\].
    pub(crate) speed: f64,
    /// s̈ \[1/s²\].
    pub(crate) rate: f64,
    /// Part of the acceleration across \[m/s²\].
    across_mps2: f64,
}

impl Begin {
    /// As `moment` moves, with samples every `sample_m`. None if it hardly moves.
    pub(crate) fn of(moment: &Moment, sample_m: f64) -> Option<Self> {
        let ([x, y, _], [ddx, ddy, _]) = (moment.velocity, moment.acceleration);
        let planar = x.hypot(y);
        if planar < SLOWEST_MPS {
            return None;
        }
        let speed = planar / sample_m;
        let rate = (x * ddx + y * ddy) / planar / sample_m;
        let first = moment.velocity.map(|velocity| velocity / speed);
        let second = std::array::from_fn(|axis| {
            (moment.acceleration[axis] - first[axis] * rate) / (speed * speed)
        });
        let across_mps2 = ((x * ddy - y * ddx) / planar).abs();
        Some(Self { place: Place { pose: moment.pose, first, second }, speed, rate, across_mps2 })
    }

    /// Shares of the largest acceleration along an entry and across it, where the part `done` of it
    /// is behind the robot. A begin that needs more across has less along.
    pub(crate) fn shares(&self, done: f64, limits: &Limits) -> [f64; 2] {
        let needed = self.across_mps2 / limits.acceleration_mps2;
        let across = SHARE + (needed - SHARE).max(0.0) * (1.0 - done).max(0.0);
        let along = (1.0 - across * across).max(ALONG_MIN * ALONG_MIN).sqrt();
        [along.min(SHARE), across]
    }
}

/// A curve from a motion to a place on a path.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    /// Of t⁰ to t⁵, t from 0 to 1.
    coefficients: [[f64; AXES]; 6],
    /// Length in samples, a whole number.
    length: f64,
}

impl Entry {
    /// From `begin` to `end`, with `stretch` samples per `sample_m` of its length. The more
    /// samples, the farther it goes on as it begins, and comes from where the path comes from.
    pub(crate) fn between(begin: &Begin, end: &Place, sample_m: f64, stretch: f64) -> Self {
        let [dx, dy] = [0, 1].map(|axis| end.pose[axis] - begin.place.pose[axis]);
        let samples = |length_m: f64| (stretch * length_m / sample_m).ceil().max(1.0);
        let mut entry = Self::of_length(&begin.place, end, samples(dx.hypot(dy)));
        for _ in 0..CORRECTIONS {
            entry = Self::of_length(&begin.place, end, samples(entry.length_m()));
        }
        entry
    }

    fn of_length(begin: &Place, end: &Place, length: f64) -> Self {
        let mut coefficients = [[0.0; AXES]; 6];
        for axis in 0..AXES {
            let way = end.pose[axis] - begin.pose[axis];
            let [v0, v1] = [begin, end].map(|place| length * place.first[axis]);
            let [a0, a1] = [begin, end].map(|place| length * length * place.second[axis]);
            let of_axis = [
                begin.pose[axis],
                v0,
                0.5 * a0,
                10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
                -15.0 * way + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
                6.0 * way - 3.0 * (v0 + v1) - 0.5 * (a0 - a1),
            ];
            for (coefficient, value) in coefficients.iter_mut().zip(of_axis) {
                coefficient[axis] = value;
            }
        }
        Self { coefficients, length }
    }

    /// Length in samples, a whole number.
    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    /// The poses at its samples.
    pub(crate) fn samples(&self) -> impl Iterator<Item = [f64; AXES]> + use<'_> {
        (0..=self.length as u32).map(|sample| self.at(f64::from(sample)).pose)
    }

    fn length_m(&self) -> f64 {
        let place = |piece: u32| self.at(self.length * f64::from(piece) / f64::from(PIECES)).pose;
        let pieces = (0..PIECES).map(|piece| {
            let [a, b] = [place(piece), place(piece + 1)];
            (b[0] - a[0]).hypot(b[1] - a[1])
        });
        pieces.sum()
    }

    /// The place at `parameter`, from 0 to [`length`](Self::length).
    pub(crate) fn at(&self, parameter: f64) -> Place {
        let t = parameter / self.length;
        let mut place = Place::default();
        // Horner's scheme for the value and both derivatives.
        for coefficient in self.coefficients.iter().rev() {
            for axis in 0..AXES {
                place.second[axis] = place.second[axis] * t + 2.0 * place.first[axis];
                place.first[axis] = place.first[axis] * t + place.pose[axis];
                place.pose[axis] = place.pose[axis] * t + coefficient[axis];
            }
        }
        place.first = place.first.map(|value| value / self.length);
        place.second = place.second.map(|value| value / (self.length * self.length));
        place
    }

    /// Third derivatives at `parameter`: the length of that of the position, and the size of that
    /// of the heading.
    pub(crate) fn third_at(&self, parameter: f64) -> [f64; 2] {
        let t = parameter / self.length;
        let [.., c3, c4, c5] = &self.coefficients;
        let third = |axis: usize| {
            (6.0 * c3[axis] + t * (24.0 * c4[axis] + t * 60.0 * c5[axis])) / self.length.powi(3)
        };
        [third(0).hypot(third(1)), third(2).abs()]
    }
}
