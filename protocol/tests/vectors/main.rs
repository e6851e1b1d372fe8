//! What is written from the definitions of the messages is what the tree has: test vectors, tables
//! of WIRE.md, layout in memory, and messages of the Python client.
//!
//! `cargo test --workspace --test vectors -- --ignored` writes all of it anew, and the seeds of the
//! fuzzer that are made of the vectors. A difference is a change of the protocol.

mod examples;
mod python;
mod wire_document;

use examples::Examples;
use protocol::message::{
    Command, Credit, Goal, Health, Message, ModelSnapshot, Obstacles, Plan, PlantState,
    ResidualSample, Truth,
};
use protocol::topic::{OnTopic, Visit, visit_all};
use protocol::{VERSION, frame, wire};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

type Outcome = Result<(), Box<dyn Error>>;

/// The message as a sink leaves it, and its bytes.
fn encoded<T: Message>(mut message: T) -> (T, Vec<u8>) {
    (message.stamp_mut().version, message.stamp_mut().kind) = (VERSION, T::KIND);
    let mut bytes = Vec::new();
    message.stamp_mut().checksum = wire::encode(&message, &mut bytes);
    (message, bytes)
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut hex, byte| {
        // Writing to a string does not fail.
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

#[derive(Serialize)]
struct File {
    message: &'static str,
    kind: u16,
    version: u16,
    vectors: Vec<Vector>,
}

#[derive(Serialize)]
struct Vector {
    name: &'static str,
    fields: Value,
    bytes: String,
}

/// The test vectors of `T`, as in its file.
fn vectors<T: Examples>() -> Result<String, serde_json::Error> {
    let vector = |(name, message): (&'static str, T)| {
        let (message, bytes) = encoded(message);
        Vector { name, fields: message.in_json(), bytes: hexadecimal(&bytes) }
    };
    let vectors = T::examples().into_iter().map(vector).collect();
    let file = File { message: T::NAME, kind: T::KIND, version: VERSION, vectors };
    Ok(serde_json::to_string_pretty(&file)? + "\n")
}

fn here() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Does something with every message that has a topic.
macro_rules! for_every_message {
    ($act:ident($($argument:expr),*)) => {
        $act::<PlantState>($($argument),*)?;
        $act::<Command>($($argument),*)?;
        $act::<ResidualSample>($($argument),*)?;
        $act::<Credit>($($argument),*)?;
        $act::<Truth>($($argument),*)?;
        $act::<Plan>($($argument),*)?;
        $act::<Health>($($argument),*)?;
        $act::<ModelSnapshot>($($argument),*)?;
        $act::<Goal>($($argument),*)?;
        $act::<Obstacles>($($argument),*)?;
    };
}

/// Every file that is written from the definitions, with its content.
fn written() -> Result<BTreeMap<PathBuf, String>, Box<dyn Error>> {
    fn add<T: Examples>(files: &mut BTreeMap<PathBuf, String>) -> Outcome {
        files.insert(here().join(format!("vectors/{}.json", T::NAME)), vectors::<T>()?);
        Ok(())
    }
    let mut files = BTreeMap::new();
    for_every_message!(add(&mut files));
    files.insert(here().join("vectors/layout.json"), layout()?);
    let document = here().join("WIRE.md");
    let text = wire_document::with_tables(&fs::read_to_string(&document)?)?;
    files.insert(document, text);
    files.insert(here().join("../deploy/clients/python/coxswain/messages.py"), python::messages());
    Ok(files)
}

/// Place of each field of each message in memory \[bytes\].
fn layout() -> Result<String, serde_json::Error> {
    #[derive(Default)]
    struct Layout(BTreeMap<&'static str, Value>);
    impl Visit for Layout {
        fn visit<T: OnTopic>(&mut self) {
            let fields: BTreeMap<_, _> =
                T::fields().iter().map(|field| (field.name, field.offset)).collect();
            self.0.insert(T::NAME, json!({"kind": T::KIND, "fields": fields}));
        }
    }
    let mut layout = Layout::default();
    visit_all(&mut layout);
    Ok(serde_json::to_string_pretty(&layout.0)? + "\n")
}

#[test]
fn every_message_has_the_bytes_fields_and_layout_that_are_written_down() -> Outcome {
    for (path, text) in written()? {
        let there = fs::read_to_string(&path)?;
        assert_eq!(there, text, "{}: see the first lines of this test", path.display());
    }
    Ok(())
}

#[test]
fn every_vector_is_read_as_the_message_that_it_was() -> Outcome {
    fn come_back<T: Examples>() -> Outcome {
        for (name, message) in T::examples() {
            let (message, bytes) = encoded(message);
            assert_eq!(wire::decode::<T>(&bytes)?, message, "{} {name}", T::NAME);
        }
        Ok(())
    }
    for_every_message!(come_back());
    Ok(())
}

#[test]
fn every_kind_is_used_once() {
    #[derive(Default)]
    struct Kinds(Vec<u16>);
    impl Visit for Kinds {
        fn visit<T: OnTopic>(&mut self) {
            self.0.push(T::KIND);
        }
    }
    let mut kinds = Kinds::default();
    visit_all(&mut kinds);
    kinds.0.sort_unstable();
    assert_eq!(kinds.0, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
}

#[test]
#[ignore = "writes the files, see above"]
fn write_files() -> Outcome {
    for (path, text) in written()? {
        fs::write(path, text)?;
    }
    for_every_message!(write_seeds());
    Ok(())
}

/// Writes the seeds of the fuzzer that are made of the vectors, where there are such seeds.
fn write_seeds<T: Examples>() -> Outcome {
    let corpus = here().join("../tests/fuzz/corpus");
    for (name, message) in T::examples() {
        let (message, wire) = encoded(message);
        let mut framed = vec![0; message.byte_len()];
        frame::encode(&message, &mut framed);
        for (decoder, bytes) in [("frame", framed), ("wire", wire)] {
            let seed = corpus.join(decoder).join(format!("{}-{name}", T::NAME.to_lowercase()));
            if seed.exists() {
                fs::write(seed, bytes)?;
            }
        }
    }
    Ok(())
}
