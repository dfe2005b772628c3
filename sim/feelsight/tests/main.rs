//! Tests of the crate as others use it: one program, which is linked once.

mod common;

mod compact;
mod depth;
mod foreign;
mod hands;
mod log;
mod pickle;
