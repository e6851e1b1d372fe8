//! A way around obstacles, as a line of points.
//!
//! A* on a grid (Hart, Nilsson, Raphael 1968; crate `pathfinding`) finds the shortest way of a disc
//! around the robot's centre, so that the robot can have any heading. Points that a straight line
//! can skip are left out. Obstacles count where they are now.

use crate::MotionError;
use pathfinding::directed::astar::astar;
use robot::{Obstacle, Point, Shape};
use std::cell::RefCell;
use std::collections::HashMap;

/// Smallest distance of two grid points \[m\].
const CELL_MIN_M: f64 = 0.05;
/// Most grid points in one direction.
const CELLS_MAX: f64 = 400.0;
/// How far a way may lead outside the box around robot, goal and near obstacles \[m\].
const MARGIN_M: f64 = 1.0;
/// Obstacles farther from both ends than this do not make the grid larger \[m\].
const NEAR_M: f64 = 30.0;
/// Distance that a way keeps from obstacles beyond the robot's own: the curve through its points
/// cuts corners \[m\].
const CORNERS_M: f64 = 0.03;
/// Units of a cost in one grid step.
const UNITS: f64 = 1000.0;

/// What a way keeps clear of.
#[derive(Debug, Clone, Copy)]
pub struct Ground<'a> {
    /// The obstacles.
    pub obstacles: &'a [Obstacle],
    /// The area that the robot does not leave.
    pub fence: Option<&'a Shape>,
    /// Radius of a circle around the robot's centre that the whole footprint is in \[m\].
    pub outer_m: f64,
    /// Radius of a circle around the robot's centre that is in its footprint \[m\].
    pub inner_m: f64,
}

/// The way from `from` to `to`: its corners behind `from`, and `to`. At both ends it may be as near
/// to obstacles as the end itself.
///
/// # Errors
/// [`MotionError::GoalBlocked`] if the robot cannot stand at `to`, and [`MotionError::NoWay`] if no
/// way leads there.
pub fn route(from: Point, to: Point, ground: &Ground<'_>) -> Result<Vec<Point>, MotionError> {
    let room = ground.room(to);
    if room < ground.inner_m {
        return Err(MotionError::GoalBlocked { room_m: room.max(0.0), needed_m: ground.inner_m });
    }
    let search = Search::new(from, to, ground);
    if search.is_straight(from, to) {
        return Ok(vec![to]);
    }
    let (cells, _) = astar(
        &(0, 0),
        |cell| search.next(*cell),
        |cell| search.estimate(*cell),
        |cell| search.is_end(*cell),
    )
    .ok_or(MotionError::NoWay)?;
    let mut points: Vec<Point> = cells.into_iter().map(|cell| search.place(cell)).collect();
    points.push(to);
    Ok(search.shortened(&points))
}

impl Ground<'_> {
    /// Distance from `point` to the nearest obstacle or to the border \[m\].
    pub fn room(&self, point: Point) -> f64 {
        let here = Shape::rectangle(0.0, 0.0).moved(point);
        let to_obstacles = self
            .obstacles
            .iter()
            .map(|obstacle| here.separation(&obstacle.shape).distance_m)
            .fold(f64::INFINITY, f64::min);
        to_obstacles.min(self.fence.map_or(f64::INFINITY, |fence| inside(fence, point)))
    }
}

/// How far inside the convex `fence` the point is \[m\].
fn inside(fence: &Shape, point: Point) -> f64 {
    let corners = fence.corners();
    let edges = corners.iter().zip(corners.iter().cycle().skip(1));
    edges
        .map(|(a, b)| {
            let along = [b[0] - a[0], b[1] - a[1]];
            let to = [point[0] - a[0], point[1] - a[1]];
            (along[0] * to[1] - along[1] * to[0]) / along[0].hypot(along[1])
        })
        .fold(f64::INFINITY, f64::min)
}

/// Grid point relative to the begin of the way.
type Cell = (i32, i32);

/// One search. Grid points are looked at once.
struct Search<'a> {
    ground: &'a Ground<'a>,
    from: Point,
    to: Point,
    /// Room at both ends \[m\].
    room: [f64; 2],
    cell_m: f64,
    /// Smallest and largest x and y of the grid \[m\].
    bounds: [Point; 2],
    free: RefCell<HashMap<Cell, bool>>,
}

impl<'a> Search<'a> {
    fn new(from: Point, to: Point, ground: &'a Ground<'a>) -> Self {
        let mut bounds = [from, from];
        let mut include = |[x, y]: Point, radius: f64| {
            bounds[0] = [bounds[0][0].min(x - radius), bounds[0][1].min(y - radius)];
            bounds[1] = [bounds[1][0].max(x + radius), bounds[1][1].max(y + radius)];
        };
        include(to, 0.0);
        for obstacle in ground.obstacles {
            let (centre, radius) = obstacle.shape.circle();
            if distance(centre, from).min(distance(centre, to)) <= NEAR_M {
                include(centre, radius.min(NEAR_M));
            }
        }
        let margin = MARGIN_M + 2.0 * ground.outer_m;
        let [low, high] = bounds;
        let bounds = [low.map(|value| value - margin), high.map(|value| value + margin)];
        let span = (bounds[1][0] - bounds[0][0]).max(bounds[1][1] - bounds[0][1]);
        Self {
            ground,
            from,
            to,
            room: [ground.room(from), ground.room(to)],
            cell_m: CELL_MIN_M.max(span / CELLS_MAX),
            bounds,
            free: RefCell::default(),
        }
    }

    fn place(&self, (x, y): Cell) -> Point {
        [self.from[0] + f64::from(x) * self.cell_m, self.from[1] + f64::from(y) * self.cell_m]
    }

    /// Whether the robot can be at `point`.
    fn is_free(&self, point: Point) -> bool {
        let usual = self.ground.outer_m + CORNERS_M;
        let [from, to] = self.room;
        let mut needed = usual;
        // Near an end that is close to an obstacle, the robot may be as close.
        for (end, room) in [(self.from, from), (self.to, to)] {
            if distance(point, end) <= usual {
                needed = needed.min(room - 1e-6);
            }
        }
        self.ground.room(point) >= needed
    }

    fn next(&self, (x, y): Cell) -> Vec<(Cell, u64)> {
        let steps = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy)));
        steps
            .filter(|step| *step != (0, 0))
            .map(|(dx, dy)| ((x + dx, y + dy), f64::from(dx * dx + dy * dy).sqrt()))
            .filter(|(cell, _)| self.is_free_cell(*cell))
            .map(|(cell, steps)| (cell, (steps * UNITS) as u64))
            .collect()
    }

    fn is_free_cell(&self, cell: Cell) -> bool {
        let point = self.place(cell);
        let [low, high] = self.bounds;
        let within = (0..2).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]));
        within && *self.free.borrow_mut().entry(cell).or_insert_with(|| self.is_free(point))
    }

    /// A bound from below on the cost that remains.
    fn estimate(&self, cell: Cell) -> u64 {
        let steps = distance(self.place(cell), self.to) / self.cell_m - 1.5;
        (steps.max(0.0) * UNITS * 0.999) as u64
    }

    fn is_end(&self, cell: Cell) -> bool {
        let point = self.place(cell);
        distance(point, self.to) <= 1.5 * self.cell_m && self.is_straight(point, self.to)
    }

    /// Whether the robot can drive straight from `a` to `b`.
    fn is_straight(&self, a: Point, b: Point) -> bool {
        let steps = (2.0 * distance(a, b) / self.cell_m).ceil().max(1.0) as u32;
        (0..=steps).all(|step| {
            let share = f64::from(step) / f64::from(steps);
            self.is_free([a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])])
        })
    }

    /// The corners of `points` that a straight line cannot skip, without the first point.
    fn shortened(&self, points: &[Point]) -> Vec<Point> {
        let mut corners = Vec::new();
        let mut here = 0;
        while here + 1 < points.len() {
            let mut next = here + 1;
            while next + 1 < points.len() && self.is_straight(points[here], points[next + 1]) {
                next += 1;
            }
            corners.push(points[next]);
            here = next;
        }
        corners
    }
}

fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::ImpossibleShape;
    use std::error::Error;

    fn ground<'a>(obstacles: &'a [Obstacle], fence: Option<&'a Shape>) -> Ground<'a> {
        Ground { obstacles, fence, outer_m: 0.3, inner_m: 0.2 }
    }

    fn disc(centre: Point, radius: f64) -> Result<Obstacle, ImpossibleShape> {
        Ok(Obstacle::standing(Shape::hull(&[centre], radius)?))
    }

    fn least_room(from: Point, way: &[Point], ground: &Ground<'_>) -> f64 {
        let mut line = vec![from];
        line.extend(way);
        let places = line.windows(2).flat_map(|pair| {
            (0..=100).map(|i| {
                let share = f64::from(i) / 100.0;
                let at = |axis: usize| pair[0][axis] + share * (pair[1][axis] - pair[0][axis]);
                [at(0), at(1)]
            })
        });
        places.map(|place| ground.room(place)).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn without_obstacles_the_way_is_straight() {
        assert_eq!(route([0.0; 2], [3.0, 1.0], &ground(&[], None)), Ok(vec![[3.0, 1.0]]));
    }

    #[test]
    fn the_way_leads_around_a_wall_and_keeps_clear_of_it() -> Result<(), Box<dyn Error>> {
        let wall = Shape::hull(&[[2.0, -1.0], [2.2, -1.0], [2.2, 2.0], [2.0, 2.0]], 0.0)?;
        let obstacles = [Obstacle::standing(wall)];
        let ground = ground(&obstacles, None);
        let way = route([0.0; 2], [4.0, 0.0], &ground)?;
        assert!(least_room([0.0; 2], &way, &ground) >= 0.3);
        let length: f64 = std::iter::once([0.0; 2])
            .chain(way.iter().copied())
            .zip(&way)
            .map(|(a, b)| distance(a, *b))
            .sum();
        assert!((4.5..5.2).contains(&length), "{length} {way:?}");
        Ok(())
    }

    #[test]
    fn a_goal_without_a_way_or_without_room_is_refused() -> Result<(), ImpossibleShape> {
        let obstacles = [disc([3.0, 0.0], 0.5)?];
        assert!(matches!(
            route([0.0; 2], [3.2, 0.0], &ground(&obstacles, None)),
            Err(MotionError::GoalBlocked { .. })
        ));
        let fence = Shape::rectangle(4.0, 4.0);
        assert!(matches!(
            route([0.0; 2], [2.5, 0.0], &ground(&[], Some(&fence))),
            Err(MotionError::GoalBlocked { .. })
        ));
        let corner = |x: f64, y: f64| [x, y];
        let ring = [
            [corner(2.0, -1.0), corner(4.0, -1.0)],
            [corner(4.0, -1.0), corner(4.0, 1.0)],
            [corner(4.0, 1.0), corner(2.0, 1.0)],
            [corner(2.0, 1.0), corner(2.0, -1.0)],
        ];
        let walls = ring
            .iter()
            .map(|ends| Shape::hull(ends, 0.05).map(Obstacle::standing))
            .collect::<Result<Vec<_>, _>>()?;
        assert_eq!(route([0.0; 2], [3.0, 0.0], &ground(&walls, None)), Err(MotionError::NoWay));
        Ok(())
    }

    #[test]
    fn a_robot_close_to_an_obstacle_gets_away_from_it() -> Result<(), ImpossibleShape> {
        let obstacles = [disc([0.5, 0.0], 0.25)?];
        let ground = ground(&obstacles, None);
        let way = route([0.0; 2], [2.0, 0.0], &ground);
        assert!(way.is_ok_and(|way| least_room([0.0; 2], &way, &ground) >= 0.25 - 1e-6));
        Ok(())
    }
}
