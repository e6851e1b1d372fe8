//! Requests of browsers to the live page, requests of a person to a driving controller, lists of
//! planners, the file that names a graph's launcher, and certificates.

use super::{Fate, Verdict, corpus, promise, refused};
use access::{Certificate, valid_until};
use controller::control::tuning::RULES;
use driver::PlannerList;
use process::requests::{Inbox, NotAsked, welcome};
use process::{Pace, read_settings};
use protocol::message::Participant;
use runs::registry;
use settings::change::{Change, changed};
use std::fs;
use std::net::{IpAddr, Ipv4Addr};

/// A request gets the page, its events or the stop button, or a status with the reason: never a
/// status of success. Another site gets none of them.
pub(super) fn request(bytes: &[u8]) -> Verdict {
    let listening = IpAddr::V4(Ipv4Addr::LOCALHOST);
    match gateway::page::asked(bytes, listening) {
        Ok(what) => {
            // Empty lines before a request are allowed.
            let begin: &[u8] = if what == "stop" { b"POST /stop" } else { b"GET /" };
            let method = bytes.trim_ascii_start().starts_with(begin);
            promise(method, || format!("{what} for what?"))?;
            Ok(Fate::Used)
        }
        Err(status) => {
            promise(status.starts_with(['4', '5']), || format!("refused with {status}"))?;
            refused(status)
        }
    }
}

/// A launcher file names a launcher that lives, whose graph is left alone, or one that does not,
/// whose graph is swept. Any other file is left alone.
pub(super) fn launcher(bytes: &[u8]) -> Verdict {
    let failed = |error| format!("no folder: {error}");
    let base = tempfile::tempdir().map_err(failed)?;
    let file = base.path().join("00000000.toml");
    fs::write(&file, bytes).map_err(failed)?;
    let living = registry::living(base.path()).len();
    let (swept, complaints) = registry::sweep_stale(base.path());
    promise(complaints.is_empty(), || complaints.join("; "))?;
    promise(living + swept <= 1, || {
        format!("one file, {living} living and {swept} dead launchers")
    })?;
    promise(file.exists() == (swept == 0), || {
        "a graph was swept by halves, or for no reason".into()
    })?;
    Ok(if living + swept > 0 { Fate::Used } else { Fate::Refused })
}

/// Settings of a controller that drives in real time.
fn told() -> Result<controller::Settings, String> {
    let file = corpus().join("controller_settings/real-time.toml");
    let mut settings: controller::Settings =
        read_settings(&file).map_err(|error| error.to_string())?;
    settings.run.pace = Pace::RealTime;
    Ok(settings)
}

/// A change is refused with a reason, or gives valid settings that differ in no fixed setting.
pub(super) fn change(bytes: &[u8]) -> Verdict {
    let Ok(lines) = std::str::from_utf8(bytes) else { return refused("not UTF-8") };
    let before = told()?;
    match Change::parse(lines).and_then(|change| changed(&before, &[change], &RULES)) {
        Err(error) => refused(&error.to_string()),
        Ok(after) => {
            promise(after.robot == before.robot && after.duration_s == before.duration_s, || {
                "what is fixed was changed".into()
            })?;
            Ok(Fate::Used)
        }
    }
}

/// A file that is not a request is read all the same, so that it is answered; its content is a
/// change or not.
pub(super) fn set_request(bytes: &[u8]) -> Verdict {
    let failed = |error| format!("no folder: {error}");
    let folder = tempfile::tempdir().map_err(failed)?;
    welcome(folder.path()).map_err(failed)?;
    fs::write(folder.path().join("set/controller-000001.json"), bytes).map_err(failed)?;
    let mut run = told()?.run;
    folder.path().clone_into(&mut run.folder);
    match Inbox::open(&run, Participant::Controller).take() {
        None => Err("a file was passed over".into()),
        Some(Err(NotAsked::LockStep)) => Err("this is real time".into()),
        Some(Err(error)) => refused(&error.to_string()),
        Some(Ok(request)) => change(request.change.as_bytes()),
    }
}

/// A list of a planner is refused with its error, or becomes a message of finite numbers.
pub(super) fn planner_list(bytes: &[u8]) -> Verdict {
    let list: PlannerList = match serde_json::from_slice(bytes) {
        Ok(list) => list,
        Err(error) => return refused(&error.to_string()),
    };
    match list.message() {
        Err(error) => refused(&error.to_string()),
        Ok(message) => {
            let rows = message.rows();
            promise(rows.len() == list.obstacles.len(), || format!("{} obstacles", rows.len()))?;
            promise(rows.iter().flatten().all(|value| value.is_finite()), || "not finite".into())?;
            Ok(Fate::Used)
        }
    }
}

/// A certificate is refused with a sentence, or names role and robot, and all readers find the same
/// end of its validity.
pub(super) fn certificate(bytes: &[u8]) -> Verdict {
    let until = valid_until(bytes);
    match Certificate::parse(bytes) {
        Ok(certificate) => {
            promise(until == Ok(certificate.until_s), || {
                format!("valid until {}, or until {until:?}?", certificate.until_s)
            })?;
            Ok(Fate::Used)
        }
        Err(why) => refused(&why),
    }
}
