use super::examine::first;
use super::*;
use crate::control::Controller;
use crate::control::tests::told;
use model::AXES;
use model::gp::hyperparameters::Hyperparameters;
use model::gp::posterior::Posterior;
use model::learned::INPUTS;
use protocol::frame::{self, DecodeError};
use protocol::message::{Message, ModelSnapshot, SnapshotHead};

const EXPECTED: Expected =
    Expected { fingerprint: 42, layout: Layout::VelocitySlip, bound: [0.5; 3] };

/// A snapshot of a few points, in the form that a learner sends.
fn snapshot() -> Result<ModelSnapshot, Box<dyn std::error::Error>> {
    let mut head: SnapshotHead = bytemuck::Zeroable::zeroed();
    (head.version, head.fingerprint, head.inputs, head.score_samples) = (3, 42, INPUTS as u32, 2);
    head.stamp.epoch = 5;
    head.input_scale = [1.0; protocol::message::INPUTS_MAX];
    head.length_scale = [[1.0; protocol::message::INPUTS_MAX]; 3];
    (head.signal_variance, head.noise_variance, head.linear_variance) =
        ([0.01; 3], [1e-4; 3], [0.02, 0.02, 0.0]);
    let inputs: Vec<[f64; INPUTS]> =
        (0..8).map(|i| std::array::from_fn(|j| ((i * INPUTS + j) as f64).sin())).collect();
    let targets: Vec<[f64; AXES]> =
        inputs.iter().map(|input| [0.1 * input[0], 0.1 * input[1], 0.0]).collect();
    let plain = Hyperparameters::new([1.0; INPUTS], 0.01, 1e-4);
    let hyperparameters = [plain.with_linear(0.02), plain.with_linear(0.02), plain];
    let posterior = Posterior::new(&inputs, &targets, &hyperparameters)?;
    let mut snapshot = ModelSnapshot::new(head);
    for (i, (input, target)) in inputs.iter().zip(&targets).enumerate() {
        snapshot.push(input, *target, posterior.weights().map(|weights| weights[i]))?;
    }
    Ok(snapshot)
}

/// A change that damages a good snapshot, and the expected refusal.
type Damage = (&'static str, fn(&mut ModelSnapshot), fn(&Refusal) -> bool);

/// The rows again, each changed.
fn rewritten(
    snapshot: &mut ModelSnapshot,
    change: impl Fn(usize, &mut [f64; INPUTS], &mut [f64; AXES], &mut f64),
) {
    let mut changed = ModelSnapshot::new(snapshot.head);
    for (index, row) in snapshot.rows().enumerate() {
        let (mut input, mut target, mut noise_scale) =
            (first(row.input), first(row.target), row.noise_scale);
        change(index, &mut input, &mut target, &mut noise_scale);
        assert!(changed.push_with_noise(&input, target, first(row.weight), noise_scale).is_ok());
    }
    *snapshot = changed;
}

fn absurd(name: &str) -> impl Fn(&Refusal) -> bool {
    move |refusal| matches!(refusal, Refusal::Hyperparameter { name: named, .. } if *named == name)
}

fn not_finite(field: &str) -> impl Fn(&Refusal) -> bool {
    move |refusal| matches!(refusal, Refusal::NotFinite { field: named, .. } if *named == field)
}

const DAMAGES: &[Damage] = &[
    (
        "another robot",
        |bad| bad.head.fingerprint = 7,
        |refusal| *refusal == Refusal::Fingerprint { version: 4, expected: 42, got: 7 },
    ),
    (
        "an older version",
        |bad| bad.head.version = 2,
        |refusal| *refusal == Refusal::Stale { version: 2, epoch: 5, newest: 3, newest_epoch: 5 },
    ),
    (
        "an earlier learner",
        |bad| bad.head.stamp.epoch = 4,
        |refusal| *refusal == Refusal::Stale { version: 4, epoch: 4, newest: 3, newest_epoch: 5 },
    ),
    (
        "fewer points than promised",
        |bad| bad.head.points += 1,
        |refusal| *refusal == Refusal::Size { version: 4, promised: 9, got: 8 },
    ),
    (
        "too many points",
        |bad| bad.head.points = 2_001,
        |refusal| *refusal == Refusal::Points { version: 4, got: 2_001 },
    ),
    (
        "another layout's inputs",
        |bad| bad.head.inputs = 9,
        |refusal| matches!(refusal, Refusal::Inputs { got: 9, .. }),
    ),
    (
        "an input that is no number",
        |bad| rewritten(bad, |row, input, _, _| input[1] /= if row == 3 { 0.0 } else { 1.0 }),
        |refusal| not_finite("input")(refusal),
    ),
    (
        "a target that is no number",
        |bad| rewritten(bad, |_, _, target, _| target[2] = f64::NAN),
        |refusal| not_finite("target")(refusal),
    ),
    (
        "a noise scale that is no number",
        |bad| rewritten(bad, |_, _, _, scale| *scale = f64::NAN),
        |refusal| not_finite("noise_scale")(refusal),
    ),
    (
        "a mean that is no number",
        |bad| bad.head.input_mean[2] = f64::NAN,
        |refusal| not_finite("input_mean")(refusal),
    ),
    (
        "a length scale that is no number",
        |bad| bad.head.length_scale[1][0] = f64::NAN,
        |refusal| not_finite("length_scale")(refusal),
    ),
    (
        "a score that is no number",
        |bad| bad.head.score_learned[0] = f64::INFINITY,
        |refusal| not_finite("score_learned")(refusal),
    ),
    (
        "a scale of zero",
        |bad| bad.head.input_scale[2] = 0.0,
        |refusal| matches!(refusal, Refusal::Normalisation { .. }),
    ),
    (
        "a mean out of this world",
        |bad| bad.head.input_mean[2] = 1e9,
        |refusal| matches!(refusal, Refusal::Normalisation { .. }),
    ),
    (
        "a length scale of nothing",
        |bad| bad.head.length_scale[0][3] = 1e-9,
        |refusal| absurd("length_scale")(refusal),
    ),
    (
        "an endless length scale",
        |bad| bad.head.length_scale[2][5] = 1e30,
        |refusal| absurd("length_scale")(refusal),
    ),
    (
        "a negative variance",
        |bad| bad.head.signal_variance[0] = -1.0,
        |refusal| absurd("signal_variance")(refusal),
    ),
    (
        "a variance beyond physics",
        |bad| bad.head.signal_variance[1] = 1e6,
        |refusal| absurd("signal_variance")(refusal),
    ),
    (
        "a negative linear variance",
        |bad| bad.head.linear_variance[1] = -1.0,
        |refusal| absurd("linear_variance")(refusal),
    ),
    (
        "a place variance in a layout without the place",
        |bad| bad.head.place_variance[1] = 0.01,
        |refusal| absurd("place_variance")(refusal),
    ),
    (
        "no noise at all",
        |bad| bad.head.noise_variance[2] = 0.0,
        |refusal| absurd("noise_variance")(refusal),
    ),
    (
        "a negative variance of a sample",
        |bad| bad.head.sample_variance[1] = -1.0,
        |refusal| absurd("sample_variance")(refusal),
    ),
    (
        "a negative noise of a point",
        |bad| rewritten(bad, |_, _, _, scale| *scale = -1.0),
        |refusal| matches!(refusal, Refusal::Posterior { .. }),
    ),
    (
        "twins without noise",
        |bad| {
            bad.head.signal_variance = [20.0; AXES];
            rewritten(bad, |_, input, _, scale| (*input, *scale) = ([0.5; INPUTS], 1e-12));
        },
        |refusal| matches!(refusal, Refusal::Indefinite { .. }),
    ),
    (
        "the weights of other data",
        |bad| rewritten(bad, |_, _, target, _| target[0] *= 1.01),
        |refusal| matches!(refusal, Refusal::Weights { .. }),
    ),
];

#[test]
fn every_bad_snapshot_is_refused_with_its_cause_and_the_last_good_one_stays()
-> Result<(), Box<dyn std::error::Error>> {
    let mut examiner = Examiner::new(EXPECTED);
    let mut controller = Controller::new(&told())?;
    assert!(controller.adopt(Box::new(examiner.examine(&snapshot()?)?)).is_none());
    for (what, damage, named) in DAMAGES {
        let mut bad = snapshot()?;
        bad.head.version = 4;
        assert!(prepare(&bad, &EXPECTED).is_ok());
        damage(&mut bad);
        match examiner.examine(&bad) {
            Err(refusal) => assert!(named(&refusal), "{what}: {refusal:?}"),
            Ok(_) => return Err(format!("{what} is not refused").into()),
        }
        assert_eq!(controller.model_version(), 3, "{what}");
    }
    let again = examiner.examine(&snapshot()?)?;
    assert_eq!(
        controller.adopt(Box::new(again)).map(|before| before.version),
        Some(3),
        "the same version may come again"
    );
    Ok(())
}

#[test]
fn a_learner_of_a_later_epoch_may_restart_its_versions() -> Result<(), Box<dyn std::error::Error>> {
    let mut examiner = Examiner::new(EXPECTED);
    examiner.examine(&snapshot()?)?;
    let mut restarted = snapshot()?;
    (restarted.head.stamp.epoch, restarted.head.version) = (6, 1);
    assert_eq!(examiner.examine(&restarted)?.version, 1);
    assert!(matches!(
        examiner.examine(&snapshot()?),
        Err(Refusal::Stale { newest: 1, newest_epoch: 6, .. })
    ));
    Ok(())
}

#[test]
fn a_snapshot_torn_anywhere_is_not_a_message() -> Result<(), Box<dyn std::error::Error>> {
    let mut whole = snapshot()?;
    (whole.head.stamp.version, whole.head.stamp.kind) = (protocol::VERSION, ModelSnapshot::KIND);
    let mut bytes = vec![0; whole.byte_len()];
    frame::encode(&whole, &mut bytes);
    assert_eq!(frame::decode::<ModelSnapshot>(&bytes)?.head.version, 3);
    for cut in (0..bytes.len()).step_by(8) {
        assert!(frame::decode::<ModelSnapshot>(&bytes[..cut]).is_err(), "cut to {cut} bytes");
    }
    // The front of one and the back of another.
    for place in (0..bytes.len()).step_by(13) {
        let mut torn = bytes.clone();
        torn[place] ^= 0x10;
        assert!(frame::decode::<ModelSnapshot>(&torn).is_err(), "byte {place} is another");
    }
    Ok(())
}

#[test]
fn weights_that_do_not_follow_from_the_data_are_refused() -> Result<(), Box<dyn std::error::Error>>
{
    let honest = snapshot()?;
    let mut forged = ModelSnapshot::new(honest.head);
    for row in honest.rows() {
        forged.push(
            row.input,
            first(row.target),
            first::<3>(row.weight).map(|weight| 1.01 * weight),
        )?;
    }
    assert!(matches!(prepare(&forged, &EXPECTED), Err(Refusal::Weights { .. })));
    let mut aged = ModelSnapshot::new(honest.head);
    for row in honest.rows() {
        aged.push_with_noise(row.input, first(row.target), first(row.weight), 4.0)?;
    }
    assert!(
        matches!(prepare(&aged, &EXPECTED), Err(Refusal::Weights { .. })),
        "the noise of its data is not what its weights are for"
    );
    Ok(())
}

#[test]
fn another_number_of_inputs_never_fits_a_snapshot() -> Result<(), Box<dyn std::error::Error>> {
    let mut narrow = snapshot()?;
    assert!(matches!(narrow.push(&[0.0; 2], [0.0; 3], [0.0; 3]), Err(DecodeError::Length { .. })));
    Ok(())
}
