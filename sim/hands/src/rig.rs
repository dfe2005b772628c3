//! Rigs by name: the built-in Allegro, the shipped hands, and hand files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mvt_frames::camera::PosedCamera;
use mvt_robot::hand::{ALLEGRO_DIGIT, Hand, Side};
use mvt_robot::rig::{Placement, UnknownCamera};

use crate::error::HandFileError;
use crate::file::{HandFile, LoadedHand};

impl LoadedHand {
    /// Returns the names of all hands that the program brings along, the built-in one first.
    pub fn names() -> impl Iterator<Item = &'static str> {
        std::iter::once(ALLEGRO_DIGIT).chain(HandFile::shipped())
    }

    /// Returns the built-in hand.
    pub fn allegro(side: Side) -> Self {
        let hand = Hand::allegro(side);
        let fingers = hand.pads().iter().enumerate();
        let fingers = fingers.map(|(pad, of)| (of.name.clone(), hand.pad_chain(pad).to_vec()));
        Self {
            fingers: fingers.collect::<BTreeMap<_, _>>(),
            cameras: Vec::new(),
            model: PathBuf::new(),
            warnings: Vec::new(),
            hand,
        }
    }

    /// Loads a hand by its name or from its file (.toml). `side` chooses the side of the built-in hand, which is the left one by default; of all
    /// others it must be that of the file.
    ///
    /// # Errors
    /// [`HandFileError`] if there is no such hand, its file is invalid, or it has another side.
    pub fn rig(name_or_path: &str, side: Option<Side>) -> Result<Self, HandFileError> {
        if name_or_path == ALLEGRO_DIGIT {
            return Ok(Self::allegro(side.unwrap_or(Side::Left)));
        }
        if !name_or_path.ends_with(".toml") && !HandFile::shipped().any(|name| name == name_or_path) {
            let known = Self::names().collect::<Vec<_>>().join(", ");
            return Err(HandFileError::Unknown { name: name_or_path.to_owned(), known });
        }
        let loaded = HandFile::load(Path::new(name_or_path))?;
        match side.filter(|side| *side != loaded.hand.side()) {
            None => Ok(loaded),
            Some(asked) => {
                Err(HandFileError::Side { hand: loaded.hand.name().to_owned(), side: loaded.hand.side(), asked })
            }
        }
    }

    /// Returns the cameras of a comma-separated list, without repetitions: names of the file's cameras, and places around the hand as
    /// [`Placement::parse_list`] reads them.
    ///
    /// # Errors
    /// [`UnknownCamera`] for any other item.
    pub fn placed(&self, list: &str) -> Result<Vec<PosedCamera>, UnknownCamera> {
        let mut placed: Vec<PosedCamera> = Vec::new();
        for item in list.split(',').map(str::trim) {
            let cameras = match self.cameras.iter().find(|camera| camera.name == item) {
                Some(camera) => vec![camera.clone()],
                None => Placement::parse_list(item)?.iter().map(|place| place.camera(&self.hand)).collect(),
            };
            placed.extend(
                cameras
                    .into_iter()
                    .filter(|new| placed.iter().all(|camera| camera.name != new.name))
                    .collect::<Vec<_>>(),
            );
        }
        Ok(placed)
    }
}

/// Loads a hand as [`LoadedHand::rig`] does, and shows the warnings about it.
///
/// # Errors
/// As [`LoadedHand::rig`].
pub fn load_rig(name_or_path: &str, side: Option<Side>) -> Result<LoadedHand, HandFileError> {
    let rig = LoadedHand::rig(name_or_path, side)?;
    rig.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    Ok(rig)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rigs_are_found_by_name_and_side() {
        assert_eq!(LoadedHand::names().next(), Some(ALLEGRO_DIGIT));
        assert_eq!(LoadedHand::rig(ALLEGRO_DIGIT, None).unwrap().hand, Hand::allegro(Side::Left));
        assert_eq!(LoadedHand::rig(ALLEGRO_DIGIT, Some(Side::Right)).unwrap().hand, Hand::allegro(Side::Right));
        let refused = |name: &str, side| LoadedHand::rig(name, side).unwrap_err().to_string();
        assert!(refused("alegro", None).contains("allegro_digit, leap_digit"));
        let pincer = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/pincer.toml");
        assert!(LoadedHand::rig(pincer, Some(Side::Right)).is_ok());
        assert!(refused(pincer, Some(Side::Left)).contains("right"));
    }

    #[test]
    fn cameras_of_the_file_and_places_are_mixed() {
        let mut rig = LoadedHand::allegro(Side::Left);
        let side = rig.placed("side").unwrap().remove(0);
        rig.cameras.push(PosedCamera { name: "wrist".to_owned(), ..side });
        let names = |list| rig.placed(list).map(|cameras| cameras.into_iter().map(|c| c.name).collect::<Vec<_>>());
        assert_eq!(names("wrist, side,wrist").unwrap(), ["wrist", "side"]);
        assert!(names("elbow").is_err());
    }
}
