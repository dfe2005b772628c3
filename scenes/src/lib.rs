//! What the world is made of: typed frames, the hand, the sensors, the objects and the observations that they give.
//!
//! Everything else stands on this crate: `sim`, `perception` and `slam` import it and never one another.

pub mod assets;
pub mod camera;
pub mod catalogue;
pub mod decompose;
pub mod depth;
pub mod digit;
pub mod frame;
pub mod hand;
pub mod mesh;
pub mod mjcf;
pub mod object;
pub mod observation;
pub mod procedural;
