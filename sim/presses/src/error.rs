//! Reasons why presses cannot be drawn.

use mvt_render::touch::TouchError;

/// Error of another crate, whose type does not matter here.
type Reason = Box<dyn std::error::Error + Send + Sync>;

/// Reason why presses cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PressError {
    /// No objects for training or no objects for validation are named.
    #[error("data.objects must name some of each: objects for training and for validation")]
    EmptySet,
    /// The catalogue does not have an object.
    #[error("data.objects: {0}")]
    Unknown(Reason),
    /// An object of the test set is named.
    #[error("data.objects: {0} is kept for tests, no network is trained or chosen by it; remove it")]
    KeptForTests(String),
    /// An object is in both sets.
    #[error("data.objects: {0} is in the sets for training and for validation; remove it from one")]
    InBothSets(String),
    /// The mesh of an object cannot be loaded.
    #[error("cannot load {name}: {reason}")]
    Load {
        /// Name of the object.
        name: String,
        /// Reason of the catalogue.
        reason: Reason,
    },
    /// The options of a sensor are out of range.
    #[error(transparent)]
    Touch(#[from] TouchError),
    /// A background cannot be encoded as JPEG and decoded.
    #[error("cannot encode a background: {0}")]
    Image(#[from] image::ImageError),
}
