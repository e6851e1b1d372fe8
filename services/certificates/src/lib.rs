//! `coxswain certificates`: a private authority, and from it one short-lived certificate per host,
//! and for drivers and watchers.
//!
//! | module      | contents                                                              |
//! |-------------|-----------------------------------------------------------------------|
//! | `issue`     | the authority and the certificates that it signs, as files            |

pub mod issue;

use clap::Args;
use issue::{IssueError, Order, issue};
use runs::utc::{unix_s, utc_of_unix_s};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use transport::is_graph_name;

/// Hosts of a graph if no others are named.
const HOSTS: [&str; 2] = ["robot", "control"];

/// A day \[s\].
const DAY_S: i64 = 86_400;

/// Largest delay of another machine's clock \[s\].
const CLOCK_SKEW_S: i64 = 300;

/// Longest time that a certificate may be valid \[days\].
const DAYS_MAX: i64 = 398;

/// The certificates to create.
#[derive(Debug, Clone, Args)]
pub struct CertificatesOptions {
    /// Name of the robot in the certificates: 1 to 32 characters out of a-z, 0-9, _ and -.
    #[arg(long, value_name = "NAME")]
    pub robot: String,
    /// New folder for the certificates, with one folder in it per role.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Folder of the authority, created if it does not exist; by default the name of the --out
    /// folder and `-authority`. Keep it off the robot.
    #[arg(long, value_name = "DIR")]
    pub authority: Option<PathBuf>,
    /// A host of the graph file and, if others connect to it, a name or address at which it is
    /// reachable in addition to the loopback's, such as robot=10.0.0.1; may be given several times,
    /// also for one host. By default the hosts robot and control.
    #[arg(long = "host", value_name = "NAME[=ADDRESS]", value_parser = host)]
    pub hosts: Vec<(String, Option<String>)>,
    /// Number of days for which they are valid.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 30,
        value_parser = clap::value_parser!(i64).range(1..=DAYS_MAX)
    )]
    pub days: i64,
}

/// Creates the certificates of `options`, and prints the result.
///
/// # Errors
/// [`IssueError`]. No incomplete directory is left.
pub fn run(options: &CertificatesOptions) -> Result<(), IssueError> {
    let now_s = unix_s(SystemTime::now());
    let authority = options.authority.clone().unwrap_or_else(|| beside(&options.out));
    let (from_s, until_s) = (now_s - CLOCK_SKEW_S, now_s + options.days * DAY_S);
    let mut hosts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (name, address) in &options.hosts {
        hosts.entry(name.clone()).or_default().extend(address.clone());
    }
    if hosts.is_empty() {
        hosts = HOSTS.map(|name| (name.to_owned(), Vec::new())).into();
    }
    let order = Order { robot: options.robot.clone(), hosts, from_s, until_s };
    let made = issue(&authority, &options.out, &order)?;
    let whose = if made.new_authority { "new authority" } else { "authority" };
    terminal::print(format_args!(
        "{whose} {}: keep it off the robot; anyone with its key can make certificates",
        authority.display()
    ));
    terminal::print(format_args!(
        "certificates of robot {}, valid until {}:",
        options.robot,
        utc_of_unix_s(until_s)
    ));
    for (role, addresses) in &made.certificates {
        let folder = options.out.join(role.to_string());
        let where_to = if addresses.is_empty() {
            String::new()
        } else {
            format!("  at {}", addresses.join(", "))
        };
        terminal::print(format_args!("  {:<13} {}{where_to}", role.to_string(), folder.display()));
    }
    terminal::print("copy each folder to the machine that its name tells");
    Ok(())
}

fn host(text: &str) -> Result<(String, Option<String>), String> {
    let (name, address) = match text.split_once('=') {
        Some((name, address)) => (name, Some(address.to_owned())),
        None => (text, None),
    };
    if is_graph_name(name) {
        Ok((name.to_owned(), address))
    } else {
        Err("expected a host of 1 to 32 characters out of a-z, 0-9, _ and -".to_owned())
    }
}

/// The folder's name and `-authority`.
fn beside(out: &Path) -> PathBuf {
    let name = out
        .file_name()
        .map_or_else(|| "certificates".into(), |name| name.to_string_lossy().into_owned());
    out.with_file_name(format!("{name}-authority"))
}
