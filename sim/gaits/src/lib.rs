//! What moves the hand: gaits, the directives that change them, and the rates of an episode.

pub mod clock;
pub mod controller;
pub mod directive;
pub mod gait;
