//! Measures the round trip of a command, and of a snapshot of 416 kB, between two threads over
//! every carrier. Each figure stands beside that of the bare library with as many bytes.
//!
//! The machine's state moves all figures; only their ratio in one run counts.

#[path = "round_trip/bare.rs"]
mod bare;
#[path = "round_trip/ends.rs"]
mod ends;

use bytemuck::Zeroable;
use criterion::Criterion;
use protocol::message::{Command, Message, ModelSnapshot, SnapshotHead};
use protocol::topic::{OnTopic, Topic};
use std::error::Error;
use std::path::Path;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;
use transport::{Exchange, Identity, Links, Ports, Since, Sink, Source, sweep};

type Failure = Box<dyn Error + Send + Sync>;

/// Longer than any round takes.
const LONG: Duration = Duration::from_secs(10);

/// Ends the echo.
const LAST: u64 = u64::MAX;

/// Data points of 6 inputs: a snapshot of 416 kB.
const POINTS: u32 = 4_000;

fn main() -> Result<(), Failure> {
    let folder = tempfile::tempdir()?;
    let mut criterion = Criterion::default().configure_from_args();
    let memory = [Exchange::new(false, LONG), Exchange::new(false, LONG)];
    measure_both(&mut criterion, "memory", |end| {
        Ok(Ports::in_memory(&memory[end], Identity::new(1)))
    })?;

    let shared = ["there", "back"].map(|name| links(folder.path(), name));
    measure_both(&mut criterion, "shared memory", |end| {
        Ok(Ports::open(&shared[end], Identity::new(1))?)
    })?;
    for links in &shared {
        sweep(links)?;
    }
    let words = |bytes: usize| bytes.div_ceil(size_of::<u64>());
    bare::measure(
        &mut criterion,
        folder.path(),
        "command",
        words(Command::zeroed().byte_len()),
        Topic::Command.quality(false).depth,
    )?;
    bare::measure(
        &mut criterion,
        folder.path(),
        "snapshot",
        words(snapshot()?.byte_len()),
        Topic::Snapshot.quality(false).depth,
    )?;
    criterion.final_summary();
    Ok(())
}

fn snapshot() -> Result<ModelSnapshot, Failure> {
    let mut snapshot = ModelSnapshot::new(SnapshotHead { inputs: 6, ..SnapshotHead::zeroed() });
    for point in 0..POINTS {
        snapshot.push(&[f64::from(point); 6], [0.5; 3], [0.25; 3])?;
    }
    Ok(snapshot)
}

/// Measures both messages; `ports` opens those of graph 0, there, and 1, back.
fn measure_both(
    criterion: &mut Criterion,
    name: &str,
    ports: impl Fn(usize) -> Result<Ports, Failure> + Sync,
) -> Result<(), Failure> {
    measure(criterion, &format!("round trip/{name}, command"), &ports, Command::zeroed())?;
    measure(criterion, &format!("round trip/{name}, snapshot"), &ports, snapshot()?)
}

fn measure<T: OnTopic>(
    criterion: &mut Criterion,
    name: &str,
    ports: &(impl Fn(usize) -> Result<Ports, Failure> + Sync),
    mut message: T,
) -> Result<(), Failure> {
    thread::scope(|scope| -> Result<(), Failure> {
        let (ready, is_ready) = mpsc::channel();
        let echo = scope.spawn(move || -> Result<(), Failure> {
            let (mut source, mut sink) =
                (ports(0)?.source::<T>(Since::First)?, ports(1)?.sink::<T>()?);
            ready.send(())?;
            loop {
                let mut message = received(&mut source)?;
                let last = message.stamp().tick == LAST;
                sink.send(&mut message)?;
                if last {
                    return Ok(());
                }
            }
        });
        let (mut source, mut sink): (Source<T>, Sink<T>) =
            (ports(1)?.source(Since::First)?, ports(0)?.sink()?);
        is_ready.recv()?;
        let mut failure = None;
        criterion.bench_function(name, |bencher| {
            bencher.iter(|| {
                message.stamp_mut().tick += 1;
                let answer = sink
                    .send(&mut message)
                    .map_err(Failure::from)
                    .and_then(|()| received(&mut source));
                match answer {
                    Ok(answer) if answer.stamp().tick == message.stamp().tick => {}
                    Ok(_) => failure = Some("another message came back".into()),
                    Err(error) => failure = Some(error),
                }
            });
        });
        message.stamp_mut().tick = LAST;
        sink.send(&mut message)?;
        received(&mut source)?;
        echo.join().map_err(|_| "the echo panicked")??;
        failure.map_or(Ok(()), Err)
    })
}

fn received<T: OnTopic>(source: &mut Source<T>) -> Result<T, Failure> {
    while source.wait(LONG)? {
        if let Some(message) = source.latest()? {
            return Ok(message);
        }
    }
    Err(format!("no {} came", T::NAME).into())
}

fn links(folder: &Path, name: &str) -> Links {
    Links::on_this_machine(
        format!("b{}-{name}", std::process::id()),
        folder.join(name),
        false,
        1000,
    )
}
