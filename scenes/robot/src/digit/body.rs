//! Bodies of touch sensors.

use mvt_settings::settings;

settings! {
    /// Body of a touch sensor as hands collide with it, in the frame of the gel: x out of the gel from the camera, z up in the image. The
    /// default is a DIGIT's.
    #[derive(Copy)]
    pub struct SensorBody {
        /// Middle of the box that stands for the housing, metres.
        pub housing_centre_m: [f64; 3] = [0.005_882, 0.0, -0.000_745], -0.2..=0.2;
        /// Size of this box, metres. That of a DIGIT is narrower than the gel; otherwise its hard edge would touch first at 45 degrees.
        pub housing_size_m: [f64; 3] = [0.0195, 0.023, 0.031], 1e-4..=0.2;
        /// Middle of the gel, metres.
        pub gel_centre_m: [f64; 3] = [0.013_232, 0.0, -0.001_045], -0.2..=0.2;
        // Why: notes/decisions/simulation.md, "The physical gel is an ellipsoid inside TACTO's gel".
        /// Size of the gel, metres. That of a DIGIT is more domed than TACTO's gel, so that a touch has one contact point.
        pub gel_size_m: [f64; 3] = [0.018, 0.0256, 0.033], 1e-4..=0.2;
        /// Whether the gel is an ellipsoid; else it is a box.
        pub is_domed: bool = true;
        /// Mass, kilograms.
        pub mass_kg: f64 = 0.020, 1e-4..=2.0;
        /// Centre of mass, metres.
        pub mass_centre_m: [f64; 3] = [0.007_132, 0.0, -0.000_545], -0.2..=0.2;
        /// Moments of inertia about the axes through it, kg m^2.
        pub inertia_kg_m2: [f64; 3] = [3.5e-6, 3e-6, 2.5e-6], 1e-9..=1e-2;
    }
}
