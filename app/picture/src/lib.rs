//! Pictures on the CPU.

pub mod contact_sheet;
pub mod lettering;
