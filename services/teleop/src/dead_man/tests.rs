use super::*;

const TIME: Duration = Duration::from_millis(600);

fn dead_man() -> (DeadMan, Instant) {
    (DeadMan::new(TIME, Speeds::default()), Instant::now())
}

/// The velocity of a goal, and for how many milliseconds it is valid.
fn velocity(goal: Option<Demand>) -> Option<([f64; 3], u64)> {
    match goal? {
        Demand::Velocity { velocity, valid_s } => Some((velocity, (1e3 * valid_s).round() as u64)),
        _ => None,
    }
}

#[test]
fn one_key_gives_one_goal_that_ends_after_the_dead_man_time() {
    let (mut keys, begin) = dead_man();
    assert_eq!(keys.due(begin), None, "no key, no goal");
    keys.drive(Direction::Left, begin);
    assert_eq!(velocity(keys.due(begin)), Some(([0.0, 0.3, 0.0], 600)));
    for millis in (0..2000).step_by(10) {
        let now = begin + Duration::from_millis(millis);
        assert_eq!(keys.due(now), None, "{millis} ms");
        assert_eq!(keys.velocity(now) == [0.0; 3], millis >= 600, "{millis} ms");
        assert_eq!(keys.is_moving(now), millis < 600, "{millis} ms");
    }
}

/// The first repetition comes after 0.5 s, the others every 30 ms.
#[test]
fn a_held_key_drives_without_a_gap_and_with_few_goals() {
    let (mut keys, begin) = dead_man();
    let (mut ends, mut goals, last) = (0, 0, 3000);
    for millis in 0..4000 {
        let is_key = millis == 0 || (500..=last).contains(&millis) && (millis - 500) % 30 == 0;
        let now = begin + Duration::from_millis(millis);
        if is_key {
            keys.drive(Direction::Forward, now);
        }
        if let Some((_, valid)) = velocity(keys.due(now)) {
            assert!(goals == 0 || millis < ends, "a gap at {millis} ms");
            (ends, goals) = (millis + valid, goals + 1);
        }
    }
    let after_last = ends - 2990;
    assert!((400..=600).contains(&after_last), "the robot brakes {after_last} ms after the key");
    assert!(goals <= 15, "{goals} goals in 3 s");
}

/// Goals that get no reply are not sent again, and what was pressed meanwhile is not made up for.
#[test]
fn a_key_that_has_ended_before_its_goal_could_be_given_gives_none() {
    let (mut keys, begin) = dead_man();
    keys.drive(Direction::Forward, begin);
    assert_eq!(
        velocity(keys.due(begin + Duration::from_millis(500))).map(|goal| goal.1),
        Some(100)
    );
    keys.drive(Direction::Back, begin + TIME);
    assert_eq!(keys.due(begin + 2 * TIME), None);
}

#[test]
fn the_last_key_alone_counts() {
    let (mut keys, begin) = dead_man();
    keys.drive(Direction::Forward, begin);
    assert!(keys.due(begin).is_some());
    let later = begin + Duration::from_millis(100);
    keys.drive(Direction::TurnRight, later);
    assert_eq!(velocity(keys.due(later)), Some(([0.0, 0.0, -0.5], 600)));
}

#[test]
fn standing_is_given_once_and_a_later_key_drives_again() {
    let (mut keys, begin) = dead_man();
    keys.drive(Direction::Back, begin);
    assert!(keys.due(begin).is_some());
    keys.stand();
    assert_eq!(keys.velocity(begin), [0.0; 3]);
    assert_eq!(keys.due(begin), Some(Demand::Hold {}));
    assert_eq!((keys.due(begin), keys.is_moving(begin)), (None, false));
    keys.drive(Direction::Back, begin);
    assert_eq!(velocity(keys.due(begin)), Some(([-0.3, 0.0, 0.0], 600)));
    keys.stopped();
    assert_eq!((keys.due(begin), keys.is_moving(begin)), (None, false));
}

#[test]
fn another_speed_changes_the_goal_but_not_its_end() {
    let (mut keys, begin) = dead_man();
    keys.drive(Direction::Forward, begin);
    assert!(keys.due(begin).is_some());
    let later = begin + Duration::from_millis(200);
    keys.faster();
    assert_eq!(velocity(keys.due(later)), Some(([0.3 * STEP, 0.0, 0.0], 400)));
    keys.slower();
    assert_eq!(velocity(keys.due(later)), Some(([0.3, 0.0, 0.0], 400)));
    for _ in 0..100 {
        keys.slower();
    }
    assert!((keys.speeds().ground_mps - 0.3 * SHARES[0]).abs() < 1e-12);
}
