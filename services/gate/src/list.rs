//! Lists of obstacles: the rows of an [`Obstacles`] message as shapes, and back.

use protocol::message::{OBSTACLE_NUMBERS, Obstacles};
use robot::{CORNERS_MAX, ImpossibleShape, Obstacle, Point, Shape};

/// Largest speed of an obstacle \[m/s\].
const LARGEST_MPS: f64 = 1e3;
/// Largest age and validity \[s\].
const LARGEST_S: f64 = 1e3;

// A row has velocity, radius and the corners.
const _: () = assert!(OBSTACLE_NUMBERS == 3 + 2 * CORNERS_MAX);

/// A list that no sensor can have measured.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ImpossibleList {
    /// The shape of one obstacle.
    #[error("obstacle {0}: {1}")]
    Shape(usize, ImpossibleShape),
    /// Its velocity.
    #[error("obstacle {0}: expected velocities from -1000 to 1000 m/s, not {1:?}")]
    Velocity(usize, Point),
    /// An age or a validity.
    #[error("{field} = {value}: expected 0 to 1000 s")]
    Time {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Reads `list` into `obstacles`, whose capacity holds it. The obstacles are those of the time at
/// which the list was sent. A bad list changes nothing.
///
/// # Errors
/// [`ImpossibleList`] names the first value that is wrong.
pub fn read(list: &Obstacles, obstacles: &mut Vec<Obstacle>) -> Result<(), ImpossibleList> {
    for (field, value) in [("age_s", list.age_s), ("valid_s", list.valid_s)] {
        if !(0.0..=LARGEST_S).contains(&value) {
            return Err(ImpossibleList::Time { field, value });
        }
    }
    for (index, row) in list.rows().iter().enumerate() {
        read_row(index, row)?;
    }
    obstacles.clear();
    let rows = list.rows().iter().enumerate();
    obstacles.extend(rows.filter_map(|(index, row)| {
        read_row(index, row).ok().map(|obstacle| obstacle.after(list.age_s))
    }));
    Ok(())
}

fn read_row(index: usize, row: &[f64; OBSTACLE_NUMBERS]) -> Result<Obstacle, ImpossibleList> {
    let &[x, y, radius_m, ref corners @ ..] = row;
    if !(x.abs() <= LARGEST_MPS && y.abs() <= LARGEST_MPS) {
        return Err(ImpossibleList::Velocity(index, [x, y]));
    }
    let (corners, _) = corners.as_chunks::<2>();
    let shape = Shape::hull(corners, radius_m).map_err(|e| ImpossibleList::Shape(index, e))?;
    Ok(Obstacle { shape, velocity_mps: [x, y] })
}

/// Writes `obstacles` into `list`, and returns how many of them it has no room for.
pub fn write(obstacles: &[Obstacle], list: &mut Obstacles) -> usize {
    for (row, obstacle) in list.obstacles.iter_mut().zip(obstacles) {
        *row = written(obstacle);
    }
    list.count = obstacles.len().min(list.obstacles.len()) as u32;
    obstacles.len() - list.count as usize
}

fn written(obstacle: &Obstacle) -> [f64; OBSTACLE_NUMBERS] {
    let mut row = [0.0; OBSTACLE_NUMBERS];
    let [x, y, radius, corners @ ..] = &mut row;
    (*x, *y, *radius) =
        (obstacle.velocity_mps[0], obstacle.velocity_mps[1], obstacle.shape.radius_m());
    let known = obstacle.shape.corners();
    let last = known.last().copied().unwrap_or_default();
    let (places, _) = corners.as_chunks_mut::<2>();
    for (index, place) in places.iter_mut().enumerate() {
        *place = known.get(index).copied().unwrap_or(last);
    }
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::message::OBSTACLES_MAX;

    fn obstacles() -> Result<Vec<Obstacle>, ImpossibleShape> {
        let disc = Shape::hull(&[[1.0, 2.0]], 0.3)?;
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let moving = Obstacle { shape: Shape::hull(&corners, 0.0)?, velocity_mps: [0.5, -0.25] };
        Ok(vec![Obstacle::standing(disc), moving])
    }

    #[test]
    fn a_list_comes_back_as_it_was_written() -> Result<(), ImpossibleShape> {
        let (mut list, mut read_back) = (Obstacles::zeroed(), Vec::with_capacity(OBSTACLES_MAX));
        assert_eq!(write(&obstacles()?, &mut list), 0);
        assert_eq!(read(&list, &mut read_back), Ok(()));
        assert_eq!(read_back, obstacles()?);
        list.age_s = 2.0;
        assert_eq!(read(&list, &mut read_back), Ok(()));
        assert_eq!(read_back[1].shape, obstacles()?[1].shape.moved([1.0, -0.5]));
        Ok(())
    }

    #[test]
    fn a_bad_list_is_refused_as_a_whole() -> Result<(), ImpossibleShape> {
        let mut good = Obstacles::zeroed();
        write(&obstacles()?, &mut good);
        let mut known = obstacles()?;
        for (place, value) in [((1, 0), f64::NAN), ((0, 2), -1.0), ((1, 7), f64::INFINITY)] {
            let mut bad = good;
            bad.obstacles[place.0][place.1] = value;
            assert!(read(&bad, &mut known).is_err(), "{place:?} = {value}");
            assert_eq!(known, obstacles()?);
        }
        let bad = Obstacles { valid_s: f64::NAN, ..good };
        assert!(matches!(read(&bad, &mut known), Err(ImpossibleList::Time { .. })));
        Ok(())
    }

    #[test]
    fn obstacles_without_room_are_counted() -> Result<(), ImpossibleShape> {
        let many = vec![obstacles()?[0]; OBSTACLES_MAX + 3];
        let mut list = Obstacles::zeroed();
        assert_eq!((write(&many, &mut list), list.count as usize), (3, OBSTACLES_MAX));
        Ok(())
    }
}
