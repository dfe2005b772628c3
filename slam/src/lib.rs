//! Geometry to pose and shape.
//!
//! Will hold the neural signed-distance field, the tracker and the metrics. Nothing here knows of MuJoCo or of networks:
//! it receives metric depth and the poses of the sensors that measured it.
