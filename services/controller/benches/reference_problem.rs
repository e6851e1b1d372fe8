//! The problem that peers are measured on, over points of data and horizons: one JSON line each.
//!
//! `taskset -c 1 cargo bench -p controller --bench reference_problem` measures all of them. `M N`
//! after `--` selects one of them alone. `measured` linearises the prediction about the measured
//! state, which is the controller's default.
#![expect(clippy::print_stdout, reason = "figures are what a bench is for")]

#[path = "../tests/reference_problem/closed_loop.rs"]
mod closed_loop;
#[path = "../tests/reference_problem/problem.rs"]
mod problem;

use controller::settings::Linearise;
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let measured = std::env::args().any(|argument| argument == "measured");
    let linearise = if measured { Linearise::Measured } else { Linearise::Expected };
    let asked: Vec<usize> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    if let [points, horizon] = asked.as_slice() {
        return measure(*points, *horizon, linearise);
    }
    for points in [0, 50, 100, 200, 500] {
        for horizon in [5, 10, 20] {
            measure(points, horizon, linearise)?;
        }
    }
    Ok(())
}

fn measure(points: usize, horizon: usize, linearise: Linearise) -> Result<(), Box<dyn Error>> {
    println!("{}", serde_json::to_string(&closed_loop::drive(points, horizon, linearise)?)?);
    Ok(())
}
