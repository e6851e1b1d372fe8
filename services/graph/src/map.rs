//! The map file: known obstacles, zones and the border of the area.

use gateway::settings::DrawnMap;
use robot::{Map, Point};
use serde::Deserialize;
use settings::{Check, Impossible};

/// A map file.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
pub(crate) struct MapFile(pub(crate) Map);

impl Check for MapFile {
    fn check(&self) -> Result<(), Impossible> {
        self.0.surroundings().map(drop).map_err(|error| Impossible::new(error.key, error.expected))
    }
}

/// `map` for the page.
pub(crate) fn drawn(map: &Map) -> DrawnMap {
    let shape = |radius_m: f64, corners: &[Point]| {
        std::iter::once(radius_m).chain(corners.iter().flatten().copied()).collect::<Vec<f64>>()
    };
    DrawnMap {
        obstacles: map.obstacles.iter().map(|one| shape(one.radius_m, &one.corners_m)).collect(),
        zones: map.zones.iter().map(|one| shape(one.radius_m, &one.corners_m)).collect(),
        fence: if map.fence_m.is_empty() { vec![] } else { vec![shape(0.0, &map.fence_m)] },
    }
}
