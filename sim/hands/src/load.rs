//! Reading of hand files with their models.

use std::path::{Path, PathBuf};

use crate::error::{HandFileError, one_line};
use crate::file::{HandFile, LoadedHand};
use crate::model::Model;
use crate::{assemble, leap, mjcf, urdf};

/// Largest hand file that is read, bytes.
const LARGEST_FILE: u64 = 1 << 20;
/// The hands that the program brings along, by name.
const SHIPPED: [(&str, &str); 4] = [
    ("leap_digit", include_str!("../rigs/leap_digit.toml")),
    ("leap_gelsight", include_str!("../rigs/leap_gelsight.toml")),
    ("gripper_gelsight", include_str!("../rigs/gripper_gelsight.toml")),
    ("three_fingers", include_str!("../rigs/three_fingers.toml")),
];
/// Models of these hands that are not fetched, by name.
const SHIPPED_MODELS: [(&str, &str); 2] = [
    ("allegro_right.xml", include_str!("../rigs/allegro_right.xml")),
    ("gripper.xml", include_str!("../rigs/gripper.xml")),
];
/// First letters of the path of a model in the package of the LEAP hand.
const IN_LEAP: &str = "leap:";

impl HandFile {
    /// Returns the names of the hands that the program brings along.
    pub fn shipped() -> impl Iterator<Item = &'static str> {
        SHIPPED.into_iter().map(|(name, _)| name)
    }

    /// Reads the hand of a shipped name or of a file, with its model, meshes and profiles.
    ///
    /// # Errors
    /// [`HandFileError`] names the file that is at fault, and says what to do.
    pub fn load(name_or_path: impl AsRef<Path>) -> Result<LoadedHand, HandFileError> {
        let path = name_or_path.as_ref();
        let file = Self::read(path)?;
        let (model_path, model) = file.read_model(path)?;
        assemble::assemble(&file, model, path, model_path)
    }

    /// Reads the TOML file alone.
    ///
    /// # Errors
    /// [`HandFileError`] if the file cannot be read, or is not a hand file.
    pub fn read(name_or_path: impl AsRef<Path>) -> Result<Self, HandFileError> {
        let path = name_or_path.as_ref();
        let text = match shipped(path) {
            Some(text) => text.to_owned(),
            None => mvt_files::input::read_text(path, LARGEST_FILE)
                .map_err(|source| HandFileError::Read { path: path.to_owned(), source })?,
        };
        toml::from_str(&text).map_err(|error| {
            let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
            let line = before.matches('\n').count() + 1;
            HandFileError::Format { path: path.to_owned(), line, reason: one_line(error.message()) }
        })
    }

    /// Reads the model of the hand file at `path`.
    fn read_model(&self, path: &Path) -> Result<(PathBuf, Model), HandFileError> {
        let model = match self.model.strip_prefix(IN_LEAP) {
            Some(name) => leap::leap_folder()?.join(name),
            None => path.with_file_name(&self.model),
        };
        let fault = HandFileError::model(&model);
        let brought = SHIPPED_MODELS.into_iter().find(|(name, _)| shipped(path).is_some() && self.model == *name);
        if let Some((_, text)) = brought {
            let content = mjcf::parse(text).map_err(fault)?;
            return Ok((model, content));
        }
        let ending = model.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
        let content = match ending.as_str() {
            "xml" | "mjcf" => mjcf::read(&model).map_err(fault)?,
            "urdf" => urdf::read(&model).map_err(fault)?,
            "xacro" => {
                return Err(fault("a xacro is no URDF yet; write it with `xacro hand.xacro > hand.urdf`".to_owned()));
            }
            _ => return Err(fault("the model of a hand is an MJCF (.xml) or a URDF (.urdf)".to_owned())),
        };
        Ok((model, content))
    }
}

/// Returns the text of a hand file that the program brings along.
fn shipped(path: &Path) -> Option<&'static str> {
    SHIPPED.into_iter().find(|(name, _)| path.to_str() == Some(name)).map(|(_, text)| text)
}
