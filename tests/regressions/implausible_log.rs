//! `inspect` accepted joint angles, poses and times that cannot be, and never compared camera depth with the true pose.

use std::fs;

use mvt_feelsight::array::Array;
use mvt_feelsight::pickle::{self, PickleValue};

use crate::workplace::Workplace;

const LOG: &str = "set/cube70/00";

/// Changes one array of data.pkl, named by its keys.
fn change(data: &PickleValue, keys: &[&str], edit: &dyn Fn(&mut Vec<f64>)) -> PickleValue {
    let Some((key, rest)) = keys.split_first() else {
        let (shape, mut numbers) = data.to_tensor().unwrap();
        edit(&mut numbers);
        return Array::from_f64(shape, numbers).into();
    };
    let PickleValue::Dict(entries) = data else { panic!("no dictionary at {key}") };
    let edited = entries.iter().map(|(name, value)| {
        let is_it = name.as_str() == Some(key);
        (name.clone(), if is_it { change(value, rest, edit) } else { value.clone() })
    });
    PickleValue::Dict(edited.collect())
}

#[test]
fn values_that_cannot_be_are_refused() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.4 --cameras side --out set").good();
    let path = workplace.path(LOG).join("data.pkl");
    let whole = fs::read(&path).unwrap();
    let data = pickle::from_bytes(&whole).unwrap();
    let first_to = |value: f64| move |numbers: &mut Vec<f64>| numbers[0] = value;
    let moved_to = |value: f64| move |numbers: &mut Vec<f64>| numbers[3] = value;
    for (keys, edit, part) in [
        (&["allegro", "joint_state"][..], &first_to(1e300) as &dyn Fn(&mut Vec<f64>), "joint angle"),
        (&["object", "pose"], &moved_to(1e300), "object"),
        (&["realsense", "side", "pose"], &moved_to(1e6), "camera side"),
        (&["time"], &|times: &mut Vec<f64>| times.iter_mut().for_each(|t| *t *= 1e12), "seconds"),
    ] {
        fs::write(&path, pickle::to_bytes(&change(&data, keys, edit))).unwrap();
        for line in [format!("inspect {LOG}"), format!("run --log {LOG} --out r")] {
            let said = workplace.run(&line).error();
            assert!(said.contains("data.pkl") && said.contains(part), "{line}: {said}");
        }
    }
    // A camera that stands 40 mm beside the recorded place.
    fs::write(&path, &whole).unwrap();
    assert!(!workplace.run(&format!("inspect {LOG}")).good().contains("beside its true surface"));
    let shift = |numbers: &mut Vec<f64>| numbers[11] += 0.04;
    fs::write(&path, pickle::to_bytes(&change(&data, &["realsense", "side", "pose"], &shift))).unwrap();
    let said = workplace.run(&format!("inspect {LOG}")).good();
    assert!(said.contains("camera side") && said.contains("beside its true surface"), "{said}");
}
