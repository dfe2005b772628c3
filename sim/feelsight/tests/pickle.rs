//! Pickles: those of Python, round trips, and hostile files.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common;
use mvt_feelsight::array::{Array, Kind};
use mvt_feelsight::pickle::{PickleError, PickleValue, from_bytes, to_bytes};
use proptest::prelude::*;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Checks the value that write_pickles.py pickles.
fn check(value: &PickleValue) {
    let get = |key: &str| value.get(key).unwrap_or_else(|| panic!("{key}"));
    let tensor = |value: &PickleValue| value.to_tensor().expect("numbers");
    assert_eq!(get("none"), &PickleValue::None);
    assert_eq!(get("bools"), &PickleValue::List(vec![PickleValue::Bool(true), PickleValue::Bool(false)]));
    let ints = [0, 255, 65535, -1, (1 << 31) - 1, -(1 << 31), 1 << 40, i64::MIN, i64::MAX];
    assert_eq!(get("ints"), &PickleValue::List(ints.map(PickleValue::Int).to_vec()));
    assert_eq!(
        get("floats"),
        &PickleValue::List([0.0, -1.5, 1e300, f64::INFINITY, 0.1].map(PickleValue::Float).to_vec())
    );
    assert_eq!(get("text").as_str(), Some("gü€😀 \\u0041 'quoted'\n"));
    assert_eq!(get("bytes"), &PickleValue::Bytes((0..=255).collect()));
    let empty = [
        PickleValue::List(vec![]),
        PickleValue::Tuple(vec![]),
        PickleValue::Dict(vec![]),
        "".into(),
        PickleValue::Bytes(vec![]),
    ]
    .to_vec();
    assert_eq!(get("empty"), &PickleValue::List(empty));
    let PickleValue::Tuple(tuples) = get("tuples") else { panic!("tuples") };
    assert_eq!((tuples.len(), &tuples[1]), (4, &PickleValue::Tuple(vec![PickleValue::Int(2), PickleValue::Int(3)])));
    assert_eq!(get("ordered").get("a"), Some(&PickleValue::Int(2)));
    let quarters = vec![0.0, 0.25, 0.5, 0.75, 1.0, 1.25];
    for key in ["matrix", "fortran", "big"] {
        assert_eq!(tensor(get(key)), (vec![2, 3], quarters.clone()), "{key}");
    }
    let PickleValue::List(kinds) = get("kinds") else { panic!("kinds") };
    assert_eq!(kinds.len(), 12);
    assert!(kinds.iter().all(|kind| tensor(kind) == (vec![3], vec![1.0, 0.0, 1.0])));
    let PickleValue::List(scalars) = get("scalars") else { panic!("scalars") };
    let scalars: Vec<_> = scalars.iter().map(|scalar| scalar.to_number().unwrap()).collect();
    assert_eq!(scalars, [0.25, 0.5, -7.0, 200.0, 1.0]);
    assert_eq!(tensor(get("zero")), (vec![], vec![2.5]));
    assert_eq!(tensor(get("hollow")), (vec![0, 4], vec![]));
    assert_eq!(tensor(get("view")), (vec![4], vec![0.0, 3.0, 6.0, 9.0]));
    assert_eq!(tensor(get("shared")), (vec![3, 2, 3], quarters.repeat(3)));
}

#[test]
fn every_protocol_of_python_is_read() {
    // Written by write_pickles.py under NumPy 1.26 and 2.4.
    for tag in ["numpy1", "numpy2"] {
        for protocol in 0..6 {
            let name = format!("{tag}-{protocol}.pkl");
            let value = from_bytes(&fs::read(data(&name)).unwrap()).unwrap_or_else(|e| panic!("{name}: {e}"));
            check(&value);
            assert_eq!(from_bytes(&to_bytes(&value)).unwrap(), value);
        }
    }
}

/// Whether there is a Python with NumPy. Without it the test is skipped.
fn python() -> bool {
    let found = Command::new("python3").args(["-c", "import numpy"]).output().is_ok_and(|o| o.status.success());
    if !found {
        common::skip("there is no python3 with NumPy on the path");
    }
    found
}

fn run(script: &str, arguments: &[&str]) {
    let output = Command::new("python3").arg("-W").arg("error").arg(data(script)).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn this_machines_python_is_understood() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    run("write_pickles.py", &[folder.path().to_str().unwrap(), "here"]);
    for protocol in 0..6 {
        check(&from_bytes(&fs::read(folder.path().join(format!("here-{protocol}.pkl"))).unwrap()).unwrap());
    }
}

#[test]
fn this_machines_python_reads_a_log() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    common::write(&place, 5, &[common::camera("front-left", 64, 48), common::camera("top-down", 40, 30)]);
    let pose = (common::object_pose(0) * common::object_from_file()).to_matrix();
    let pose: Vec<_> = pose.iter().flatten().map(|x| format!("{x:e}")).collect();
    run("check_log.py", &[place.to_str().unwrap(), &pose.join(" ")]);
}

fn refusal(pickle: &[u8]) -> PickleError {
    from_bytes(pickle).unwrap_err()
}

#[test]
fn nothing_is_executed() {
    for (pickle, name) in [
        (&b"cos\nsystem\n(S'touch harm'\ntR."[..], "os.system"),
        (b"\x80\x04\x8c\x05posix\x8c\x06system\x93\x8c\x02id\x85R.", "posix.system"),
        (b"(S'id'\nios\nsystem\n.", "os.system"),
        (b"\x80\x02c__builtin__\neval\n(X\x01\0\0\x001tR.", "__builtin__.eval"),
        (b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n.", "torch._utils._rebuild_tensor_v2"),
        (b"\x80\x02cnumpy\nload\n.", "numpy.load"),
        (b"\x80\x02cdill._dill\n_create_type\n.", "dill._dill._create_type"),
    ] {
        assert_eq!(refusal(pickle), PickleError::Refused(name.into()));
    }
    // Globals that are named and never called are refused, too. So are extension codes, persistent ids, sets and object
    // arrays.
    for pickle in [&b"cnumpy\nndarray\n."[..], b"\x80\x02cnumpy\ndtype\n(X\x02\0\0\0O8K\0K\x01tR."] {
        assert!(matches!(refusal(pickle), PickleError::Refused(_)));
    }
    for pickle in [&b"\x80\x02\x82\x01."[..], b"Pid\n.", b"\x80\x04\x8f."] {
        assert!(matches!(refusal(pickle), PickleError::Opcode { .. }));
    }
}

#[test]
fn greed_is_refused() {
    // A list that contains itself; nested lists of ten items each: 10^30 values in 400 bytes.
    assert!(matches!(refusal(b"\x80\x02]q\0h\0a."), PickleError::TooLarge(_)));
    let mut laughs = b"\x80\x02]q\0".to_vec();
    for level in 0..30u8 {
        laughs.push(b'(');
        (0..10).for_each(|_| laughs.extend([b'h', level]));
        laughs.extend([b'l', b'q', level + 1]);
    }
    laughs.push(b'.');
    assert!(matches!(refusal(&laughs), PickleError::TooLarge(_)));
    // Nesting deeper than any stack.
    let deep = [vec![b']'; 3_000_000], vec![b'a'; 2_999_999], b".".to_vec()].concat();
    assert!(matches!(refusal(&deep), PickleError::TooLarge(_)));
    // An array that is referred to a thousand times, of a megabyte each.
    let array = Array::from_f64(vec![1 << 17], std::iter::repeat_n(1.0, 1 << 17));
    let mut many = to_bytes(&PickleValue::List(vec![array.into()]));
    many.truncate(many.len() - 2);
    many.extend(b"q\x50");
    many.extend(b"h\x50".repeat(1000));
    many.extend(b"e.");
    assert!(matches!(refusal(&many), PickleError::TooLarge(_)));
    // Lengths beyond the end of the data.
    for pickle in
        [&b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\xff."[..], b"\x80\x02X\xff\xff\xff\xff.", b"\x80\x03B\0\0\0\x80"]
    {
        assert!(matches!(refusal(pickle), PickleError::Truncated(_)));
    }
    assert!(from_bytes(&vec![b'N'; 5_000_000]).is_err());
    assert!(from_bytes(&vec![b'('; 5_000_000]).is_err());
}

fn value() -> impl Strategy<Value = PickleValue> {
    let kinds = [Kind::Bool, Kind::I8, Kind::I16, Kind::U32, Kind::I64, Kind::U64, Kind::F16, Kind::F32, Kind::F64];
    let array = (prop::sample::select(kinds.to_vec()), prop::collection::vec(0usize..4, 0..4)).prop_flat_map(
        |(kind, shape)| {
            let bytes = shape.iter().product::<usize>() * kind.size();
            prop::collection::vec(any::<u8>(), bytes)
                .prop_map(move |data| Array::from_raw(kind, false, false, shape.clone(), &data).unwrap())
        },
    );
    let leaf = prop_oneof![
        Just(PickleValue::None),
        any::<bool>().prop_map(PickleValue::Bool),
        any::<i64>().prop_map(PickleValue::Int),
        (-1000i64..1000).prop_map(PickleValue::Int),
        prop::num::f64::NORMAL.prop_map(PickleValue::Float),
        any::<String>().prop_map(PickleValue::Str),
        prop::collection::vec(any::<u8>(), 0..300).prop_map(PickleValue::Bytes),
        array.prop_map(PickleValue::Array),
    ];
    leaf.prop_recursive(4, 60, 8, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..8).prop_map(PickleValue::List),
            prop::collection::vec(inner.clone(), 0..8).prop_map(PickleValue::Tuple),
            prop::collection::vec((any::<String>().prop_map(PickleValue::Str), inner), 0..8)
                .prop_map(PickleValue::Dict),
        ]
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn values_come_back(value in value()) {
        prop_assert_eq!(from_bytes(&to_bytes(&value)).unwrap(), value);
    }

    #[test]
    fn noise_is_survived(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = from_bytes(&bytes);
    }

    /// Noise that is made of opcodes goes deeper.
    #[test]
    fn noise_of_opcodes_is_survived(
        bytes in prop::collection::vec(
            prop::sample::select(&b"(.012FIJKLMNRSTUVXabcdeghjlpqrstu])}G\x80\x85\x86\x87\x88\x89\x8a\x8c\x8e\x93\x94\x95\x96\0\x01\x02\n'5"[..]),
            0..300,
        )
    ) {
        let _ = from_bytes(&bytes);
    }
}
