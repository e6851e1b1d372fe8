//! A trajectory from a file of points: `cargo run -p controller --example custom_reference FILE`.
//!
//! The columns are `time_s,x_m,y_m,yaw_rad`. Prints pose and velocity of the reference at each
//! second.

use controller::reference::{Reference, ReferenceSettings};
use std::env;
use std::error::Error;
use std::io::{self, Write};
use std::process::ExitCode;

const PERIOD_S: f64 = 0.02;
const SECONDS: usize = 10;

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let Some(file) = env::args().nth(1) else {
        writeln!(io::stderr(), "custom_reference: expected a file of points")?;
        return Ok(ExitCode::from(2));
    };
    let file = toml::Value::String(file);
    let settings: ReferenceSettings =
        toml::from_str(&format!("path = {{ points = {{ file = {file} }} }}\nheading = \"given\""))?;
    let ticks = (SECONDS as f64 / PERIOD_S) as usize;
    let reference = Reference::new(&settings, &[0.0; 3], PERIOD_S, ticks)?;
    for second in 0..SECONDS {
        let point = reference.at((second as f64 / PERIOD_S) as u64);
        let ([x, y, yaw], [forward, left, rate]) = (point.pose, point.velocity);
        write!(io::stdout(), "t {second} x {x:.3} y {y:.3} yaw {yaw:.3} ")?;
        writeln!(io::stdout(), "forward {forward:.3} left {left:.3} rate {rate:.3}")?;
    }
    Ok(ExitCode::SUCCESS)
}
