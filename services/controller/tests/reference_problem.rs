//! The problem that peers are measured on: the same data, and the same answers.

#[path = "reference_problem/closed_loop.rs"]
mod closed_loop;
#[path = "reference_problem/problem.rs"]
mod problem;

use std::error::Error;

#[test]
fn the_closed_loop_is_that_of_three_independent_peers() -> Result<(), Box<dyn Error>> {
    let figures = closed_loop::drive(100, 10)?;
    assert!((figures.rms_pos_err - 0.35788).abs() < 2e-4 && (figures.usum - 1091.717).abs() < 0.2, "{figures:?}");
    Ok(())
}
