//! Bodies of touch sensors.

use mvt_settings::settings;

use crate::hand::{Inertial, Part, PartSurface, Primitive, UPRIGHT};

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

impl SensorBody {
    /// Returns the housing and the gel, which is that of the pad of this index, in the gel frame.
    pub fn parts(&self, pad: usize) -> Vec<Part> {
        let half = |size: [f64; 3]| size.map(|side| side / 2.0);
        let (centre, orientation_wxyz) = (self.gel_centre_m, UPRIGHT);
        let housing =
            Primitive::Box { centre: self.housing_centre_m, half: half(self.housing_size_m), orientation_wxyz };
        let gel = match half(self.gel_size_m) {
            semi if self.is_domed => Primitive::Ellipsoid { centre, semi, orientation_wxyz },
            half => Primitive::Box { centre, half, orientation_wxyz },
        };
        vec![
            Part { surface: PartSurface::Housing, shape: housing },
            Part { surface: PartSurface::Gel(pad), shape: gel },
        ]
    }

    /// Returns the mass in the gel frame.
    pub fn inertial(&self) -> Inertial {
        let Self { mass_kg, mass_centre_m, inertia_kg_m2, .. } = *self;
        Inertial { mass_kg, centre_m: mass_centre_m, orientation_wxyz: UPRIGHT, diagonal: inertia_kg_m2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digit::profile::SensorProfile;

    #[test]
    fn gels_end_at_the_apex_and_stand_out_of_their_housing() {
        for name in ["digit", "gelsight_mini"] {
            let profile = SensorProfile::load(name).unwrap();
            let parts = profile.body.parts(2);
            let front = |part: &Part| match &part.shape {
                Primitive::Box { centre, half, .. } => centre[0] + half[0],
                Primitive::Ellipsoid { centre, semi, .. } => centre[0] + semi[0],
                other => panic!("{other:?}"),
            };
            assert_eq!(parts[1].surface, PartSurface::Gel(2));
            assert!((front(&parts[1]) - 1e-3 * profile.apex_mm).abs() < 0.3e-3);
            assert!(front(&parts[0]) < front(&parts[1]) - 2e-3);
        }
    }

    #[test]
    fn half_sizes_are_exact() {
        let [housing, gel] = [0, 1].map(|part| SensorBody::default().parts(0)[part].shape.clone());
        assert!(matches!(housing, Primitive::Box { half: [0.009_75, 0.0115, 0.0155], .. }));
        assert!(matches!(gel, Primitive::Ellipsoid { semi: [0.009, 0.0128, 0.0165], .. }));
    }
}
