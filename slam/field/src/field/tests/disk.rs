//! Files: round trips, resumption, damage.

use std::fs;

use proptest::prelude::*;
use safetensors::SafeTensors;

use super::*;

fn small() -> FieldConfig {
    FieldConfig { levels: vec![4, 6], hidden: 16, ..FieldConfig::default() }
}

/// The bytes of a saved field.
fn saved(field: &NeuralField) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.safetensors");
    field.save(&path).unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing else is left behind");
    fs::read(path).unwrap()
}

/// What reading these bytes as a field gives.
fn loaded(bytes: &[u8]) -> Result<NeuralField, FieldError> {
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), bytes).unwrap();
    NeuralField::load(file.path())
}

#[test]
fn a_field_comes_back_as_it_was() {
    for field in [rough(20), hashed(20)] {
        let back = loaded(&saved(&field)).unwrap();
        assert_eq!(back.parameters, field.parameters);
        assert_eq!(back.config(), field.config());
        let points = points(21, 100, 0.5);
        assert_eq!(values(&back, &points), values(&field, &points));
    }
}

#[test]
fn training_goes_on_as_if_it_had_not_stopped() {
    let config = small();
    let path = tempfile::NamedTempFile::new().unwrap();
    let batch = |step| samples(step, 300, &config, sphere);
    let mut straight = FieldTrainer::new(NeuralField::new(&config, 1).unwrap());
    for step in 0..3 {
        straight.step(&batch(step));
    }
    straight.save(path.path()).unwrap();
    let mut resumed = FieldTrainer::load(path.path()).unwrap();
    assert_eq!(resumed.steps(), 3);
    assert_eq!(NeuralField::load(path.path()).unwrap().parameters, straight.field().parameters);
    for step in 3..6 {
        assert_eq!(straight.step(&batch(step)), resumed.step(&batch(step)));
    }
    assert_eq!(straight.field().parameters, resumed.field().parameters);
}

#[test]
fn a_field_alone_is_no_trainer() {
    let file = tempfile::NamedTempFile::new().unwrap();
    NeuralField::new(&small(), 1).unwrap().save(file.path()).unwrap();
    let message = FieldTrainer::load(file.path()).unwrap_err().to_string();
    assert!(message.contains("mean.grid"), "{message}");
}

/// Where the numbers of a tensor start in the file.
fn start_of(bytes: &[u8], name: &str) -> usize {
    let file = SafeTensors::deserialize(bytes).unwrap();
    file.tensor(name).unwrap().data().as_ptr() as usize - bytes.as_ptr() as usize
}

#[test]
fn damage_is_named() {
    let sealed = saved(&NeuralField::new(&small(), 1).unwrap());
    let message = |bytes: &[u8]| loaded(bytes).unwrap_err().to_string();
    let mut broken = sealed.clone();
    *broken.last_mut().unwrap() ^= 1;
    assert!(message(&broken).contains("checksum"), "{}", message(&broken));
    // Without its checksum, as version 0.1.0 wrote it, so that another check must find the damage.
    let mut bytes = sealed;
    let key = bytes.windows(10).position(|window| window == b"\"checksum\"").unwrap();
    bytes[key..key + 10].copy_from_slice(b"\"unsealed\"");
    for tensor in ["grid", "hidden.weight", "hidden.bias", "output.weight", "output.bias"] {
        let mut broken = bytes.clone();
        let at = start_of(&bytes, tensor);
        broken[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(message(&broken).contains(&format!("tensor {tensor} has NaN")), "{}", message(&broken));
    }
    // The header is text: another name or another size of the same length keeps the rest in place.
    let replaced = |from: &str, to: &str| {
        let header = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut broken = bytes.clone();
        broken[header..header + to.len()].copy_from_slice(to.as_bytes());
        message(&broken)
    };
    assert!(replaced("\"hidden.bias\"", "\"hidden.bios\"").contains("hidden.bias"));
    assert!(replaced("\\\"hidden\\\":16", "\\\"hidden\\\":32").contains("tensor hidden.weight is"));
    assert!(replaced("[4,6]", "[4,9]").contains("tensor grid is"));
    assert!(replaced("[4,6]", "[4,1]").contains("levels"));
    assert!(replaced("\"config\"", "\"konfig\"").contains("there is no config"));
    for length in [0, 7, 100, bytes.len() - 1] {
        assert!(message(&bytes[..length]).contains("written by something else"), "{}", message(&bytes[..length]));
    }
    let missing = NeuralField::load(Path::new("/nonexistent/field")).unwrap_err();
    assert!(matches!(missing, FieldError::File(FileError::Io { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever happens to the bytes, reading gives an error or a field that answers with numbers.
    #[test]
    fn damaged_files_do_not_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), any::<bool>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = saved(&NeuralField::new(&small(), 1).unwrap());
        let header = start_of(&bytes, "grid").min(start_of(&bytes, "hidden.bias"));
        for (index, value, in_header) in changes {
            let length = if in_header { header } else { bytes.len() };
            let at = index.index(length);
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(field) = loaded(&bytes) {
            let finite = field.parameters.table.as_flattened().iter().chain(&field.parameters.network).all(|x| x.is_finite());
            prop_assert!(finite);
            field.distances(&[Vec3::ZERO], &mut [0.0]);
        }
    }
}
