//! Tests of the crate as others use it: one program, which is linked once.

mod air;
mod camera;
mod directive;
mod hands;
mod random_objects;
mod schedule;
mod simulation;
