//! Tests of the crate as others use it: one program, which is linked once.

mod assets;
mod catalogue;
mod procedural;
mod random;
mod ycb;
