//! Tests of the crates together: one program, which is linked once.

mod golden;
mod random_rigs;
mod segmentation;
