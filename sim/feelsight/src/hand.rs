//! The hand of a log or recording: in its JSON and in data.pkl.
//!
//! Files hold only the side of an Allegro with TACTO's DIGITs, and the whole [`HandDescription`] of any other hand.

use std::sync::Arc;

use mvt_frames::{HandBase, Isometry, World};
use mvt_robot::hand::{Hand, HandDescription, HandError, Side};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use serde_json::Value;

/// Returns the description of a hand that files hold; `None` for the Allegro with TACTO's DIGITs, of which they hold only the side.
pub fn stored(hand: &Hand) -> Option<&HandDescription> {
    (*hand != *Hand::allegro(hand.side())).then(|| hand.description())
}

/// Returns the hand of a file: the described one, or the Allegro of this side.
///
/// # Errors
/// [`HandError`] if the description is not that of a hand.
pub fn restored(side: Side, description: Option<HandDescription>) -> Result<Arc<Hand>, HandError> {
    description.map_or_else(|| Ok(Hand::allegro(side)), Hand::new)
}

/// Returns the pose of the hand's base.
pub fn world_from_base(hand: &Hand) -> Isometry<HandBase, World> {
    hand.bodies().first().map_or_else(Isometry::identity, |base| base.place.isometry())
}

/// Returns the name of a pad; empty if there is no such pad.
pub(crate) fn pad_name(hand: &Hand, pad: usize) -> &str {
    hand.pads().get(pad).map_or("", |pad| &pad.name)
}

/// Returns width and height of a pad's images, pixels. A pad that does not exist has none.
pub(crate) fn pad_size(hand: &Hand, pad: usize) -> (usize, usize) {
    hand.pads().get(pad).map_or((0, 0), |pad| pad.profile.size_px.into())
}

/// Returns the folder of a pad's images in a log. FeelSight fixes the name of the folder around it.
pub(crate) fn pad_folder(hand: &Hand, pad: usize) -> String {
    format!("allegro/{}", pad_name(hand, pad))
}

/// Writes the side of an Allegro with TACTO's DIGITs or the description of another hand. For `serde(with)`.
pub(crate) fn serialize<S: Serializer>(hand: &Arc<Hand>, serializer: S) -> Result<S::Ok, S::Error> {
    match stored(hand) {
        Some(description) => description.serialize(serializer),
        None => hand.side().serialize(serializer),
    }
}

/// Reads what [`serialize`] writes.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Arc<Hand>, D::Error> {
    from_value(Value::deserialize(deserializer)?).map_err(de::Error::custom)
}

/// Returns the hand of the description in a JSON text.
pub(crate) fn from_text(text: &str) -> Result<Arc<Hand>, String> {
    from_value(serde_json::from_str(text).map_err(|error| one_line(&error))?)
}

fn from_value(value: Value) -> Result<Arc<Hand>, String> {
    if value.is_object() {
        let description: HandDescription = serde_json::from_value(value).map_err(|error| one_line(&error))?;
        Hand::new(description).map_err(|error| one_line(&error))
    } else {
        serde_json::from_value(value).map(Hand::allegro).map_err(|error| one_line(&error))
    }
}

/// Names in a description may hold line ends.
fn one_line(error: &dyn std::error::Error) -> String {
    error.to_string().replace(char::is_control, " ")
}
