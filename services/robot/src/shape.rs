//! Convex shapes in the plane, and the distance between two of them.
//!
//! A shape is the convex hull of a few corners, grown by a radius: one corner is a disc, two are a
//! capsule, and more are a polygon with round corners. A robot's footprint and every obstacle are
//! such shapes.
//!
//! Reference: Ericson, *Real-Time Collision Detection*, 2005, sections 5.1 and 5.2 (closest points,
//! separating axes).

/// Most corners of one shape.
pub const CORNERS_MAX: usize = 8;
/// Largest coordinate and radius \[m\].
const LARGEST_M: f64 = 1e6;

/// A point or a vector in the plane \[m\].
pub type Point = [f64; 2];

/// A shape that does not exist.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ImpossibleShape {
    /// No corner, or too many.
    #[error("expected 1 to {CORNERS_MAX} corners, not {0}")]
    Corners(usize),
    /// A coordinate that is not finite, or too large.
    #[error("expected coordinates from -1e6 to 1e6 m, not {0:?}")]
    Corner(Point),
    /// A negative radius, or one that is not finite or too large.
    #[error("expected a radius from 0 to 1e6 m, not {0}")]
    Radius(f64),
}

/// The convex hull of one to eight corners, grown by a radius.
///
/// ```
/// use robot::Shape;
/// let footprint = Shape::rectangle(0.4, 0.3).placed(&[1.0, 0.0, 0.0]);
/// let disc = Shape::hull(&[[2.0, 0.0]], 0.25)?;
/// let apart = footprint.separation(&disc);
/// assert!((apart.distance_m - 0.55).abs() < 1e-12);
/// assert_eq!(apart.normal, [1.0, 0.0]); // from the footprint to the disc
/// # Ok::<(), robot::ImpossibleShape>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Counter-clockwise; the first `count` are in use.
    corners: [Point; CORNERS_MAX],
    count: usize,
    radius_m: f64,
}

/// Nearest points of two shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Separation {
    /// Distance; where the shapes overlap, minus the way that parts them \[m\].
    pub distance_m: f64,
    /// Unit vector from the first shape towards the second. The shapes stay apart as long as
    /// neither has moved by more than the distance along it, relative to the other.
    pub normal: Point,
    /// The point of the first shape's hull, without its radius, that is nearest to the second
    /// \[m\].
    pub nearest_m: Point,
}

impl Shape {
    /// The hull of `corners` in any order, grown by `radius_m`. Corners inside it are dropped.
    ///
    /// # Errors
    /// [`ImpossibleShape`].
    pub fn hull(corners: &[Point], radius_m: f64) -> Result<Self, ImpossibleShape> {
        if corners.is_empty() || corners.len() > CORNERS_MAX {
            return Err(ImpossibleShape::Corners(corners.len()));
        }
        if let Some(corner) =
            corners.iter().find(|corner| !corner.iter().copied().all(is_coordinate))
        {
            return Err(ImpossibleShape::Corner(*corner));
        }
        if !(0.0..=LARGEST_M).contains(&radius_m) {
            return Err(ImpossibleShape::Radius(radius_m));
        }
        let mut sorted = [[f64::INFINITY; 2]; CORNERS_MAX];
        sorted[..corners.len()].copy_from_slice(corners);
        let sorted = &mut sorted[..corners.len()];
        sorted.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let mut hull = Chain::default();
        for corner in sorted.iter() {
            hull.add(*corner, 0);
        }
        let lower = hull.len;
        for corner in sorted.iter().rev().skip(1) {
            hull.add(*corner, lower - 1);
        }
        // The chain ends at its begin.
        let count = if hull.len > 1 { hull.len - 1 } else { hull.len };
        let mut shape = Self { corners: [[0.0; 2]; CORNERS_MAX], count, radius_m };
        shape.corners[..count].copy_from_slice(&hull.corners[..count]);
        Ok(shape)
    }

    /// A rectangle around the origin, `length_m` along x and `width_m` along y.
    pub fn rectangle(length_m: f64, width_m: f64) -> Self {
        let (x, y) = (0.5 * length_m, 0.5 * width_m);
        let mut corners = [[0.0; 2]; CORNERS_MAX];
        corners[..4].copy_from_slice(&[[-x, -y], [x, -y], [x, y], [-x, y]]);
        Self { corners, count: 4, radius_m: 0.0 }
    }

    /// Its corners, counter-clockwise \[m\].
    pub fn corners(&self) -> &[Point] {
        &self.corners[..self.count]
    }

    /// Radius by which the hull is grown \[m\].
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// The same shape, grown by `by_m` more.
    #[must_use]
    pub fn grown(&self, by_m: f64) -> Self {
        Self { radius_m: (self.radius_m + by_m).max(0.0), ..*self }
    }

    /// The same shape, moved by `by` \[m\].
    #[must_use]
    pub fn moved(&self, by: Point) -> Self {
        self.each(|[x, y]| [x + by[0], y + by[1]])
    }

    /// A shape of the body frame, in the world, at the pose (x, y, yaw) \[m, m, rad\].
    #[must_use]
    pub fn placed(&self, pose: &[f64; 3]) -> Self {
        let (sin, cos) = pose[2].sin_cos();
        self.each(|[x, y]| [pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y])
    }

    /// Mean of the corners, and the radius of a circle around it that contains the shape \[m\].
    pub fn circle(&self) -> (Point, f64) {
        let share = 1.0 / self.count as f64;
        let centre = self
            .corners()
            .iter()
            .fold([0.0; 2], |sum, corner| [sum[0] + share * corner[0], sum[1] + share * corner[1]]);
        let farthest =
            self.corners().iter().map(|corner| length(less(*corner, centre))).fold(0.0, f64::max);
        (centre, farthest + self.radius_m)
    }

    /// How far this shape is from `other`, and in which direction. O(corners²), without allocation.
    pub fn separation(&self, other: &Self) -> Separation {
        let radii = self.radius_m + other.radius_m;
        let axis = best(self.widest_gap(other, 1.0), other.widest_gap(self, -1.0));
        if let Some(Gap { width_m, normal, nearest_m }) = axis
            && width_m < 0.0
        {
            return Separation { distance_m: width_m - radii, normal, nearest_m };
        }
        let mut nearest = (f64::INFINITY, [0.0; 2], [0.0; 2]);
        for corner in self.corners() {
            for (from, to) in other.edges() {
                let point = nearest_on(*corner, from, to);
                closer(&mut nearest, *corner, point);
            }
        }
        for corner in other.corners() {
            for (from, to) in self.edges() {
                let point = nearest_on(*corner, from, to);
                closer(&mut nearest, point, *corner);
            }
        }
        let (distance, here, there) = nearest;
        let normal = if distance > 0.0 {
            less(there, here).map(|value| value / distance)
        } else {
            axis.map_or([1.0, 0.0], |gap| gap.normal)
        };
        Separation { distance_m: distance - radii, normal, nearest_m: here }
    }

    /// Largest coordinate of the shape along `normal`, a unit vector \[m\].
    pub fn extent_m(&self, normal: Point) -> f64 {
        let along = self.corners().iter().map(|corner| dot(normal, *corner));
        along.fold(f64::NEG_INFINITY, f64::max) + self.radius_m
    }

    /// The edge of this hull beyond which `other` lies farthest: its outer normal times `sign`, and
    /// the gap along it, negative where all edges have a part of `other` inside.
    fn widest_gap(&self, other: &Self, sign: f64) -> Option<Gap> {
        let mut widest: Option<Gap> = None;
        for (from, to) in self.edges() {
            let [x, y] = less(to, from);
            let long = x.hypot(y);
            if long == 0.0 {
                continue;
            }
            let outer = [y / long, -x / long];
            let (width_m, corner) = other
                .corners()
                .iter()
                .map(|corner| (dot(outer, less(*corner, from)), *corner))
                .fold((f64::INFINITY, from), |a, b| if b.0 < a.0 { b } else { a });
            let nearest_m = if sign > 0.0 { nearest_on(corner, from, to) } else { corner };
            let normal = outer.map(|value| sign * value);
            widest = best(widest, Some(Gap { width_m, normal, nearest_m }));
        }
        widest
    }

    /// Its edges; one corner is an edge without length, and two corners have an edge each way.
    fn edges(&self) -> impl Iterator<Item = (Point, Point)> {
        let next = self.corners().iter().cycle().skip(1);
        self.corners().iter().copied().zip(next.copied())
    }

    fn each(&self, change: impl Fn(Point) -> Point) -> Self {
        let mut changed = *self;
        changed.corners[..self.count].iter_mut().for_each(|corner| *corner = change(*corner));
        changed
    }
}

/// Distance along one axis.
#[derive(Debug, Clone, Copy)]
struct Gap {
    width_m: f64,
    normal: Point,
    nearest_m: Point,
}

fn best(a: Option<Gap>, b: Option<Gap>) -> Option<Gap> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.width_m > a.width_m { b } else { a }),
        (a, b) => a.or(b),
    }
}

/// Lower and upper chain of a hull (Andrew's algorithm).
#[derive(Default)]
struct Chain {
    corners: [Point; CORNERS_MAX + 1],
    len: usize,
}

impl Chain {
    /// Adds `corner`, and drops those after the place `keep` that do not turn left.
    fn add(&mut self, corner: Point, keep: usize) {
        while self.len > keep + 1 {
            let (a, b) = (self.corners[self.len - 2], self.corners[self.len - 1]);
            let (ab, ac) = (less(b, a), less(corner, a));
            if ab[0] * ac[1] - ab[1] * ac[0] > 0.0 {
                break;
            }
            self.len -= 1;
        }
        if self.len == 0 || self.corners[self.len - 1] != corner {
            self.corners[self.len] = corner;
            self.len += 1;
        }
    }
}

fn is_coordinate(value: f64) -> bool {
    value.abs() <= LARGEST_M
}

fn closer(nearest: &mut (f64, Point, Point), here: Point, there: Point) {
    let distance = length(less(there, here));
    if distance < nearest.0 {
        *nearest = (distance, here, there);
    }
}

/// The point of the edge from `from` to `to` that is nearest to `point`.
fn nearest_on(point: Point, from: Point, to: Point) -> Point {
    let edge = less(to, from);
    let squared = dot(edge, edge);
    let share = if squared > 0.0 { dot(less(point, from), edge) / squared } else { 0.0 };
    let share = share.clamp(0.0, 1.0);
    [from[0] + share * edge[0], from[1] + share * edge[1]]
}

fn less(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn length(a: Point) -> f64 {
    a[0].hypot(a[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shapes() -> impl Strategy<Value = Shape> {
        let corner = prop::array::uniform2(-2.0..2.0);
        (prop::collection::vec(corner, 1..=CORNERS_MAX), 0.0..0.5)
            .prop_filter_map("a shape", |(corners, radius)| Shape::hull(&corners, radius).ok())
    }

    /// Points on the border of the hull.
    fn border(shape: &Shape) -> Vec<Point> {
        let along = |(from, to): (Point, Point)| {
            (0..=20).map(move |i| {
                let share = f64::from(i) / 20.0;
                [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]
            })
        };
        shape.edges().flat_map(along).collect()
    }

    proptest! {
        #[test]
        fn the_distance_is_the_least_of_all_pairs_of_points(a in shapes(), b in shapes()) {
            let apart = a.separation(&b);
            let radii = a.radius_m() + b.radius_m();
            prop_assume!(apart.distance_m + radii > 0.0);
            let least = border(&a)
                .iter()
                .flat_map(|from| border(&b).into_iter().map(|to| length(less(to, *from))))
                .fold(f64::INFINITY, f64::min);
            prop_assert!(apart.distance_m + radii <= least + 1e-12);
            prop_assert!(apart.distance_m + radii >= least - 0.3);
        }

        #[test]
        fn a_move_by_less_than_the_distance_along_the_normal_does_not_touch(
            a in shapes(), b in shapes(), across in -3.0..3.0,
        ) {
            let apart = a.separation(&b);
            let [x, y] = apart.normal;
            prop_assert!((x.hypot(y) - 1.0).abs() < 1e-9);
            let along = apart.distance_m - 1e-6;
            let moved = a.moved([along * x - across * y, along * y + across * x]);
            prop_assert!(moved.separation(&b).distance_m > 0.0, "{apart:?}");
        }

        #[test]
        fn the_separation_has_no_order(a in shapes(), b in shapes()) {
            let (there, back) = (a.separation(&b), b.separation(&a));
            prop_assert!((there.distance_m - back.distance_m).abs() < 1e-9);
        }

        #[test]
        fn a_hull_holds_all_its_corners(corners in prop::collection::vec(
            prop::array::uniform2(-2.0..2.0), 1..=CORNERS_MAX,
        )) {
            let hull = Shape::hull(&corners, 0.0).map_err(|e| TestCaseError::fail(e.to_string()))?;
            for corner in corners {
                let point = Shape::hull(&[corner], 1e-9)
                    .map_err(|e| TestCaseError::fail(e.to_string()))?;
                prop_assert!(hull.separation(&point).distance_m <= 1e-12);
            }
        }
    }

    #[test]
    fn shapes_that_do_not_exist_are_refused() {
        assert_eq!(Shape::hull(&[], 0.1), Err(ImpossibleShape::Corners(0)));
        assert_eq!(Shape::hull(&[[0.0; 2]; 9], 0.1), Err(ImpossibleShape::Corners(9)));
        assert_eq!(Shape::hull(&[[0.0; 2]], -0.1), Err(ImpossibleShape::Radius(-0.1)));
        for bad in [f64::NAN, f64::INFINITY, 2e6] {
            assert!(Shape::hull(&[[0.0, bad]], 0.1).is_err());
            assert!(Shape::hull(&[[0.0, 0.0]], bad).is_err());
        }
    }

    #[test]
    fn equal_corners_are_one_and_a_line_has_two() -> Result<(), ImpossibleShape> {
        assert_eq!(Shape::hull(&[[1.0, 2.0]; 8], 0.3)?.corners(), [[1.0, 2.0]]);
        let line = Shape::hull(&[[0.0, 0.0], [2.0, 0.0], [1.0, 0.0]], 0.0)?;
        assert_eq!(line.corners(), [[0.0, 0.0], [2.0, 0.0]]);
        Ok(())
    }

    #[test]
    fn overlapping_shapes_have_the_way_that_parts_them() -> Result<(), ImpossibleShape> {
        let robot = Shape::rectangle(2.0, 1.0);
        let disc = Shape::hull(&[[0.9, 0.0]], 0.5)?;
        let apart = robot.separation(&disc);
        assert!((apart.distance_m + 0.6).abs() < 1e-12, "{apart:?}");
        assert_eq!(apart.normal, [1.0, 0.0]);
        Ok(())
    }
}
