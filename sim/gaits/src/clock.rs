//! Rates of an episode.

// Why: notes/decisions/simulation.md, "Physics at 300 Hz".
/// Integration steps per second. A multiple of both other rates, so that every sample falls on a step.
pub const PHYSICS_HZ: u32 = 300;
/// Commands of the controller per second.
pub const CONTROL_HZ: u32 = 25;
/// Camera and touch images per second.
pub const FRAME_HZ: u32 = 30;
