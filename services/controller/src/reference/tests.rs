use super::*;

fn all() -> Vec<PathSettings> {
    vec![
        PathSettings::PaperCurve { speed_mps: 2.7 },
        PathSettings::Circle { radius_m: 1.5, speed_mps: 1.0 },
        PathSettings::FigureEight { length_m: 4.0, width_m: 2.0, lap_s: 10.0 },
        PathSettings::StopAndGo {
            stretch_m: 2.0,
            speed_mps: 1.5,
            acceleration_mps2: 2.0,
            pause_s: 1.0,
        },
        PathSettings::PointToPoint { to: [2.0, 1.0, 0.5], speed_mps: 1.0, acceleration_mps2: 1.0 },
    ]
}

#[test]
fn the_velocity_of_every_smooth_path_is_the_derivative_of_its_pose() -> Result<(), PointsError> {
    for (path, ramp_s) in all().into_iter().flat_map(|path| [(path.clone(), 0.0), (path, 2.0)]) {
        let settings =
            ReferenceSettings { path, heading: Heading::FixedRad(0.3), ramp_s, speed_factor: 0.7 };
        let period = 1e-3;
        let table = Reference::new(&settings, &[0.0; 3], period, 20_000)?;
        for tick in (1..19_999).step_by(97) {
            let (before, here, after) = (table.at(tick - 1), table.at(tick), table.at(tick + 1));
            let (sin, cos) = here.pose[2].sin_cos();
            let world = [
                cos * here.velocity[0] - sin * here.velocity[1],
                sin * here.velocity[0] + cos * here.velocity[1],
            ];
            for axis in 0..2 {
                let numeric = (after.pose[axis] - before.pose[axis]) / (2.0 * period);
                assert!(
                    (numeric - world[axis]).abs() < 3e-3,
                    "{:?} at {tick}: {numeric} is not {}",
                    settings.path,
                    world[axis]
                );
            }
        }
    }
    Ok(())
}

#[test]
fn the_papers_curve_is_followed_at_its_speed_within_its_heading() -> Result<(), PointsError> {
    let settings = ReferenceSettings {
        path: PathSettings::PaperCurve { speed_mps: 2.7 },
        heading: Heading::Tangent,
        ramp_s: 0.0,
        speed_factor: 1.0,
    };
    let table = Reference::new(&settings, &[0.0, -1.0, 0.0], 0.1, 250)?;
    for tick in 0..=240 {
        let point = table.at(tick);
        let [x, y, yaw] = point.pose;
        assert!((y + 0.5 * x * (x / 20.0).sin()).abs() < 1e-9);
        assert!((point.velocity[0] - 2.7).abs() < 1e-9 && point.velocity[1].abs() < 1e-9);
        assert!(yaw.abs() <= std::f64::consts::FRAC_PI_3 || x > 66.0, "yaw {yaw} at x {x}");
    }
    Ok(())
}

#[test]
fn the_heading_of_a_circle_grows_without_a_jump() -> Result<(), PointsError> {
    let settings = ReferenceSettings {
        path: PathSettings::Circle { radius_m: 1.0, speed_mps: 1.0 },
        heading: Heading::Tangent,
        ramp_s: 0.0,
        speed_factor: 1.0,
    };
    let table = Reference::new(&settings, &[0.0; 3], 0.1, 200)?;
    for tick in 1..200 {
        assert!((table.at(tick).pose[2] - table.at(tick - 1).pose[2] - 0.1).abs() < 1e-9);
    }
    Ok(())
}

#[test]
fn the_lateral_distance_is_across_the_course_to_the_left_also_at_rest() -> Result<(), PointsError> {
    let path =
        PathSettings::PointToPoint { to: [0.0, 2.0, 0.0], speed_mps: 1.0, acceleration_mps2: 1.0 };
    let settings =
        ReferenceSettings { path, heading: Heading::FixedRad(0.3), ramp_s: 0.0, speed_factor: 1.0 };
    let table = Reference::new(&settings, &[0.0; 3], 0.1, 50)?;
    for tick in [10, 49, 200] {
        let point = table.at(tick);
        let [x, y, yaw] = point.pose;
        assert!((point.lateral(&[x - 0.1, y + 0.7, yaw]) - 0.1).abs() < 1e-12, "{point:?}");
    }
    Ok(())
}

#[test]
fn a_path_whose_numbers_would_be_infinite_is_refused() {
    let refused = |path| {
        ReferenceSettings { path, heading: Heading::FixedRad(0.0), ramp_s: 0.0, speed_factor: 1.0 }
            .check()
            .err()
            .map(|error| error.key)
    };
    // A speed at which stepping along the path took longer than the run.
    assert_eq!(
        refused(PathSettings::PaperCurve { speed_mps: 1e300 }),
        Some("path.paper-curve.speed_mps".to_owned())
    );
    assert_eq!(
        refused(PathSettings::Circle { radius_m: 1e-300, speed_mps: 1.0 }),
        Some("path.circle.radius_m".to_owned())
    );
    let far = PathSettings::PointToPoint {
        to: [1e308, 1e308, 0.0],
        speed_mps: 1.0,
        acceleration_mps2: 1.0,
    };
    assert_eq!(refused(far), Some("path.point-to-point.to".to_owned()));
    assert_eq!(refused(PathSettings::Circle { radius_m: 1.0, speed_mps: 1.0 }), None);
}

#[test]
fn after_its_end_the_robot_stands() -> Result<(), PointsError> {
    let settings = ReferenceSettings {
        path: PathSettings::Circle { radius_m: 1.0, speed_mps: 1.0 },
        heading: Heading::Tangent,
        ramp_s: 0.0,
        speed_factor: 1.0,
    };
    let table = Reference::new(&settings, &[0.0; 3], 0.1, 10)?;
    assert_eq!(table.at(11).velocity, [0.0; 3]);
    assert_eq!(table.at(11).pose, table.at(10).pose);
    Ok(())
}
