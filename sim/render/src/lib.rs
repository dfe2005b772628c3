//! Rendered sensors: rays, cameras with depth noise, and DIGIT touch images as TACTO renders them.

pub mod camera;
pub mod depth_noise;
pub mod observer;
pub mod rays;
pub mod tessellation;
pub mod touch;
