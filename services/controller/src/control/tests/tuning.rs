//! Settings that change while the robot drives.

use super::*;

/// The parts of a controller whose settings `change` modifies.
fn tuned(change: impl FnOnce(&mut Settings)) -> Result<Box<Tuned>, ControllerError> {
    let mut settings = told();
    change(&mut settings);
    Ok(Box::new(Tuned::new(&settings, Some(&told()))?))
}

#[test]
fn a_change_while_driving_does_not_allocate_and_the_next_plan_is_fresh()
-> Result<(), Box<dyn std::error::Error>> {
    let mut robot = Robotic::new(&told())?;
    let square = PathSettings::Square { side_m: 3.0, speed_mps: 1.0 };
    let mut changes = [
        (tuned(|settings| settings.mpc.weights.position *= 4.0)?, told().mpc.horizon_steps),
        (
            tuned(|settings| {
                (settings.mpc.horizon_steps, settings.mpc.control_horizon_steps) =
                    (HORIZON_MAX, 10);
            })?,
            HORIZON_MAX,
        ),
        (
            tuned(|settings| {
                (settings.mpc.horizon_steps, settings.mpc.control_horizon_steps) = (3, 1);
            })?,
            3,
        ),
        (tuned(|settings| settings.reference.path = square)?, told().mpc.horizon_steps),
    ];
    for tick in 0..40 {
        if let (Some((tuned, _)), true) = (changes.get_mut(tick as usize / 10), tick % 10 == 5) {
            let heap = allocation_counter::measure(|| robot.controller.tune(tuned, tick));
            assert_eq!(
                (heap.count_total, heap.count_current),
                (0, 0),
                "tick {tick}: {} bytes",
                heap.bytes_total
            );
            assert_eq!(tuned.since, Some((1, tick)));
        }
        let (verdict, command) = robot.drive(tick);
        assert_eq!(
            (verdict, command.fallback_level()),
            (Ok(()), FallbackLevel::FreshPlan),
            "{tick}"
        );
        if let (Some((_, horizon)), true) = (changes.get(tick as usize / 10), tick % 10 >= 5) {
            let under_way = robot.controller.knowledge().delay().whole();
            assert_eq!(
                robot.controller.explain(0).horizon as usize,
                (under_way + horizon).min(HORIZON_MAX),
                "{tick}"
            );
        }
    }
    Ok(())
}

#[test]
fn an_exchange_for_equal_settings_changes_commands_by_rounding_only()
-> Result<(), Box<dyn std::error::Error>> {
    let (mut tuned_often, mut never) = (Robotic::new(&told())?, Robotic::new(&told())?);
    for tick in 0..30 {
        let mut same = Tuned::new(&told(), (tick % 2 == 0).then(told).as_ref())?;
        tuned_often.controller.tune(&mut same, tick);
        let (ours, theirs) = (tuned_often.drive(tick).1, never.drive(tick).1);
        // Its targets have been improved once more.
        let inputs = |command: &Command| {
            [command.input].into_iter().chain(command.tail).flatten().collect::<Vec<f64>>()
        };
        let apart = inputs(&ours)
            .iter()
            .zip(inputs(&theirs))
            .map(|(ours, theirs)| (ours - theirs).abs())
            .fold(0.0, f64::max);
        assert!(apart < 1e-6, "tick {tick}: {apart}");
    }
    Ok(())
}
