//! Messages with one impossible number and a valid checksum, for the processes that use the number.
//!
//! | message         | checked by                | numbers                   | impossible values |
//! |-----------------|---------------------------|---------------------------|-------------------|
//! | `PlantState`    | the controller's watch    | pose, velocity            | not finite        |
//! | `ModelSnapshot` | the controller's examiner | all                       | not finite        |
//! |                 |                           | numbers used of its head  | huge              |

use super::{BAD, Encoding, Offered, PERIOD};
use crate::session::Trouble;
use controller::adopt::{Expected, prepare};
use controller::sensors::{Driven, Watch};
use model::learned::{INPUTS, Layout};
use model::main_model::MainModel;
use model::residual::bound;
use protocol::message::{INPUTS_MAX, Message, ModelSnapshot, PlantState, SnapshotHead};
use robot::Robot;

/// Fields in the head of a snapshot that are only reported.
const TOLD: [&str; 4] = ["log_likelihood", "jitter", "score_learned", "score_main"];

/// Offers every number in turn to the code that checks it, in memory form and in network form. None
/// may be used.
///
/// # Errors
/// If an undamaged message is rejected.
pub(super) fn offer(offered: &mut Offered) -> Result<(), Trouble> {
    let main = MainModel::new(&Robot::example(), PERIOD as f64 * 1e-9);
    let bound = bound(&main, &Robot::example());

    let driven = Driven { acted: [0.0; 3], commanded: None };
    let believed = |state: &PlantState| Watch::new(main, bound).look(state, &driven).is_none();
    let measured =
        |field: &str, _, bad: f64| ["pose", "velocity"].contains(&field) && !bad.is_finite();
    offer_each(&bytemuck::Zeroable::zeroed(), measured, believed, offered)?;

    let expected = Expected { fingerprint: 0, layout: Layout::VelocitySlip, bound };
    let adopted = |snapshot: &ModelSnapshot| prepare(snapshot, &expected).is_ok();
    let in_use = |field: &str, place: usize| {
        field != "points" && !TOLD.contains(&field) && place % INPUTS_MAX < INPUTS
    };
    let learnt = |field: &str, place, bad: f64| !bad.is_finite() || in_use(field, place);
    offer_each(&snapshot(&bound)?, learnt, adopted, offered)
}

/// Gives each number of `good` a bad value in turn, and counts the messages that are `used`.
///
/// `looked_at` gets the field, the place in it and the bad value, and selects the values that must
/// be rejected.
fn offer_each<T: Message>(
    good: &T,
    looked_at: impl Fn(&str, usize, f64) -> bool,
    used: impl Fn(&T) -> bool,
    offered: &mut Offered,
) -> Result<(), Trouble> {
    let mut places = Vec::new();
    good.clone().visit_numbers(&mut |field, numbers| {
        places.extend((0..numbers.len()).map(|place| (field, place)));
    });
    for encoding in Encoding::BOTH {
        if !used(&encoding.decode(&encoding.sealed(good.clone()))?) {
            return Err(format!("the undamaged {} was refused", T::NAME).into());
        }
        for bad in BAD {
            for &(field, place) in
                places.iter().filter(|(field, place)| looked_at(field, *place, bad))
            {
                let mut message = good.clone();
                message.visit_numbers(&mut |name, numbers| {
                    if let Some(number) = numbers.get_mut(place).filter(|_| name == field) {
                        *number = bad;
                    }
                });
                if used(&encoding.decode(&encoding.sealed(message))?) {
                    offered.violations.push(format!(
                        "a {} whose {field} holds {bad:e} at {place} was used",
                        T::NAME
                    ));
                }
                offered.injections += 1;
            }
        }
    }
    Ok(())
}

/// A good snapshot of a few points, according to which there is nothing to learn.
fn snapshot(bound: &[f64; 3]) -> Result<ModelSnapshot, Trouble> {
    let mut head: SnapshotHead = bytemuck::Zeroable::zeroed();
    head.inputs = INPUTS as u32;
    head.input_scale = [1.0; INPUTS_MAX];
    head.length_scale = [[1.0; INPUTS_MAX]; 3];
    (head.signal_variance, head.noise_variance) =
        (bound.map(|bound| bound.powi(2)), bound.map(|bound| 0.01 * bound.powi(2)));
    let mut snapshot = ModelSnapshot::new(head);
    for place in 0..4 {
        snapshot.push(&[f64::from(place); INPUTS], [0.0; 3], [0.0; 3])?;
    }
    Ok(snapshot)
}
