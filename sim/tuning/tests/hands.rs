//! Searches for a hand that is not built in.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use std::sync::Arc;

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::controller_file::{self, ControllerFile};
use mvt_gaits::gait;
use mvt_robot::hand::{Hand, PartSurface, Side};
use mvt_tuning::search::{Search, SearchError, SearchSettings};

/// Returns a hand with pads on two of its fingers.
fn two_pads(side: Side) -> Arc<Hand> {
    let mut description = Hand::allegro(side).description().clone();
    description.name = "two".to_owned();
    let kept = [description.pads[0].clone(), description.pads[3].clone()];
    description.pads = kept.to_vec();
    for part in description.bodies.iter_mut().flat_map(|body| &mut body.parts) {
        part.surface = match part.surface {
            PartSurface::Gel(1 | 2) => PartSurface::Housing,
            PartSurface::Gel(3) => PartSurface::Gel(1),
            surface => surface,
        };
    }
    Hand::new(description).unwrap()
}

fn settings() -> SearchSettings {
    SearchSettings {
        objects: vec!["cube70".to_owned()],
        axis: TurnAxis::MinusY,
        duration_s: 0.2,
        starts: 1,
        sufficient_rate_rad_s: None,
        population: 4,
        sigma: 0.3,
        only: vec![],
        seed: 5,
    }
}

#[test]
fn a_search_finds_a_gait_that_its_hand_plays() {
    let (hand, from) = (two_pads(Side::Right), gait::find("tumble_back").unwrap().1);
    let cube = mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();
    assert!(Search::has_parameter(from, &hand, "sin_thumb") && !Search::has_parameter(from, &hand, "sin_ring"));
    let folder = tempfile::tempdir().unwrap();
    let (state, file) = (folder.path().join("a.state"), folder.path().join("a.toml"));
    let mut search = Search::new(settings(), from, &hand);
    search.advance(std::slice::from_ref(&cube)).unwrap();
    search.save(&state).unwrap();
    assert_eq!(Search::resume(&state, settings(), from, &hand).unwrap(), search);
    let other = Search::resume(&state, settings(), from, &Hand::allegro(Side::Right));
    assert!(matches!(other, Err(SearchError::Other { .. })));
    let found = search.gait("");
    // The fingers without pads rest.
    assert!(found.table.iter().all(|row| row[4..12] == from.open_pose[4..12] && row.len() == 16));
    assert_ne!(found.table[0][12..], found.table[9][12..]);
    let text = toml::to_string(&ControllerFile::new(found.clone(), std::slice::from_ref(&cube), &hand)).unwrap();
    std::fs::write(&file, text).unwrap();
    let chosen = controller_file::choose(file.to_str().unwrap(), &cube, &hand).unwrap();
    assert_eq!(chosen.gait, found);
}

#[test]
fn the_mirror_image_of_a_hand_has_the_same_gaits() {
    for name in ["tumble_back", "low", "air_ball"] {
        let from = gait::find(name).unwrap().1;
        let [left, right] = [Side::Left, Side::Right]
            .map(|side| Search::new(settings(), from, &two_pads(side)).gait(""))
            .map(|gait| gait.table.into_iter().flatten().collect::<Vec<f64>>());
        assert_eq!(left.len(), right.len());
        assert!(left.iter().zip(&right).all(|(l, r)| (l - r).abs() < 2e-5), "{name}");
    }
}
