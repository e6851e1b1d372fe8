//! A command there and back between two threads over shared memory, event-driven: beside iceoryx2 alone with as many bytes.
//!
//! The machine's state moves both figures; what counts is their ratio in one run.

#[path = "round_trip/bare.rs"]
mod bare;

use bytemuck::Zeroable;
use criterion::Criterion;
use protocol::message::Command;
use protocol::port::{Identity, Links, Ports, Since, Sink, Source, sweep};
use std::error::Error;
use std::path::Path;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

type Failure = Box<dyn Error + Send + Sync>;

/// Longer than any round takes.
const LONG: Duration = Duration::from_secs(10);

/// Ends the echo.
const LAST: u64 = u64::MAX;

fn main() -> Result<(), Failure> {
    let folder = tempfile::tempdir()?;
    let mut criterion = Criterion::default().configure_from_args();
    measure_links(&mut criterion, folder.path())?;
    bare::measure(&mut criterion, folder.path())?;
    criterion.final_summary();
    Ok(())
}

fn measure_links(criterion: &mut Criterion, folder: &Path) -> Result<(), Failure> {
    let (there, back) = (links(folder, "there"), links(folder, "back"));
    thread::scope(|scope| -> Result<(), Failure> {
        let (ready, is_ready) = mpsc::channel();
        let (from, to) = (&there, &back);
        let echo = scope.spawn(move || -> Result<(), Failure> {
            let (mut source, mut sink) = ends(from, to)?;
            ready.send(())?;
            loop {
                let mut command = heard(&mut source)?;
                let last = command.stamp.tick == LAST;
                sink.send(&mut command)?;
                if last {
                    return Ok(());
                }
            }
        });
        let (mut source, mut sink) = ends(&back, &there)?;
        is_ready.recv()?;
        let mut command = Command::zeroed();
        let mut failure = None;
        criterion.bench_function("round trip/links", |bencher| {
            bencher.iter(|| {
                command.stamp.tick += 1;
                let answer = sink.send(&mut command).map_err(Failure::from).and_then(|()| heard(&mut source));
                match answer {
                    Ok(answer) if answer.stamp.tick == command.stamp.tick => {}
                    Ok(_) => failure = Some("another command came back".into()),
                    Err(error) => failure = Some(error),
                }
            });
        });
        command.stamp.tick = LAST;
        sink.send(&mut command)?;
        heard(&mut source)?;
        echo.join().map_err(|_| "the echo panicked")??;
        failure.map_or(Ok(()), Err)
    })?;
    sweep(&there)?;
    sweep(&back)?;
    Ok(())
}

fn ends(from: &Links, to: &Links) -> Result<(Source<Command>, Sink<Command>), Failure> {
    let source = Ports::open(from, Identity::new(1))?.source(Since::First)?;
    let sink = Ports::open(to, Identity::new(1))?.sink()?;
    Ok((source, sink))
}

fn heard(source: &mut Source<Command>) -> Result<Command, Failure> {
    if !source.wait(LONG)? {
        return Err("no command came".into());
    }
    Ok(source.latest()?.ok_or("woken for nothing")?)
}

fn links(folder: &Path, name: &str) -> Links {
    Links::on_this_machine(format!("b{}-{name}", std::process::id()), folder.join(name), false, 1000)
}
