//! What a press amounts to: area, depth, volume and normal force.

use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::observation::Press;
use serde::Serialize;

/// Area of the gel that each pixel of a sensor sees, and the gel's stiffness.
#[derive(Debug, Clone)]
pub struct GelScale {
    /// Square millimetres, row by row.
    pixel_mm2: Vec<f64>,
    stiffness_n_per_mm3: f64,
    stiffness_deviation: f64,
}

/// Figures of a press.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct PressFigures {
    /// Area in contact, square millimetres.
    pub area_mm2: f64,
    /// Greatest indentation in contact, millimetres.
    pub deepest_mm: f32,
    /// Volume that is pressed in where the gel touches, cubic millimetres.
    pub volume_mm3: f64,
    /// Normal force, newtons: the volume times the stiffness of the profile, as if the gel were a bed of springs (Winkler). Its standard
    /// deviation follows from that of the stiffness.
    pub force_n: f64,
    /// Standard deviation of the force, newtons.
    pub force_sigma_n: f64,
}

impl GelScale {
    /// Prepares a sensor.
    pub fn new(profile: &SensorProfile) -> Self {
        let (camera, gel) = (profile.intrinsics(), profile.gel_surface());
        let [width, height] = profile.size_px;
        let side_m = |i: usize| gel.point(&camera, (i % width) as f64, (i / width) as f64).coords().x / camera.fx;
        Self {
            pixel_mm2: (0..height * width).map(|i| 1e6 * side_m(i).powi(2)).collect(),
            stiffness_n_per_mm3: f64::from(profile.stiffness_n_per_mm3),
            stiffness_deviation: f64::from(profile.stiffness_deviation),
        }
    }

    /// Returns the figures of a press on the sensor.
    pub fn figures(&self, press: &Press) -> PressFigures {
        let mut figures = PressFigures::default();
        for ((&mm, &touches), mm2) in press.indentation_mm.iter().zip(&press.contact).zip(&self.pixel_mm2) {
            if touches {
                figures.area_mm2 += mm2;
                figures.deepest_mm = figures.deepest_mm.max(mm);
                figures.volume_mm3 += f64::from(mm) * mm2;
            }
        }
        figures.force_n = self.stiffness_n_per_mm3 * figures.volume_mm3;
        figures.force_sigma_n = self.stiffness_deviation * figures.force_n;
        figures
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    /// A ball of radius R, pressed in by d, displaces pi d^2 (R - d / 3).
    #[test]
    fn volume_and_force_of_a_cap_are_those_of_the_formula() {
        let profile = SensorProfile { stiffness_n_per_mm3: 0.2, ..SensorProfile::load("gelsight_mini").unwrap() };
        let (radius_mm, depth_mm, pixel_mm) = (4.75, 0.6, profile.pixel_mm());
        let indentation_mm = Array2::from_shape_fn((320, 240), |(v, u)| {
            let r_mm = pixel_mm * (u as f64 - 119.5).hypot(v as f64 - 159.5);
            (depth_mm - radius_mm + (radius_mm * radius_mm - r_mm * r_mm).max(0.0).sqrt()).max(0.0) as f32
        });
        let contact = indentation_mm.mapv(|mm| mm > 0.0);
        let figures = GelScale::new(&profile).figures(&Press { indentation_mm, contact, sigma_mm: 0.05 });
        let volume_mm3 = std::f64::consts::PI * depth_mm * depth_mm * (radius_mm - depth_mm / 3.0);
        assert!((figures.volume_mm3 / volume_mm3 - 1.0).abs() < 0.01, "{figures:?} instead of {volume_mm3} mm3");
        assert!((figures.force_n / (0.2 * volume_mm3) - 1.0).abs() < 0.01);
        assert_eq!(figures.force_sigma_n, 0.5 * figures.force_n);
        assert!(
            (figures.area_mm2 / (std::f64::consts::PI * depth_mm * (2.0 * radius_mm - depth_mm)) - 1.0).abs() < 0.01
        );
        assert!((f64::from(figures.deepest_mm) - depth_mm).abs() < 0.01);
    }
}
