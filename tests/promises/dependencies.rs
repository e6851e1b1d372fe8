//! Promise: every dependency comes from crates.io, under a permissive licence. A robot's driver
//! needs few of them.

use promises::{Outcome, repository};
use serde_json::Value;
use std::collections::BTreeSet;
use std::error::Error;
use std::process::Command;

/// Licences that allow any use. MPL-2.0 and CDLA-Permissive-2.0 concern the files of that crate
/// alone.
const PERMISSIVE: [&str; 12] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "CDLA-Permissive-2.0",
    "ISC",
    "MIT",
    "MPL-2.0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Whether an SPDX expression leaves a permissive choice. Cargo also permits `/` for OR.
fn is_permissive(expression: &str) -> bool {
    let expression = expression.replace('/', " OR ").replace(['(', ')'], "");
    expression
        .split(" AND ")
        .all(|needed| needed.split(" OR ").any(|licence| PERMISSIVE.contains(&licence.trim())))
}

fn packages() -> Result<Vec<Value>, Box<dyn Error>> {
    let output = Command::new(env!("CARGO"))
        .current_dir(repository())
        .args(["metadata", "--locked", "--format-version", "1"])
        .output()?;
    let mut metadata: Value = serde_json::from_slice(&output.stdout)?;
    Ok(metadata["packages"].as_array_mut().map(std::mem::take).unwrap_or_default())
}

#[test]
fn every_dependency_is_permissive_and_from_the_public_registry() -> Outcome {
    let packages = packages()?;
    assert!(packages.len() > 100, "{}", packages.len());
    for package in packages {
        let name = package["name"].as_str().unwrap_or_default();
        let licence = package["license"].as_str().unwrap_or_default();
        assert!(is_permissive(licence), "{name}: {licence}");
        let source = package["source"].as_str();
        let is_public = source.is_none_or(|source| source.contains("rust-lang/crates.io-index"));
        assert!(is_public, "{name}: {source:?}");
    }
    Ok(())
}

/// The crates that a crate of ours is built from, itself included.
fn crates_of(package: &str) -> Result<BTreeSet<String>, Box<dyn Error>> {
    let output = Command::new(env!("CARGO"))
        .current_dir(repository())
        .args(["tree", "--locked", "-p", package, "-e", "normal", "--prefix", "none"])
        .output()?;
    let tree = String::from_utf8(output.stdout)?;
    Ok(tree.lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect())
}

#[test]
fn gate_and_driver_need_at_most_sixty_crates_beside_iceoryx2() -> Outcome {
    let (driver, gate, iceoryx2) =
        (crates_of("driver")?, crates_of("gate")?, crates_of("iceoryx2")?);
    assert!(iceoryx2.len() > 10 && driver.is_superset(&gate), "{iceoryx2:?}");
    let own: Vec<&String> = driver.difference(&iceoryx2).collect();
    assert!(own.len() <= 60, "{} crates: {own:?}", own.len());
    Ok(())
}

#[test]
fn a_licence_with_duties_for_our_own_code_is_noticed() {
    for bad in ["GPL-3.0-only", "MIT AND GPL-2.0", "EPL-2.0", "", "AGPL-3.0 OR SSPL-1.0"] {
        assert!(!is_permissive(bad), "{bad}");
    }
    for good in ["EPL-2.0 OR Apache-2.0", "MIT/Apache-2.0", "(MIT OR GPL-2.0) AND Unicode-3.0"] {
        assert!(is_permissive(good), "{good}");
    }
}
