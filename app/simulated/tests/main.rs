//! Tests of the crate as others use it: one program, which is linked once.

mod frame_rates;
mod sensors;
mod shear;
