//! Matrix products for small networks on CPUs.

pub mod instructions;
pub mod math;
pub mod multiply;

pub use instructions::Instructions;
