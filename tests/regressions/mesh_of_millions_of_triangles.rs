//! A mesh of two million triangles kept the program busy for minutes without a word.

use mvt_mesh::Mesh;
use mvt_objects::decompose;
use mvt_render::tessellation::tessellate;
use mvt_robot::hand::{Primitive, UPRIGHT};

/// A ball whose vertices all lie on its hull is the worst case.
#[test]
fn the_hull_of_a_fine_mesh_is_found() {
    let radius_m = 0.035;
    let ball = Primitive::Ellipsoid { centre: [0.0; 3], semi: [radius_m; 3], orientation_wxyz: UPRIGHT };
    let mesh: Mesh = tessellate(&ball, 1000);
    assert!(mesh.vertices.len() > 200_000, "{}", mesh.vertices.len());
    let pieces = decompose::pieces(&mesh).unwrap();
    assert_eq!(pieces.len(), 1);
    let expected_m3 = 4.0 / 3.0 * std::f64::consts::PI * radius_m.powi(3);
    let volume_m3 = decompose::hull_volume_m3(&mesh).unwrap();
    assert!((volume_m3 / expected_m3 - 1.0).abs() < 0.02, "{volume_m3} and not {expected_m3}");
    // All six extremes are kept.
    for axis in 0..3 {
        let reach = pieces[0].iter().map(|p| p[axis]).fold(0.0f32, f32::max);
        assert!((f64::from(reach) - radius_m).abs() < 1e-6, "{reach}");
    }
}
