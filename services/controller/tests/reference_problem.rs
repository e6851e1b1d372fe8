//! The problem that peers are measured on: the same data, and the same answers.

#[path = "reference_problem/closed_loop.rs"]
mod closed_loop;
#[path = "reference_problem/problem.rs"]
mod problem;

use controller::settings::Linearise;
use model::learned::{Moment, Residual};
use problem::{PERIOD, Processes, gp_data, reference};
use std::error::Error;

/// FNV-1a over the bits of numbers.
fn hash(numbers: impl Iterator<Item = f64>) -> u64 {
    numbers.flat_map(f64::to_le_bytes).fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

fn assert_close(ours: impl IntoIterator<Item = f64>, theirs: &[f64], tolerance: f64) {
    for (ours, theirs) in ours.into_iter().zip(theirs) {
        assert!((ours - theirs).abs() <= tolerance * theirs.abs(), "{ours} is not {theirs}");
    }
}

#[test]
fn the_data_equal_those_of_the_peers_bit_for_bit_except_for_library_functions() {
    let (inputs, targets) = gp_data::gp_data(500, 7);
    assert_eq!(
        hash(inputs.iter().flat_map(|input| [input[0], input[1], input[2]])),
        0xf92f_d289_6d4b_9fbf
    );
    // Logarithm, sine, cosine and hyperbolic tangent may differ in the last bit between C
    // libraries.
    let theirs = [-2.153_650_281_494_109_6, 2.308_643_996_602_611, 1.039_544_649_208_15];
    assert_close(inputs[499][3..].iter().copied(), &theirs, 1e-15);
    assert_close(
        targets[499],
        &[1.059_312_093_014_695_5, -1.043_870_078_668_973_2, -0.516_278_154_202_769_2],
        1e-14,
    );
    let end = reference(342)[341];
    let theirs = [71.300_553_408_914_55, 14.648_503_232_476_124, 1.070_807_107_733_482_2];
    assert_close(end.pose, &theirs, 1e-13);
    assert_close([end.velocity[2]], &[0.002_666_548_239_543_998_7], 1e-12);
}

#[test]
fn the_processes_predict_the_same_as_those_of_the_peers() -> Result<(), Box<dyn Error>> {
    let at = Moment { velocity: [1.0, -0.5, 0.2], input: [1.2, -0.6, 0.1], ..Moment::default() };
    let ours = Processes::new(100)?.mean(&at).map(|change| change / PERIOD);
    assert_close(
        ours,
        &[-0.579_992_644_624_64, 0.941_390_447_576_224_7, -0.114_013_708_144_932_06],
        1e-10,
    );
    Ok(())
}

#[test]
fn the_closed_loop_equals_that_of_three_independent_peers() -> Result<(), Box<dyn Error>> {
    let figures = closed_loop::drive(100, 10, Linearise::Expected)?;
    assert!(
        (figures.rms_pos_err - 0.35788).abs() < 2e-4 && (figures.usum - 1091.717).abs() < 0.2,
        "{figures:?}"
    );
    Ok(())
}
