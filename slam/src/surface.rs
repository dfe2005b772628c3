//! Surface of a shape as a triangle mesh.
