use super::*;
use proptest::prelude::*;

/// The paper's base.
fn paper() -> Wheels {
    Wheels::example()
}

/// The paper's base as a list of wheels.
fn listed() -> Result<Wheels, ImpossibleWheels> {
    let wheel = |x, y, roller_deg| Wheel {
        position_m: [x, y],
        direction_deg: 0.0,
        roller_deg,
        radius_m: 0.05,
    };
    let wheels = [
        wheel(0.125, -0.15, 45.0),
        wheel(0.125, 0.15, -45.0),
        wheel(-0.125, 0.15, 45.0),
        wheel(-0.125, -0.15, -45.0),
    ];
    Layout::List(wheels.into_iter().collect()).try_into()
}

fn omni(count: usize) -> Result<Wheels, ImpossibleWheels> {
    Layout::Omni(Omni { radius_m: 0.05, centre_to_wheel_m: 0.2, count }).try_into()
}

fn all() -> Vec<Wheels> {
    let rollers = Rollers::X;
    let x = Mecanum { radius_m: 0.05, wheelbase_m: 0.2, track_m: 0.6, rollers };
    let mut all = vec![paper()];
    all.extend(Wheels::try_from(Layout::Mecanum(x)));
    all.extend(listed());
    all.extend((3..=8).filter_map(|count| omni(count).ok()));
    all
}

proptest! {
    #[test]
    fn wheel_speeds_convert_back_to_the_same_velocity(
        velocity in prop::array::uniform3(-5.0..5.0)
    ) {
        prop_assert_eq!(all().len(), 9);
        for wheels in all() {
            let back = wheels.body(&wheels.speeds(velocity));
            for (a, b) in back.iter().zip(velocity) {
                prop_assert!((a - b).abs() < 1e-12, "{:?}: {back:?}", wheels.layout());
            }
        }
    }

    #[test]
    fn equation_4_of_the_paper_holds_in_the_rotated_frame(
        right in -3.0..3.0_f64,
        ahead in -3.0..3.0_f64,
        yaw in -3.0..3.0_f64,
    ) {
        let lever = paper().lever_m();
        let of_paper = [
            -right + ahead + yaw * lever,
            right + ahead - yaw * lever,
            -right + ahead - yaw * lever,
            right + ahead + yaw * lever,
        ];
        for wheels in [Some(paper()), listed().ok()].into_iter().flatten() {
            for (a, b) in wheels.speeds([ahead, -right, yaw]).iter().zip(of_paper) {
                prop_assert!((a * 0.05 - b).abs() < 1e-12);
            }
        }
    }

    /// The velocity of its contact with the floor, along its own direction.
    #[test]
    fn an_omni_wheel_measures_the_speed_of_its_contact(
        velocity in prop::array::uniform3(-3.0..3.0)
    ) {
        let wheels = omni(3).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let speeds = wheels.speeds(velocity);
        for (index, [x, y]) in wheels.positions_m().iter().enumerate() {
            let contact = [velocity[0] - velocity[2] * y, velocity[1] + velocity[2] * x];
            let along = (-y * contact[0] + x * contact[1]) / x.hypot(*y);
            prop_assert!((speeds[index] * 0.05 - along).abs() < 1e-12);
        }
    }
}

#[test]
fn the_papers_base_has_the_levers_and_sums_of_the_paper_bit_for_bit() {
    let wheels = paper();
    let lever: f64 = 0.125 + 0.15;
    assert_eq!(Wheels::mecanum(0.05, 0.25, 0.3), Ok(wheels));
    assert_eq!((wheels.lever_m(), wheels.radius_m(), wheels.count()), (lever, 0.05, 4));
    assert_eq!(wheels.square_sums(), [4.0, 4.0, 4.0 * (lever * lever)]);
    assert_eq!(wheels.half_extent_m(), [0.125, 0.15]);
    assert_eq!(listed().map(|listed| listed.rows == wheels.rows), Ok(true));
}

#[test]
fn wheels_that_cannot_drive_in_every_direction_are_refused_with_numbers() {
    let square = Mecanum { radius_m: 0.05, wheelbase_m: 0.3, track_m: 0.3, rollers: Rollers::X };
    let refused = Wheels::try_from(Layout::Mecanum(square));
    assert!(
        matches!(&refused, Err(ImpossibleWheels::Rank { kind: "mecanum", isotropy, rows })
            if isotropy.abs() < 1e-12 && rows.len() == 4),
        "{refused:?}"
    );
    let parallel = |y| Wheel { position_m: [0.0, y], radius_m: 0.05, ..Wheel::default() };
    let refused =
        Wheels::try_from(Layout::List([-0.2, 0.0, 0.2].map(parallel).into_iter().collect()));
    assert!(matches!(refused, Err(ImpossibleWheels::Rank { .. })), "{refused:?}");
}

#[test]
fn impossible_wheels_are_refused_by_name() {
    let key = "omni.count";
    assert_eq!(omni(2), Err(ImpossibleWheels::Count { key, count: 2 }));
    assert_eq!(omni(9), Err(ImpossibleWheels::Count { key, count: 9 }));
    let named = |refused: Result<Wheels, ImpossibleWheels>| match refused {
        Err(ImpossibleWheels::Value { key, .. }) => key,
        other => format!("{other:?}"),
    };
    assert_eq!(named(Wheels::mecanum(0.0, 0.25, 0.3)), "mecanum.radius_m");
    assert_eq!(named(Wheels::mecanum(0.05, f64::NAN, 0.3)), "mecanum.wheelbase_m");
    let lost = Wheel { position_m: [f64::NAN, 0.0], radius_m: 0.05, ..Wheel::default() };
    let list = Layout::List([lost; 3].into_iter().collect());
    assert_eq!(named(Wheels::try_from(list)), "list.0.position_m");
}
