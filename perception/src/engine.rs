//! Inference on the CPU.

mod instructions;
mod math;
mod multiply;

pub use instructions::Instructions;
