//! A run → what the operator reads of it, before and after.

use crate::closing::Closing;
use crate::fleet::RunContext;
use graph::assembly::Assembly;
use process::Pace;
use protocol::message::Participant;
use recorder::report;
use std::slice;
use terminal::Terminal;

/// The run, its scenario and its faults, before anything starts.
pub(super) fn heading(assembly: &Assembly) -> String {
    let pace = if assembly.graph.pace == Pace::LockStep { "lock step" } else { "real time" };
    let learner = if assembly.learns() { "on" } else { "off" };
    let Assembly { graph, scenario, scenario_name, .. } = assembly;
    let heading = format!(
        "{}: {scenario_name}, {:.1} s in {pace}, learner {learner}\n{}",
        graph.name, scenario.duration_s, scenario.description
    );
    #[cfg(feature = "faults")]
    if let count @ 1.. = assembly.faults.count() {
        let seed = assembly.faults.seed;
        return format!("{heading}\nFAULTS ARE INJECTED: {count} of them, seed {seed}");
    }
    heading
}

/// Access without certificates: peers are not authenticated, but only processes on this machine can
/// connect.
pub(super) fn within_reach(assembly: &Assembly) -> Option<&'static str> {
    if assembly.host.is_some() {
        Some("network: this machine alone (no certificates); each of its users can drive the robot")
    } else if assembly.roles().any(|role| role == Participant::Gateway) {
        Some("network: this machine alone (no certificates); each of its users can watch the robot")
    } else {
        None
    }
}

/// Prints how the run can be watched, if it can.
pub(super) fn invite(context: &RunContext, terminal: &mut Terminal) {
    if let Some(address) = gateway::addresses::page(&context.links.root) {
        terminal.say(format_args!("live page: http://{address}/"));
    }
    for endpoint in gateway::addresses::endpoints(&context.links.root) {
        let shown = context
            .assembly
            .certificates
            .as_ref()
            .map(|of| format!(" --certificates {}", of.folder().display()));
        terminal.say(format_args!(
            "watch with: coxswain watch {endpoint}{}",
            shown.unwrap_or_default()
        ));
    }
}

/// Prints the results of the run, and where its files are.
pub(super) fn conclude(context: &RunContext, terminal: &mut Terminal) {
    // Ends the live line.
    terminal.say(format_args!("record: {}", context.folder.display()));
    if !context.assembly.graph.processes.recorder.enabled {
        return;
    }
    match Closing::read(&context.folder) {
        Ok(closing) => terminal::print(closing),
        Err(error) => terminal.say(format_args!("there is no summary: {error}")),
    }
    let page = report::beside(&context.folder);
    match report::write(slice::from_ref(&context.folder), &page) {
        Ok(()) => terminal.say(format_args!("report: {}", page.display())),
        Err(error) => terminal.say(format_args!("there is no report: {error}")),
    }
}
