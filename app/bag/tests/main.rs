//! Tests of the crate as others use it: one program, which is linked once.

mod common;

mod bags;
mod faults;
