//! The bounded data set of the learner: when it is full, the point that tells least new gives way.
//!
//! That is the older one of the two points that lie closest together in the scaled inputs: a robot that goes on in a steady state
//! renews what it knows of it, and keeps what it learnt of everything else.

/// One observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation<const D: usize> {
    /// Where it was made, not normalised.
    pub input: [f64; D],
    /// What was seen there, per output.
    pub target: [f64; 3],
}

/// At most `capacity` observations, in the order in which they were made.
#[derive(Debug, Clone)]
pub struct Dataset<const D: usize> {
    capacity: usize,
    scale: [f64; D],
    observations: Vec<Observation<D>>,
    /// Squared distance to, and place of, the nearest *newer* neighbour of each observation.
    nearest: Vec<f64>,
}

impl<const D: usize> Dataset<D> {
    /// An empty set for `capacity` observations, whose inputs are compared in units of `scale`.
    pub fn new(capacity: usize, scale: [f64; D]) -> Self {
        Self { capacity, scale, observations: Vec::with_capacity(capacity + 1), nearest: Vec::with_capacity(capacity + 1) }
    }

    /// The observations, oldest first.
    pub fn observations(&self) -> &[Observation<D>] {
        &self.observations
    }

    /// Takes in one observation; one that is not finite is refused. O(n).
    ///
    /// Returns whether it was taken in.
    pub fn insert(&mut self, observation: Observation<D>) -> bool {
        let finite = observation.input.iter().chain(&observation.target).all(|value| value.is_finite());
        if !finite || self.capacity == 0 {
            return false;
        }
        for (nearest, older) in self.nearest.iter_mut().zip(&self.observations) {
            *nearest = nearest.min(squared_distance(&self.scale, &older.input, &observation.input));
        }
        self.observations.push(observation);
        self.nearest.push(f64::INFINITY);
        if self.observations.len() > self.capacity {
            self.forget_one();
        }
        true
    }

    /// Removes the observation whose nearest newer neighbour is the closest. Who had it for a nearest neighbour looks again. O(n²) at worst.
    fn forget_one(&mut self) {
        let closest = self.nearest.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
        let Some((place, _)) = closest else { return };
        let gone = self.observations.remove(place);
        self.nearest.remove(place);
        for older in 0..place {
            let Some(input) = self.observations.get(older).map(|observation| observation.input) else { continue };
            let was_nearest = self.nearest.get(older).is_some_and(|&nearest| nearest >= squared_distance(&self.scale, &input, &gone.input));
            if was_nearest {
                let newer = self.observations.iter().skip(older + 1);
                let again = newer.map(|other| squared_distance(&self.scale, &input, &other.input)).fold(f64::INFINITY, f64::min);
                if let Some(nearest) = self.nearest.get_mut(older) {
                    *nearest = again;
                }
            }
        }
    }
}

fn squared_distance<const D: usize>(scale: &[f64; D], a: &[f64; D], b: &[f64; D]) -> f64 {
    a.iter().zip(b).zip(scale).map(|((a, b), scale)| ((a - b) / scale).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> Observation<1> {
        Observation { input: [x], target: [y; 3] }
    }

    #[test]
    fn a_full_set_keeps_what_is_far_and_renews_what_is_near() {
        let mut set = Dataset::new(3, [1.0]);
        for observation in [at(0.0, 1.0), at(5.0, 2.0), at(5.1, 3.0), at(9.0, 4.0)] {
            assert!(set.insert(observation));
        }
        let kept: Vec<f64> = set.observations().iter().map(|observation| observation.target[0]).collect();
        assert_eq!(kept, [1.0, 3.0, 4.0]);
    }

    #[test]
    fn a_million_samples_of_one_place_leave_the_others_alone() {
        let mut set = Dataset::new(10, [1.0]);
        for place in 0..9 {
            set.insert(at(f64::from(place), 0.0));
        }
        for repeat in 0..2_000 {
            set.insert(at(20.0, f64::from(repeat)));
        }
        assert_eq!(set.observations().len(), 10);
        assert!((0..9).all(|place| set.observations().iter().any(|observation| observation.input[0] == f64::from(place))));
        assert_eq!(set.observations().last().map(|newest| newest.target[0]), Some(1_999.0));
    }

    #[test]
    fn what_is_not_finite_never_enters() {
        let mut set = Dataset::new(3, [1.0]);
        assert!(!set.insert(at(f64::NAN, 0.0)));
        assert!(!set.insert(at(0.0, f64::INFINITY)));
        assert!(set.observations().is_empty());
    }
}
