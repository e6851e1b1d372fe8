//! Minimisation of a smooth function in a box, by a quasi-Newton method.
//!
//! | here       | in the equations                             | size    |
//! |------------|----------------------------------------------|---------|
//! | `point`    | x                                            | `n`     |
//! | `gradient` | g = ∇f(x)                                    | `n`     |
//! | `hessian`  | B, the BFGS approximation of ∇²f             | `n`×`n` |
//! | `step`     | d = argmin gᵀd + ½ dᵀB d, x + d in the box   | `n`     |
//!
//! L-BFGS-B takes the same step from a B of limited memory, and needs a Cauchy point to guess the
//! active bounds. A fit has about a dozen hyperparameters, so B is stored in full. The quadratic
//! program of the step is solved by a primal–dual active set, which needs fewer evaluations. The
//! step keeps x + t d in the box for t ≤ 1, and a strong-Wolfe search follows it.
//!
//! Reference: Nocedal & Wright, *Numerical Optimization*, 2006, ch. 6 and 16.7; Hintermüller, Ito &
//! Kunisch, *The primal-dual active set strategy as a semismooth Newton method*, SIAM J. Optim. 13,
//! 2002.

use nalgebra::{DMatrix, DVector};

use crate::gp::line_search::{self, Trial};

/// Box that holds the minimum.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchBox {
    /// Smallest allowed of each variable; may be −∞.
    pub lower: DVector<f64>,
    /// Largest allowed of each variable; may be ∞.
    pub upper: DVector<f64>,
}

/// Limits of the search and of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MinimiseOptions {
    /// Evaluations of the function, the first included.
    pub max_evaluations: usize,
    /// Quasi-Newton steps.
    pub max_iterations: usize,
    /// Stops when no entry of the gradient that does not push against a bound is larger.
    pub gradient_tolerance: f64,
    /// Stops when a step decreases f by less than this times max(|f|, 1).
    pub decrease_tolerance: f64,
    /// Largest change of a variable in one step.
    pub largest_step: f64,
    /// Curvature assumed before any was measured (the first step is also at most one unit long).
    pub first_curvature: f64,
}

impl Default for MinimiseOptions {
    fn default() -> Self {
        Self {
            max_evaluations: 200,
            max_iterations: 100,
            gradient_tolerance: 1e-5,
            decrease_tolerance: 2.2e-9,
            largest_step: f64::INFINITY,
            first_curvature: 1.0,
        }
    }
}

/// Why a minimisation ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Convergence {
    /// The projected gradient is below its tolerance.
    Gradient,
    /// The last step decreased f by less than its tolerance.
    Decrease,
    /// No step along the descent direction decreases f further: the minimum within rounding.
    Stalled,
    /// Evaluations or iterations were used up; the best point so far is returned.
    Budget,
}

/// The best point found.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// x.
    pub point: DVector<f64>,
    /// f(x).
    pub value: f64,
    /// Evaluations used.
    pub evaluations: usize,
    /// Quasi-Newton steps taken.
    pub iterations: usize,
    /// Why it ended.
    pub convergence: Convergence,
}

/// Why a minimisation could not start.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum MinimiseError {
    /// Start and bounds have different numbers of variables.
    #[error("{start} variables but {lower} lower and {upper} upper bounds")]
    Lengths {
        /// Entries of the start.
        start: usize,
        /// Entries of the lower bound.
        lower: usize,
        /// Entries of the upper bound.
        upper: usize,
    },
    /// The box is empty.
    #[error("variable {variable} has lower bound {lower} above upper bound {upper}")]
    EmptyBox {
        /// Index of the variable.
        variable: usize,
        /// Its lower bound.
        lower: f64,
        /// Its upper bound.
        upper: f64,
    },
    /// The function has no finite value or gradient at the start.
    #[error("the function is {value} at the start, or its gradient is not finite")]
    Start {
        /// Its value.
        value: f64,
    },
}

/// Minimises `objective`, which returns value and gradient, from the point of the box nearest to
/// `start`.
///
/// The search steps back from a value or slope that is not finite. Deterministic: same objective,
/// same bits.
pub fn minimise(
    mut objective: impl FnMut(&DVector<f64>) -> (f64, DVector<f64>),
    start: &DVector<f64>,
    within: &SearchBox,
    options: &MinimiseOptions,
) -> Result<Minimum, MinimiseError> {
    within.check(start.len())?;
    let mut point = within.clamp(start);
    let (mut value, mut gradient) = objective(&point);
    if !(value.is_finite()
        && gradient.len() == point.len()
        && gradient.iter().all(|entry| entry.is_finite()))
    {
        return Err(MinimiseError::Start { value });
    }
    let mut hessian = Hessian::new(&gradient, options.first_curvature);
    let mut evaluations = 1;
    let mut iterations = 0;
    let convergence = loop {
        if within.projected(&point, &gradient).amax() <= options.gradient_tolerance {
            break Convergence::Gradient;
        }
        if evaluations >= options.max_evaluations || iterations >= options.max_iterations {
            break Convergence::Budget;
        }
        let room = within.around(&point, options.largest_step);
        let Some((step, slope)) = hessian.step(&gradient, &room) else {
            if hessian.is_fresh {
                break Convergence::Stalled;
            }
            hessian = Hessian::new(&gradient, options.first_curvature);
            continue;
        };
        iterations += 1;
        let longest = room.longest_along(&step);
        let begin = Trial { step: 0.0, value, slope, point: () };
        let found =
            line_search::search(&begin, 1.0, longest, options.max_evaluations - evaluations, |t| {
                evaluations += 1;
                let there = within.clamp(&(&point + &step * t));
                let (value, gradient) = objective(&there);
                Trial { step: t, value, slope: gradient.dot(&step), point: (there, gradient) }
            });
        let Some(Trial { value: new_value, point: (new_point, new_gradient), .. }) = found else {
            if evaluations >= options.max_evaluations {
                break Convergence::Budget;
            }
            if hessian.is_fresh {
                break Convergence::Stalled;
            }
            hessian = Hessian::new(&gradient, options.first_curvature);
            continue;
        };
        hessian.update(&(&new_point - &point), &(&new_gradient - &gradient));
        let decrease = value - new_value;
        (point, value, gradient) = (new_point, new_value, new_gradient);
        if decrease <= options.decrease_tolerance * value.abs().max(1.0) {
            break Convergence::Decrease;
        }
    };
    Ok(Minimum { point, value, evaluations, iterations, convergence })
}

impl SearchBox {
    fn check(&self, variables: usize) -> Result<(), MinimiseError> {
        if self.lower.len() != variables || self.upper.len() != variables {
            return Err(MinimiseError::Lengths {
                start: variables,
                lower: self.lower.len(),
                upper: self.upper.len(),
            });
        }
        for (variable, (&lower, &upper)) in self.lower.iter().zip(&self.upper).enumerate() {
            if lower.is_nan() || upper.is_nan() || lower > upper {
                return Err(MinimiseError::EmptyBox { variable, lower, upper });
            }
        }
        Ok(())
    }

    fn clamp(&self, point: &DVector<f64>) -> DVector<f64> {
        point.sup(&self.lower).inf(&self.upper)
    }

    /// The gradient without the entries that push against a bound.
    fn projected(&self, point: &DVector<f64>, gradient: &DVector<f64>) -> DVector<f64> {
        point - self.clamp(&(point - gradient))
    }

    /// The steps that stay in this box and are at most `largest` in every variable.
    fn around(&self, point: &DVector<f64>, largest: f64) -> Self {
        let lower = (&self.lower - point).map(|entry| entry.max(-largest));
        let upper = (&self.upper - point).map(|entry| entry.min(largest));
        Self { lower, upper }
    }

    /// Largest t for which t `step` is in this box, which holds `step` itself.
    fn longest_along(&self, step: &DVector<f64>) -> f64 {
        let rooms = step.iter().zip(self.lower.iter().zip(&self.upper)).map(
            |(&along, (&lower, &upper))| {
                if along < 0.0 {
                    lower / along
                } else if along > 0.0 {
                    upper / along
                } else {
                    f64::INFINITY
                }
            },
        );
        rooms.fold(f64::INFINITY, f64::min).max(1.0)
    }
}

/// B, and whether it holds any measured curvature.
struct Hessian {
    matrix: DMatrix<f64>,
    is_fresh: bool,
}

/// Whether a variable of the step is at a bound.
#[derive(Clone, Copy, PartialEq)]
enum Place {
    Free,
    Lower,
    Upper,
}

impl Hessian {
    fn new(gradient: &DVector<f64>, first_curvature: f64) -> Self {
        let curvature = first_curvature.max(gradient.norm());
        Self {
            matrix: DMatrix::identity(gradient.len(), gradient.len()) * curvature,
            is_fresh: true,
        }
    }

    /// B ← B − B s sᵀB / sᵀB s + y yᵀ / yᵀs, unless the function curves downwards along s.
    fn update(&mut self, step: &DVector<f64>, change: &DVector<f64>) {
        let curvature = step.dot(change);
        if curvature <= 1e-10 * step.norm() * change.norm() {
            return;
        }
        if self.is_fresh {
            self.matrix =
                DMatrix::identity(step.len(), step.len()) * (change.norm_squared() / curvature);
            self.is_fresh = false;
        }
        let image = &self.matrix * step;
        let before = step.dot(&image);
        self.matrix +=
            change * change.transpose() / curvature - &image * image.transpose() / before;
    }

    /// argmin gᵀd + ½ dᵀB d within `room`, and gᵀd; `None` if that is no descent.
    fn step(&self, gradient: &DVector<f64>, room: &SearchBox) -> Option<(DVector<f64>, f64)> {
        let variables = gradient.len();
        let mut places: Vec<Place> = (0..variables)
            .map(|i| match gradient[i] {
                slope if slope > 0.0 && room.lower[i] >= 0.0 => Place::Lower,
                slope if slope < 0.0 && room.upper[i] <= 0.0 => Place::Upper,
                _ => Place::Free,
            })
            .collect();
        let mut step = DVector::zeros(variables);
        // Each round decides which bounds are active. It normally takes two or three rounds. The
        // clamp below makes any number of them safe.
        for _ in 0..3 * variables + 3 {
            step = self.step_with(gradient, room, &places)?;
            let multipliers = gradient + &self.matrix * &step;
            let next: Vec<Place> = (0..variables)
                .map(|i| match places[i] {
                    Place::Free if step[i] < room.lower[i] => Place::Lower,
                    Place::Free if step[i] > room.upper[i] => Place::Upper,
                    Place::Lower if multipliers[i] < 0.0 => Place::Free,
                    Place::Upper if multipliers[i] > 0.0 => Place::Free,
                    place => place,
                })
                .collect();
            if next == places {
                break;
            }
            places = next;
        }
        let step = room.clamp(&step);
        let slope = gradient.dot(&step);
        (slope < 0.0).then_some((step, slope))
    }

    /// The minimiser with the variables at a bound fixed: the rows of the others of B d = −g.
    fn step_with(
        &self,
        gradient: &DVector<f64>,
        room: &SearchBox,
        places: &[Place],
    ) -> Option<DVector<f64>> {
        let variables = gradient.len();
        let held = DVector::from_fn(variables, |i, _| match places[i] {
            Place::Free => 0.0,
            Place::Lower => room.lower[i],
            Place::Upper => room.upper[i],
        });
        let pull = -(gradient + &self.matrix * &held);
        let is_free = |i: usize| places[i] == Place::Free;
        let matrix = DMatrix::from_fn(variables, variables, |row, column| {
            match (is_free(row) && is_free(column), row == column) {
                (true, _) => self.matrix[(row, column)],
                (false, true) => 1.0,
                (false, false) => 0.0,
            }
        });
        let pull = DVector::from_fn(variables, |i, _| if is_free(i) { pull[i] } else { held[i] });
        Some(matrix.cholesky()?.solve(&pull))
    }
}

#[cfg(test)]
mod tests;
