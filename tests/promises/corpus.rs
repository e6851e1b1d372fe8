//! Promise: input from outside is used or refused, and never causes a panic. Every run of the tests
//! reads every seed of the fuzzer, and seeds that were damaged at random.

use promises::Outcome;
use promises::decoders::{ALL, Decoder, Fate, corpus};
use proptest::collection::vec;
use proptest::prelude::{Just, Strategy, any, prop_oneof};
use proptest::sample::{Index, select};
use proptest::test_runner::{Config, TestCaseError, TestRunner};
use std::collections::BTreeSet;
use std::error::Error;
use std::fs;
use std::path::Path;

/// Damaged seeds for each decoder.
const CASES: u32 = 300;

/// Values that no setting should have, or not everywhere.
const HOSTILE: &[&str] = &[
    "nan",
    "-nan",
    "inf",
    "-inf",
    "0",
    "-0.0",
    "-1",
    "1e-308",
    "1e308",
    "-1e308",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551616",
    "true",
    "\"\"",
    "\"text\"",
    "\"\\u0000/../\u{1f6de}\"",
    "[]",
    "[0, nan, \"\"]",
    "{}",
    "{ a.b.c = 1 }",
    "1979-05-27T07:32:00Z",
    "",
    "=",
];

/// Name and bytes of a file.
type Seed = (String, Vec<u8>);

/// The files in `folder`, by name.
fn seeds(folder: &Path) -> Result<Vec<Seed>, Box<dyn Error>> {
    let mut seeds = Vec::new();
    for entry in fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))? {
        let entry = entry?;
        seeds.push((entry.file_name().to_string_lossy().into_owned(), fs::read(entry.path())?));
    }
    seeds.sort();
    Ok(seeds)
}

#[test]
fn every_seed_is_used_or_refused_and_nothing_panics() -> Outcome {
    for (name, decoder) in ALL {
        let seeds = seeds(&corpus().join(name))?;
        let mut used = 0;
        for (seed, bytes) in seeds {
            let fate = decoder(&bytes).map_err(|broken| format!("{name}/{seed}: {broken}"))?;
            used += usize::from(fate == Fate::Used);
        }
        assert!(
            used > 0,
            "{name} has no seed that is used: damaged ones would all be refused at once"
        );
    }
    Ok(())
}

#[test]
fn every_decoder_has_a_corpus_and_a_fuzz_target_and_there_are_no_others() -> Outcome {
    let decoders: BTreeSet<String> = ALL.iter().map(|(name, _)| (*name).to_owned()).collect();
    let names = |folder: &Path| -> Result<BTreeSet<String>, Box<dyn Error>> {
        let stem = |entry: fs::DirEntry| {
            entry.path().file_stem().map(|stem| stem.to_string_lossy().into_owned())
        };
        Ok(fs::read_dir(folder)?.flatten().filter_map(stem).collect())
    };
    let fuzz = corpus().with_file_name("fuzz_targets");
    assert_eq!(names(&corpus())?, decoders);
    assert_eq!(names(&fuzz)?, decoders);
    let manifest = fs::read_to_string(corpus().with_file_name("Cargo.toml"))?;
    for name in decoders {
        assert!(
            manifest.contains(&format!("path = \"fuzz_targets/{name}.rs\"")),
            "tests/fuzz/Cargo.toml does not name {name}"
        );
        assert!(
            fs::read_to_string(fuzz.join(&name).with_extension("rs"))?
                .contains(&format!("\"{name}\"")),
            "{name} is given to another decoder"
        );
    }
    Ok(())
}

/// One way to damage a file.
#[derive(Debug, Clone)]
enum Damage {
    /// One bit is flipped.
    Flip(Index, u32),
    /// The rest is missing.
    Cut(Index),
    /// A part is repeated, or moved to another place.
    Splice(Index, Index, Index),
    /// Other bytes replace some.
    Replace(Index, Vec<u8>),
    /// Another number of 8 bytes replaces some.
    Number(Index, u64),
}

impl Damage {
    fn to(&self, mut bytes: Vec<u8>) -> Vec<u8> {
        let length = bytes.len();
        if length == 0 {
            return bytes;
        }
        match self {
            Self::Flip(place, bit) => bytes[place.index(length)] ^= 1 << bit,
            Self::Cut(place) => bytes.truncate(place.index(length)),
            Self::Splice(from, to, place) => {
                let (from, to) = (from.index(length), to.index(length));
                let part = bytes[from.min(to)..from.max(to)].to_vec();
                let place = place.index(length);
                bytes.splice(place..place, part);
            }
            Self::Replace(place, by) => overwrite(&mut bytes, *place, by),
            Self::Number(place, number) => overwrite(&mut bytes, *place, &number.to_le_bytes()),
        }
        bytes
    }
}

/// Writes `by` over the bytes at `place`, as far as there is room.
fn overwrite(bytes: &mut [u8], place: Index, by: &[u8]) {
    let place = place.index(bytes.len());
    bytes[place..].iter_mut().zip(by).for_each(|(byte, by)| *byte = *by);
}

fn damage() -> impl Strategy<Value = Damage> {
    let numbers = vec![
        0,
        1,
        u64::MAX,
        i64::MAX as u64,
        1 << 32,
        f64::NAN.to_bits(),
        f64::INFINITY.to_bits(),
        1e308_f64.to_bits(),
        (-1.0_f64).to_bits(),
    ];
    let place = || any::<Index>();
    prop_oneof![
        (place(), 0..8_u32).prop_map(|(place, bit)| Damage::Flip(place, bit)),
        place().prop_map(Damage::Cut),
        (place(), place(), place()).prop_map(|(from, to, place)| Damage::Splice(from, to, place)),
        (place(), vec(any::<u8>(), 1..9)).prop_map(|(place, by)| Damage::Replace(place, by)),
        (place(), select(numbers)).prop_map(|(place, number)| Damage::Number(place, number)),
    ]
}

/// A value that a setting should not have; sometimes nested deeper than in any real file.
fn hostile() -> impl Strategy<Value = String> {
    prop_oneof![
        8 => select(HOSTILE).prop_map(str::to_owned),
        1 => (1..3000_usize).prop_map(|depth| "[".repeat(depth) + &"]".repeat(depth)),
        1 => (1..3000_usize).prop_map(|depth| "{a=".repeat(depth) + "1" + &"}".repeat(depth)),
        1 => Just("\"".to_owned() + &"long".repeat(500) + "\""),
    ]
}

/// Replaces lines of a TOML file: by another value, by a deep key, or by nothing.
fn with_lines_replaced(seed: &[u8], changes: &[(Index, String)]) -> Vec<u8> {
    let text = String::from_utf8_lossy(seed);
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let count = lines.len().max(1);
    for (place, value) in changes {
        let Some(line) = lines.get_mut(place.index(count)) else { continue };
        *line = match line.split_once('=') {
            Some((key, _)) => format!("{key}= {value}"),
            None if value.starts_with('[') => value.clone(),
            None => format!("{line}\n{} = {value}", vec!["deep"; value.len()].join(".")),
        };
    }
    lines.join("\n").into_bytes()
}

/// Passes to `decoder` the inputs that `strategy` makes of its seeds.
fn given<T: std::fmt::Debug>(
    name: &str,
    decoder: Decoder,
    strategy: impl Strategy<Value = T>,
    made: impl Fn(&[u8], &T) -> Vec<u8>,
) -> Outcome {
    let seeds = seeds(&corpus().join(name))?;
    let mut runner =
        TestRunner::new(Config { cases: CASES, failure_persistence: None, ..Config::default() });
    let verdict = runner.run(&(any::<Index>(), strategy), |(seed, change)| {
        let (_, bytes) = seed.get(&seeds);
        decoder(&made(bytes, &change)).map(drop).map_err(TestCaseError::fail)
    });
    verdict.map_err(|error| format!("{name}: {error}").into())
}

#[test]
fn a_damaged_seed_is_used_or_refused_and_nothing_panics() -> Outcome {
    for (name, decoder) in ALL {
        given(name, decoder, vec(damage(), 1..5), |seed, damages| {
            damages.iter().fold(seed.to_vec(), |bytes, damage| damage.to(bytes))
        })?;
    }
    Ok(())
}

#[test]
fn an_impossible_setting_is_refused_with_its_line_and_nothing_panics() -> Outcome {
    let is_toml = |name: &str| {
        corpus().join(name).read_dir().is_ok_and(|mut files| {
            files.any(|file| {
                file.is_ok_and(|file| {
                    file.path().extension().is_some_and(|extension| extension == "toml")
                })
            })
        })
    };
    for (name, decoder) in ALL.into_iter().filter(|(name, _)| is_toml(name)) {
        given(name, decoder, vec((any::<Index>(), hostile()), 1..3), |seed, changes| {
            with_lines_replaced(seed, changes)
        })?;
    }
    Ok(())
}
