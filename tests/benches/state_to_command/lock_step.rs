//! Lock step over two hosts, with nothing to compute: a state, and the command that answers it.

use super::{Failure, LONG, TWO_HOSTS, launch};
use bytemuck::Zeroable;
use process::read_settings;
use protocol::message::{Command, PlantState};
use std::path::Path;
use std::process::Stdio;
use std::time::Instant;
use transport::{Identity, Links, Ports, Since, Sink, Source};

/// Number of ticks.
const TICKS: u64 = 100_000;

/// Ticks per second. Fails if a message is lost.
pub(super) fn ticks_per_s() -> Result<f64, Failure> {
    let (launched, links) = launch(TWO_HOSTS, true).map_err(|error| error.to_string())?;
    let settings = launched.folder().join("control/settings/bridge.toml");
    let mut controller = std::process::Command::new(std::env::current_exe()?)
        .arg("--controller")
        .arg(&settings)
        .stdin(Stdio::piped())
        .spawn()?;
    let ports = Ports::open(&links, Identity::new(1))?;
    let (mut states, mut commands): (Sink<PlantState>, Source<Command>) =
        (ports.sink()?, ports.source(Since::First)?);
    let mut state = PlantState::zeroed();
    let mut begin = Instant::now();
    for tick in 0..=TICKS {
        state.stamp.tick = tick;
        states.send(&mut state)?;
        if !commands.wait(LONG)? || commands.next()?.is_none_or(|one| one.stamp.tick != tick) {
            return Err(format!("no command answers the state of tick {tick}").into());
        }
        if tick == 0 {
            begin = Instant::now();
        }
    }
    let per_s = TICKS as f64 / begin.elapsed().as_secs_f64();
    // It ends with its input.
    drop(controller.stdin.take());
    controller.wait()?;
    if commands.tally().lost > 0 {
        return Err(format!("{:?}", commands.tally()).into());
    }
    Ok(per_s)
}

/// The controller's process: answers each state.
pub(super) fn answer(settings: &Path) -> Result<(), Failure> {
    let links: Links = read_settings::<bridge::settings::Settings>(settings)?.run.links;
    let ports = Ports::open(&links, Identity::new(1))?;
    let (mut commands, mut states): (Sink<Command>, Source<PlantState>) =
        (ports.sink()?, ports.source(Since::First)?);
    let ended = std::thread::spawn(|| std::io::copy(&mut std::io::stdin(), &mut std::io::sink()));
    while !ended.is_finished() {
        states.wait(super::APART)?;
        while let Some(state) = states.next()? {
            let mut command = Command::zeroed();
            command.stamp.tick = state.stamp.tick;
            commands.send(&mut command)?;
        }
        commands.refresh()?;
    }
    Ok(())
}
