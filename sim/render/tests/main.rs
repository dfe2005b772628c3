//! Tests of the crate as others use it: one program, which is linked once.

mod observer;
mod rays;
mod touch;
mod touch_parity;
