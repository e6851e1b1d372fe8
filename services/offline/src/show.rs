//! `coxswain model show`: what a snapshot has learned, as a table and as a page.

use crate::command::{offline_run, read_graph};
use crate::page::Page;
use crate::slices::Slices;
use clap::Args;
use controller::adopt::{self, Refusal};
use controller::control::Controller;
use graph::first_model;
use identify::log::AXIS_NAMES;
use process::atomic_file;
use robot::AXES;
use settings::SettingsError;
use std::io;
use std::path::PathBuf;

/// Units of the velocity axes.
pub(crate) const UNITS: [&str; AXES] = ["m/s", "m/s", "rad/s"];

/// A snapshot, and the graph that it belongs to.
#[derive(Debug, Clone, Args)]
pub struct ShowOptions {
    /// The snapshot: snapshot.bin of a run directory, or a file of `coxswain learn`.
    #[arg(value_name = "FILE")]
    pub snapshot: PathBuf,
    /// Graph file whose robot, period and input layout it was learned for.
    #[arg(long, value_name = "FILE", default_value = "deploy/graphs/local.toml")]
    pub graph: PathBuf,
    /// Another scenario: a file, or the name of one beside the graph's own.
    #[arg(long, value_name = "FILE|NAME")]
    pub scenario: Option<PathBuf>,
    /// Another robot file.
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// Write a page with slices through the model.
    #[arg(long, value_name = "PAGE.html")]
    pub to: Option<PathBuf>,
}

/// Why a snapshot is not shown.
#[derive(Debug, thiserror::Error)]
pub enum ShowError {
    /// A file cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The controller would refuse the snapshot.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The page cannot be written.
    #[error("{} cannot be written: {source}", path.display())]
    Write {
        /// The page.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
}

impl ShowError {
    /// 1 if the system reports a write error, else 2.
    pub fn exit_code(&self) -> u8 {
        if matches!(self, Self::Write { .. }) { 1 } else { 2 }
    }
}

/// Prints what the snapshot of `options` has learned, and writes the page if one is wanted.
///
/// # Errors
/// [`ShowError`]; no file was written then.
pub fn show(options: &ShowOptions) -> Result<(), ShowError> {
    let assembly =
        read_graph(&options.graph, options.scenario.as_deref(), options.robot.as_deref())?;
    let snapshot = first_model::read(&options.snapshot, &assembly)?;
    let expected = Controller::expected(&assembly.controller(offline_run(&assembly)));
    let mut model = adopt::prepare(&snapshot, &expected)?;
    let facts = facts(&snapshot.head, expected.layout.name());
    for line in &facts {
        terminal::print(line);
    }
    if let Some(path) = &options.to {
        let slices = Slices::new(&snapshot, expected.layout, &mut model);
        let name = options.snapshot.display().to_string();
        let page = Page { name: &name, facts: &facts, slices: &slices };
        atomic_file::write(path, page.html().as_bytes())
            .map_err(|source| ShowError::Write { path: path.clone(), source })?;
        terminal::print(path.display());
    }
    Ok(())
}

/// Kernel, hyperparameters with units, and scores, one line each.
fn facts(head: &protocol::message::SnapshotHead, layout: &str) -> Vec<String> {
    let has = |variances: &[f64]| variances.iter().any(|variance| *variance > 0.0);
    let kernel = match (has(&head.linear_variance), has(&head.place_variance)) {
        (true, true) => "linear + squared exponential + place",
        (true, false) => "linear + squared exponential",
        _ => "squared exponential",
    };
    let mut facts = vec![
        format!("version {}, fingerprint {:#018x}", head.version, head.fingerprint),
        format!("{} points over {} inputs ({layout}), kernel {kernel}", head.points, head.inputs),
    ];
    let inputs = head.inputs as usize;
    for axis in 0..AXES {
        let scales = head.length_scale[axis].iter().zip(&head.input_scale).take(inputs);
        let lengths: Vec<String> =
            scales.map(|(length, scale)| format!("{:.2}", length * scale)).collect();
        facts.push(format!(
            "{:8} σ {:.4}, λ {:.4}, π {:.4}, σₙ {:.4}, of a new sample {:.4} {}; length scales {}",
            AXIS_NAMES[axis],
            head.signal_variance[axis].sqrt(),
            head.linear_variance[axis].sqrt(),
            head.place_variance[axis].sqrt(),
            head.noise_variance[axis].sqrt(),
            head.sample_variance[axis].sqrt(),
            UNITS[axis],
            lengths.join(" ")
        ));
        if head.score_samples > 0 {
            facts.push(format!(
                "{:8} error {:.4} {}, of the main model {:.4} (1 step, RMS of {} held-out samples)",
                AXIS_NAMES[axis],
                head.score_learned[axis],
                UNITS[axis],
                head.score_main[axis],
                head.score_samples
            ));
        }
    }
    facts
}
