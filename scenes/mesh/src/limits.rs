//! Sizes of files and meshes that are accepted.

/// Size of the largest mesh file that is read, bytes: 1.3 million triangles of binary STL. A hand-sized object needs a
/// hundredth.
pub const MAX_FILE_BYTES: u64 = 64 << 20;
/// Largest side above which the coordinates of a file are taken for millimetres, metres: a hand can neither turn an
/// object of one metre nor grip one of one millimetre.
pub const MILLIMETRES_ABOVE_M: f64 = 1.0;
/// Largest side above which the coordinates of a file are millimetres and not centimetres: no object that a hand turns is longer than
/// 350 mm, or shorter than 35 mm. Between [`MILLIMETRES_ABOVE_M`] and this, the user must give the unit.
pub const MILLIMETRES_FROM: f64 = 35.0;
/// Least accepted largest side, metres.
pub const MIN_EXTENT_M: f64 = 0.005;
/// Greatest accepted largest side, metres.
pub const MAX_EXTENT_M: f64 = 0.6;
