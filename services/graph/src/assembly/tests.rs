use super::read::{from, scenario_of};
use super::*;
use crate::options::Options;
use settings::SettingsError;

#[test]
fn the_robot_of_the_examples_is_the_one_of_the_repository() -> Result<(), SettingsError> {
    let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/graphs/local.toml");
    assert_eq!(Assembly::read(&Options::of_graph(&graph))?.robot, Robot::example());
    Ok(())
}

#[test]
fn the_example_of_faults_can_be_used() -> Result<(), SettingsError> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/faults/example.toml");
    let faults = faults_of(&file, Pace::RealTime)?;
    assert_eq!((faults.fault.len(), faults.process.len(), faults.solver.len()), (3, 2, 1));
    assert_eq!((faults.snapshot.len(), faults.plant.len()), (1, 2));
    Ok(())
}

#[test]
fn a_scenario_is_selected_by_file_or_by_name_with_variants() -> Result<(), SettingsError> {
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenarios/paper.toml");
    let name = |asked: Option<&Path>| scenario_of(asked, &own).map(|(_, name)| name);
    assert_eq!(name(None)?, "paper");
    assert_eq!(name(Some(Path::new("circle")))?, "circle");
    assert_eq!(name(Some(&own.with_file_name("square.toml")))?, "square");
    assert_eq!(name(Some(Path::new("figure-eight+payload")))?, "figure-eight+payload");
    let refused = [
        name(Some(Path::new("my/circle"))),
        name(Some(Path::new("circle.toml"))),
        name(Some(Path::new("ellipse"))),
    ];
    assert!(refused.iter().all(Result::is_err), "{refused:?}");
    Ok(())
}

#[test]
fn a_path_in_a_graph_file_is_shortened() {
    let short = |file, path| from(Path::new(file), Path::new(path));
    assert_eq!(
        short("deploy/graphs/g.toml", "../robots/r.toml"),
        Path::new("deploy/robots/r.toml")
    );
    assert_eq!(short("g.toml", "../r.toml"), Path::new("../r.toml"));
    assert_eq!(short("g.toml", "/etc/r.toml"), Path::new("/etc/r.toml"));
}

#[test]
fn the_driver_is_a_program_beside_ours_or_a_path_from_the_graph_file()
-> Result<(), Box<dyn std::error::Error>> {
    let deploy = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy");
    let text = std::fs::read_to_string(deploy.join("graphs/serial-base.toml"))?;
    let text = text.replace("\"../", &format!("\"{}/", deploy.display()));
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("graph.toml");
    for (program, expected) in [
        ("serial-base", PathBuf::from("serial-base")),
        ("programs/mine", folder.path().join("programs/mine")),
        ("/usr/bin/mine", PathBuf::from("/usr/bin/mine")),
    ] {
        let text = text.replace("program = \"serial-base\"", &format!("program = {program:?}"));
        std::fs::write(&file, text)?;
        let assembly = Assembly::read(&Options::of_graph(&file))?;
        assert_eq!(assembly.program(Participant::Plant), expected);
        assert_eq!(assembly.program(Participant::Recorder), Path::new("recorder"));
    }
    Ok(())
}

#[test]
fn a_missing_binary_is_named_in_the_error() -> std::io::Result<()> {
    let folder = tempfile::tempdir()?;
    std::fs::write(folder.path().join("recorder"), "")?;
    let programs = ["recorder", "plant-sim"].map(Path::new);
    let missing = missing_programs(programs.into_iter(), folder.path());
    assert_eq!(missing, ["plant-sim"]);
    Ok(())
}
