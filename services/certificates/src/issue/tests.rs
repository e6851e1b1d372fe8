use super::authority::AUTHORITY_VALID_S;
use super::*;
use access::{AccessError, Changeable, Credentials};
use std::error::Error;
use std::os::unix::fs::MetadataExt;

fn order() -> Order {
    Order {
        robot: "mecanum".into(),
        hosts: [
            ("robot".to_owned(), vec!["10.0.0.1".into(), "robot.example".into()]),
            ("control".to_owned(), Vec::new()),
        ]
        .into(),
        from_s: 1_000,
        until_s: 2_000,
    }
}

#[test]
fn every_role_gets_a_certificate_with_role_addresses_and_expiry() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let (authority, out) = (folder.path().join("a"), folder.path().join("deep/out"));
    assert!(issue(&authority, &out, &order())?.new_authority);
    let host = |name: &str| Role::Host(name.to_owned());
    for role in CLIENTS.into_iter().chain([host("robot"), host("control")]) {
        let credentials = Credentials::in_folder(out.join(role.to_string()));
        let certificate = credentials.check(&role, 1_500)?;
        assert_eq!(
            (
                certificate.role.clone(),
                certificate.robot.as_str(),
                certificate.from_s,
                certificate.until_s
            ),
            (role.clone(), "mecanum", 1_000, 2_000)
        );
        let is_robot = role == host("robot");
        assert!(
            ["10.0.0.1", "robot.example"]
                .into_iter()
                .all(|address| certificate.covers(address) == is_robot)
        );
        assert!(
            ["127.0.0.1", "localhost"]
                .into_iter()
                .all(|address| certificate.covers(address) == role.serves())
        );
        let late = credentials.check(&role, 2_000);
        assert!(matches!(late, Err(AccessError::Expired { since_s: 0, .. })), "{late:?}");
        let early = credentials.check(&role, 999);
        assert!(matches!(early, Err(AccessError::TooEarly { in_s: 1, .. })), "{early:?}");
    }
    let wrong = Credentials::in_folder(out.join("watcher")).check(&Role::Driver, 1_500);
    let is_named = matches!(
        &wrong,
        Err(AccessError::Role { found: Role::Watcher, expected: Role::Driver, .. })
    );
    assert!(is_named, "{wrong:?}");
    Ok(())
}

#[test]
fn keys_are_private_to_their_owner_and_rejected_if_not() -> Result<(), Box<dyn Error>> {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir()?;
    let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
    issue(&authority, &out, &order())?;
    for path in [
        authority.clone(),
        out.clone(),
        out.join("robot-host"),
        authority.join(KEY_FILE),
        out.join("robot-host").join(KEY_FILE),
    ] {
        assert_eq!(fs::metadata(&path)?.mode() & GROUP_AND_OTHERS, 0, "{}", path.display());
    }
    assert!(
        !out.join("authority").exists() && !out.join(KEY_FILE).exists(),
        "the authority's key does not travel"
    );
    fs::set_permissions(out.join("robot-host").join(KEY_FILE), fs::Permissions::from_mode(0o640))?;
    let read = Credentials::in_folder(out.join("robot-host")).read();
    assert!(matches!(read, Err(AccessError::NotPrivate { mode: 0o640, .. })), "{read:?}");
    fs::set_permissions(authority.join(KEY_FILE), fs::Permissions::from_mode(0o644))?;
    let refused = issue(&authority, &folder.path().join("more"), &order());
    assert!(
        matches!(&refused, Err(IssueError::Authority { reason, .. }) if reason.contains(KEY_FILE))
    );
    Ok(())
}

#[test]
fn a_file_that_others_can_write_is_rejected_with_its_mode() -> Result<(), Box<dyn Error>> {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir()?;
    let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
    issue(&authority, &out, &order())?;
    let robot = Credentials::in_folder(out.join("robot-host"));
    let set = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode));
    for (path, open, closed) in [
        (out.clone(), 0o777, 0o755),
        (out.clone(), 0o775, 0o700),
        (out.join("robot-host"), 0o770, 0o700),
        (robot.file(AUTHORITY_FILE), 0o666, 0o644),
        (robot.file(AUTHORITY_FILE), 0o660, 0o600),
        (robot.file(CERTIFICATE_FILE), 0o606, 0o600),
    ] {
        set(&path, open)?;
        let refused = robot.read();
        let expected = Changeable::Open { path: path.clone(), mode: open };
        assert!(
            matches!(&refused, Err(AccessError::Changeable(found)) if *found == expected),
            "{refused:?}"
        );
        set(&path, closed)?;
        robot.read()?;
    }
    set(folder.path(), 0o777)?;
    let refused = robot.read();
    let is_replaceable = matches!(
        &refused,
        Err(AccessError::Replaceable { above: Changeable::Open { mode: 0o777, .. }, .. })
    );
    assert!(is_replaceable, "{refused:?}");
    set(&authority, 0o777)?;
    let refused = issue(&authority, &folder.path().join("more"), &order());
    assert!(
        matches!(&refused, Err(IssueError::Authority { reason, .. }) if reason.contains("777")),
        "{refused:?}"
    );
    Ok(())
}

#[test]
fn an_authority_inside_the_certificates_is_rejected_for_every_form_of_its_path()
-> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let out = folder.path().canonicalize()?.join("out");
    let up: PathBuf = std::env::current_dir()?.components().skip(1).map(|_| "..").collect();
    let relative = up.join(out.strip_prefix("/")?);
    let link = folder.path().join("link");
    std::os::unix::fs::symlink(folder.path(), &link)?;
    for (authority, out) in [
        (out.join("a"), relative.clone()),
        (relative.join("a"), out.clone()),
        (link.join("out/a"), out.clone()),
    ] {
        let refused = issue(&authority, &out, &order());
        assert!(
            matches!(refused, Err(IssueError::Inside { .. })),
            "{} in {}",
            authority.display(),
            out.display()
        );
    }
    assert!(!out.exists());
    issue(&up.join(link.strip_prefix("/")?).join("a"), &relative, &order())?;
    Ok(())
}

#[test]
fn an_authority_signs_again_and_nothing_is_overwritten() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
    issue(&authority, &out, &order())?;
    assert!(matches!(issue(&authority, &out, &order()), Err(IssueError::NotEmpty { .. })));
    let next = folder.path().join("next");
    let later = Order { from_s: 1_800, until_s: 9_000, ..order() };
    assert!(!issue(&authority, &next, &later)?.new_authority);
    let authorities =
        [&out, &next].map(|out| fs::read(out.join("control-host").join(AUTHORITY_FILE)));
    assert_eq!(authorities[0].as_ref().ok(), authorities[1].as_ref().ok());
    let late = Order { until_s: 1_000 + AUTHORITY_VALID_S + 1, ..order() };
    assert!(matches!(
        issue(&authority, &folder.path().join("late"), &late),
        Err(IssueError::Authority { .. })
    ));
    Ok(())
}

#[test]
fn invalid_options_are_rejected_and_leave_no_files() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
    for robot in ["", "A", "a b", "a.b", "*"] {
        assert!(matches!(
            issue(&authority, &out, &Order { robot: robot.into(), ..order() }),
            Err(IssueError::Robot { .. })
        ));
    }
    for address in ["", "10.0.0.1:7447", "tcp/10.0.0.1", "a b", "0.0.0.0", "*", "-x"] {
        let refused = issue(
            &authority,
            &out,
            &Order { hosts: [("robot".to_owned(), vec![address.into()])].into(), ..order() },
        );
        assert!(matches!(refused, Err(IssueError::Address { .. })), "{address}");
    }
    assert!(matches!(
        issue(&out.join("authority"), &out, &order()),
        Err(IssueError::Inside { .. })
    ));
    assert_eq!(fs::read_dir(folder.path())?.count(), 0);
    Ok(())
}
