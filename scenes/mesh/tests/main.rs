//! Tests of the crate as others use it: one program, which is linked once.

mod prism;

mod foreign;
mod readers;
mod shapes;
