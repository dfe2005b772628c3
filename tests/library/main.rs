//! Tests of the crates together: one program, which is linked once.

// The help of a build with fewer features is shorter.
#[cfg(all(feature = "cuda", feature = "foxglove", feature = "onnx", feature = "ros"))]
mod commands_page;
mod golden;
mod random_rigs;
mod segmentation;
