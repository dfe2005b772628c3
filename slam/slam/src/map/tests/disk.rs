//! Maps on disk: what comes back, and damage.

use std::fs;
use std::sync::LazyLock;

use proptest::prelude::*;

use super::*;

fn learnt() -> Map {
    // Poses that are refined later would have space differ, which is filled from them as they are.
    let mut map = map(&MapConfig { refined_per_s: 0.0, ..quick().0 });
    learn(&mut map, 12, 5.0, turned(5.0));
    map
}

fn loaded(folder: &std::path::Path) -> Result<Map, field::FieldError> {
    Map::load(folder, quick().0, Obstacles::default())
}

#[test]
fn a_map_comes_back_as_it_was() {
    let map = learnt();
    let folder = tempfile::tempdir().unwrap();
    map.save(folder.path()).unwrap();
    let back = loaded(folder.path()).unwrap();
    assert_in_order(&back);
    assert_eq!(back.keyframes.len(), map.keyframes.len());
    let last_s = map.keyframes.last().unwrap().scan().time_s;
    for (was, is) in map.keyframes.iter().zip(&back.keyframes) {
        assert_eq!(was.scan().views, is.scan().views);
        assert_eq!(was.scan().obstacles, is.scan().obstacles);
        assert!((was.scan().time_s - last_s - is.scan().time_s).abs() < 1e-12);
        assert!((was.pose().untyped().inverse() * is.pose().untyped()).translation.vector.norm() < 1e-12);
        assert!(was.pose().untyped().rotation.angle_to(&is.pose().untyped().rotation) < 1e-6);
    }
    assert_eq!(back.space.bounds(), map.space.bounds());
    assert_eq!(back.unseen, map.unseen);
    let points: Vec<Vec3> = (0..100).map(|i| Vec3::splat(0.001 * i as f32 - 0.05)).collect();
    let distances = |map: &Map| {
        let mut out = vec![0.0; points.len()];
        map.distances(&points, &mut out);
        out
    };
    assert_eq!(distances(&back), distances(&map));
    assert_eq!(back.field_from_model(), Isometry::identity());
}

#[test]
fn seen_surface_has_a_deviation_and_the_rest_is_a_guess() {
    let mut map = map(&MapConfig { first_steps: 150, steps_per_s: 600.0, batch: 512, refined_per_s: 0.0, ..quick().0 });
    learn(&mut map, 6, 5.0, turned(5.0));
    let folder = tempfile::tempdir().unwrap();
    map.save(folder.path()).unwrap();
    let back = Map::load_shape(folder.path()).unwrap();
    let first = &map.keyframes[0];
    let view = &first.scan().views[0];
    let seen: Vec<Vec3> = view.hits.iter().map(|hit| first.to_field(view.point(hit))).collect();
    let deviations_m = back.vertex_deviations_m(&seen);
    assert!(deviations_m.iter().flatten().count() * 10 >= 9 * seen.len(), "{deviations_m:?}");
    assert_eq!(deviations_m, map.vertex_deviations_m(&seen));
    assert_eq!(back.vertex_deviations_m(&[Vec3::ZERO, Vec3::splat(0.06)]), [None, None]);
    // Points that lie 3 mm nearer to the camera than where they were learnt.
    let mean = |of: &[Option<f32>]| of.iter().flatten().sum::<f32>() / of.iter().flatten().count() as f32;
    let away = 0.003 * view.hits[0].direction;
    for keyframe in &mut map.keyframes {
        let shift = na::Isometry3::translation(away.x.into(), away.y.into(), away.z.into());
        keyframe.set_pose(Isometry::new(shift * keyframe.pose().untyped()));
    }
    let moved_m = mean(&map.vertex_deviations_m(&seen));
    assert!(mean(&deviations_m) < 0.0015 && moved_m > 0.0018, "{} {moved_m}", mean(&deviations_m));
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let message = || loaded(folder.path()).err().unwrap().to_string();
    assert!(message().contains("field.safetensors"), "{}", message());
    let map = learnt();
    map.save(folder.path()).unwrap();
    fs::copy(folder.path().join(Map::FILES[0]), folder.path().join(Map::FILES[1])).unwrap();
    assert!(message().contains("keyframes.safetensors: tensor layout"), "{}", message());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever happens to the bytes, reading gives an error or keyframes.
    #[test]
    fn damaged_keyframes_do_not_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
            let mut map = map(&quick().0);
            learn(&mut map, 2, 10.0, turned(10.0));
            let folder = tempfile::tempdir().unwrap();
            map.save(folder.path()).unwrap();
            fs::read(folder.path().join(Map::FILES[1])).unwrap()
        });
        let mut bytes = WHOLE.clone();
        // The header, the start of the data (small tensors lie anywhere), or any byte.
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        for (index, value, place) in changes {
            let range = [0..header, header..header + 2000, 0..bytes.len()][usize::from(place)].clone();
            let at = range.start + index.index(range.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(file.path(), bytes).unwrap();
        if let Ok(keyframes) = super::super::file::read(file.path(), Some(0)) {
            prop_assert!(keyframes.iter().all(|(scan, _)| scan.time_s.is_finite()));
        }
    }
}
