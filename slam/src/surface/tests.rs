use super::*;

struct Sphere(f32);
impl Shape for Sphere {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        for (p, out) in points.iter().zip(out) {
            *out = p.length() - self.0;
        }
    }
    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        for (p, out) in points.iter().zip(out) {
            *out = Distance { value_m: p.length() - self.0, gradient: p.normalize_or_zero() };
        }
    }
}

#[test]
fn sphere() {
    let mesh = extract(&Sphere(0.03), [Vec3::splat(-0.05), Vec3::splat(0.05)], 0.0015, &|_| true);
    assert!(mesh.edges().watertight());
    assert!((mesh.volume_m3() / (4.0 / 3.0 * std::f64::consts::PI * 0.03f64.powi(3)) - 1.0).abs() < 1e-3);
}
