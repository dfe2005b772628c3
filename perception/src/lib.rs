//! Pixels to metric geometry.
//!
//! Will turn the touch images of an [`Observation`](scenes::observation::Observation) into metric depth and contact masks.
//! The networks and their engine land with a later version; nothing here knows of the simulator.
