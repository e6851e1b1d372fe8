//! Streams obstacles to the launch on this machine, ten lists per second:
//! `cargo run -p coxswain --example obstacles -- FILE [SECONDS]`, with a list as JSON.

use coxswain::obstacles::ObstacleLists;
use driver::PlannerList;
use runs::registry;
use std::error::Error;
use std::io::{self, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use std::{env, fs, thread};

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let (file, seconds) = match arguments.as_slice() {
        [file] => (file, f64::INFINITY),
        [file, seconds] => (file, seconds.parse()?),
        _ => {
            writeln!(io::stderr(), "obstacles: expected FILE [SECONDS]")?;
            return Ok(ExitCode::from(2));
        }
    };
    let text = fs::read_to_string(file).map_err(|error| format!("{file}: {error}"))?;
    let mut list: PlannerList =
        serde_json::from_str(&text).map_err(|error| format!("{file}: {error}"))?;
    let mut lists = ObstacleLists::on_this_machine(None, &registry::base())?;
    let (begin, pause) = (Instant::now(), Duration::from_millis(100));
    while begin.elapsed().as_secs_f64() < seconds {
        lists.send(&list)?;
        thread::sleep(pause);
        for obstacle in &mut list.obstacles {
            let by = obstacle.velocity_mps.map(|velocity| velocity * pause.as_secs_f64());
            obstacle.corners_m.iter_mut().for_each(|[x, y]| (*x, *y) = (*x + by[0], *y + by[1]));
        }
    }
    Ok(ExitCode::SUCCESS)
}
