//! The Allegro hand with DIGIT fingertips: kinematics, solids, sensors, the cameras around it, and what it records.

pub mod digit;
pub mod hand;
pub mod observation;
pub mod rig;
