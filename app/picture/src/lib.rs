//! Pictures on the CPU.

pub mod lettering;
