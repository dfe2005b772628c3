//! Polygons and seams of files of other programs keep the shape.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a failed assumption in a test is a failed test"
)]

use std::fmt::Write as _;

use crate::prism::{CUBOID_M3, Prism, cuboid, defect, load, stl_binary};
use glam::{DVec3, Quat, Vec3};
use mvt_mesh::{Finding, Format, Mesh, read_bytes};

/// Loads a file without any finding, and checks that it encloses a volume.
#[track_caller]
fn assert_encloses(bytes: impl AsRef<[u8]>, format: Format, volume_m3: f64) -> Mesh {
    let (mesh, findings) = load(bytes, format).unwrap();
    assert!(findings.is_empty(), "{findings:?}");
    assert!((mesh.volume_m3() / volume_m3 - 1.0).abs() < 1e-4, "{} and not {volume_m3}", mesh.volume_m3());
    mesh
}

fn area(outline: &[[f32; 2]]) -> f64 {
    let next = outline.iter().cycle().skip(1);
    0.5 * outline
        .iter()
        .zip(next)
        .map(|(&[a, b], &[c, d])| f64::from(a) * f64::from(d) - f64::from(c) * f64::from(b))
        .sum::<f64>()
}

/// A comb with teeth of 5 mm.
fn comb(teeth: usize) -> Vec<[f32; 2]> {
    let width = 0.01 * teeth as f32 - 0.005;
    let mut outline = vec![[0.0, 0.0], [width, 0.0]];
    for tooth in (0..teeth).rev() {
        let x = 0.01 * tooth as f32;
        outline.extend([[x + 0.005, 0.06], [x, 0.06]]);
        if tooth > 0 {
            outline.extend([[x, 0.012], [x - 0.005, 0.012]]);
        }
    }
    outline
}

/// A star with narrow spikes.
fn star(spikes: usize) -> Vec<[f32; 2]> {
    let corner = |i: usize| {
        let angle = std::f64::consts::PI * i as f64 / spikes as f64;
        let radius = if i.is_multiple_of(2) { 0.05 } else { 0.02 };
        [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32]
    };
    (0..2 * spikes).map(corner).collect()
}

/// Moves every corner of every triangle by up to `most` along each axis, each by another amount.
fn jittered(corners: &[[Vec3; 3]], most: f64) -> Vec<[DVec3; 3]> {
    let mut state = 1_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as f64 / f64::from(1_u32 << 31) * 2.0 - 1.0) * most
    };
    corners.iter().map(|triangle| triangle.map(|v| v.as_dvec3() + DVec3::new(noise(), noise(), noise()))).collect()
}

/// An OBJ file in which no face shares a vertex, with so many decimals.
fn obj_soup(corners: &[[DVec3; 3]], decimals: usize) -> String {
    let mut text = String::new();
    for (i, triangle) in corners.iter().enumerate() {
        triangle
            .iter()
            .for_each(|v| writeln!(text, "v {:.decimals$} {:.decimals$} {:.decimals$}", v.x, v.y, v.z).unwrap());
        writeln!(text, "f {} {} {}", 3 * i + 1, 3 * i + 2, 3 * i + 3).unwrap();
    }
    text
}

#[test]
fn polygons_keep_their_shape() {
    let bracket = vec![[0.0, 0.0], [0.1, 0.0], [0.1, 0.012], [0.012, 0.012], [0.012, 0.1], [0.0, 0.1]];
    // Corners on the sides, two of them beside the first corner.
    let marked = vec![
        [0.0, 0.0],
        [0.02, 0.0],
        [0.04, 0.0],
        [0.06, 0.0],
        [0.06, 0.01],
        [0.06, 0.02],
        [0.03, 0.02],
        [0.0, 0.02],
        [0.0, 0.01],
    ];
    let arrow = vec![[0.0, 0.0], [0.06, 0.03], [0.0, 0.06], [0.02, 0.03]];
    // A frame whose hole is reached over a bridge, so that two corners occur twice.
    let (outer, inner) = (
        [[0.0, 0.0], [0.06, 0.0], [0.06, 0.06], [0.0, 0.06]],
        [[0.02, 0.02], [0.02, 0.04], [0.04, 0.04], [0.04, 0.02]],
    );
    let bridged = [&outer[..], &outer[..1], &inner[..], &inner[..1]].concat();
    for outline in [bracket, marked, arrow, comb(4), star(5), star(40), bridged] {
        for (corner, turn) in (0..outline.len())
            .zip([Quat::IDENTITY, Quat::from_rotation_x(0.7), Quat::from_rotation_y(2.0)].into_iter().cycle())
        {
            let prism = Prism::new(&outline, 0.05).begun_at(corner).turned(turn);
            let volume_m3 = area(&outline) * 0.05;
            let surface_m2 = |mesh: &Mesh| mesh.area_m2();
            let mesh = assert_encloses(prism.obj(), Format::Obj, volume_m3);
            let sides_m: f64 = outline
                .iter()
                .zip(outline.iter().cycle().skip(1))
                .map(|(&a, &b)| f64::from(Vec3::new(b[0] - a[0], b[1] - a[1], 0.0).length()))
                .sum();
            // A bridge has no sides.
            let bridge_m =
                if outline.len() == 10 && outline[4] == outline[0] { 2.0 * 0.02 * 2.0_f64.sqrt() } else { 0.0 };
            let expected_m2 = 2.0 * area(&outline) + (sides_m - bridge_m) * 0.05;
            assert!((surface_m2(&mesh) / expected_m2 - 1.0).abs() < 1e-4, "{outline:?}, corner {corner}");
            assert_eq!(assert_encloses(prism.ply_text(), Format::Ply, volume_m3), mesh);
            assert_eq!(assert_encloses(prism.ply_binary(), Format::Ply, volume_m3), mesh);
        }
    }
}

#[test]
fn convex_polygons_are_fans_from_the_first_corner() {
    let prism = Prism::new(&[[0.0, 0.0], [0.05, 0.0], [0.06, 0.03], [0.02, 0.06]], 0.05);
    let (mesh, _) = read_bytes(prism.obj().as_bytes(), Format::Obj, "f").unwrap();
    let fans: Vec<[u32; 3]> = prism
        .faces
        .iter()
        .flat_map(|face| [[face[0], face[1], face[2]], [face[0], face[2], face[3]]])
        .map(|face| face.map(|v| v as u32))
        .collect();
    let corners = |mesh: &Mesh| mesh.triangles().collect::<Vec<_>>();
    assert_eq!(corners(&mesh), corners(&Mesh { vertices: prism.vertices, faces: fans }));
}

#[test]
fn polygons_without_a_plane_stay_closed() {
    // The corners of the top alternate in height, and one of them is named twice.
    let mut bent = Prism::new(&star(7), 0.05);
    bent.vertices.iter_mut().skip(14).step_by(2).for_each(|v| v.z += 0.004);
    bent.faces[1].insert(3, 16);
    let (mesh, findings) = load(bent.obj(), Format::Obj).unwrap();
    assert!(findings.is_empty() && mesh.edges().watertight(), "{findings:?}");
    // A side that bends by 20 degrees keeps the diagonal of its first corner.
    let mut quad = cuboid();
    quad.vertices[6].x += 0.01;
    assert!(load(quad.obj(), Format::Obj).unwrap().0.edges().watertight());
    // A polygon that runs back on itself, and one of which all corners are one point, have no area.
    for spike in ["f 1 2 3 2 1\n", "f 1 1 1 1\n", "f 1 2 1 2\n"] {
        let (mesh, _) = load(cuboid().obj() + spike, Format::Obj).unwrap();
        assert!(mesh.edges().watertight() && (mesh.volume_m3() / CUBOID_M3 - 1.0).abs() < 1e-4, "{spike}");
    }
}

#[test]
fn large_polygons_are_triangulated_in_a_moment() {
    let started = std::time::Instant::now();
    for outline in [
        star(2_000),
        comb(1_000).into_iter().map(|[x, y]| [0.02 * x, y]).collect(),
        comb(1_000).into_iter().map(|[x, y]| [-y, 0.02 * x]).collect(),
    ] {
        assert_encloses(Prism::new(&outline, 0.05).obj(), Format::Obj, area(&outline) * 0.05);
    }
    // More corners than a concave polygon may have.
    let circle: Vec<[f32; 2]> = (0..21_000)
        .map(|i| (i as f32 * std::f32::consts::TAU / 21e3).sin_cos())
        .map(|(y, x)| [0.03 * x, 0.03 * y])
        .collect();
    let (mesh, _) = load(Prism::new(&circle, 0.05).obj(), Format::Obj).unwrap();
    assert!((mesh.volume_m3() / (area(&circle) * 0.05) - 1.0).abs() < 1e-4);
    assert!(defect(Prism::new(&star(10_001), 0.05).obj(), Format::Obj).contains("20002 corners, the limit is 20000"));
    assert!(started.elapsed().as_secs() < 60, "{:?}", started.elapsed());
}

#[test]
fn vertices_that_differ_by_rounding_become_one() {
    let outline: Vec<[f32; 2]> = (0..48)
        .map(|i| (i as f32 * std::f32::consts::TAU / 48.0).sin_cos())
        .map(|(y, x)| [0.033 * x, 0.033 * y])
        .collect();
    let can = Prism::new(&outline, 0.1);
    let volume_m3 = area(&outline) * 0.1;
    let check = |what: &str, bytes: &[u8], format| {
        let (mesh, findings) = load(bytes, format).unwrap();
        assert!(matches!(findings[..], [Finding::Seams { .. }]), "{what}: {findings:?}");
        assert!(mesh.edges().watertight(), "{what}");
        assert_eq!(mesh.vertices.len(), 96, "{what}");
        assert!((mesh.volume_m3() / volume_m3 - 1.0).abs() < 1e-3, "{what}: {}", mesh.volume_m3());
    };
    let rounded =
        |corners: Vec<[DVec3; 3]>| corners.iter().map(|triangle| triangle.map(DVec3::as_vec3)).collect::<Vec<_>>();
    for (most, what) in [(3e-9, "last bit"), (1e-9, "nanometre"), (1e-7, "seventh decimal")] {
        let noisy = jittered(&can.corners(), most);
        check(what, &stl_binary("", &rounded(noisy.clone())), Format::Stl);
        check(what, obj_soup(&noisy, 12).as_bytes(), Format::Obj);
    }
    // The last decimal of a text, in metres and in millimetres.
    check("six decimals", obj_soup(&jittered(&can.corners(), 0.5e-6), 6).as_bytes(), Format::Obj);
    check("five decimals", obj_soup(&jittered(&can.corners(), 0.2e-5), 5).as_bytes(), Format::Obj);
    // Far from the origin single precision is coarse.
    let far: Vec<[Vec3; 3]> =
        can.corners().iter().map(|triangle| triangle.map(|v| v + Vec3::new(2.0, -3.0, 1.0))).collect();
    check("far away", &stl_binary("", &rounded(jittered(&far, 2e-7))), Format::Stl);
}

#[test]
fn thin_plates_stay_two_sided() {
    for (thickness_m, noise_m) in [(1e-4, 0.0), (1e-4, 2e-9), (1e-4, 1e-6), (1e-6, 0.0), (1e-6, 2e-9)] {
        let plate = Prism::new(&[[0.0, 0.0], [0.06, 0.0], [0.06, 0.06], [0.0, 0.06]], thickness_m);
        let (mesh, findings) = load(obj_soup(&jittered(&plate.corners(), noise_m), 12), Format::Obj).unwrap();
        assert!(findings.iter().all(|finding| matches!(finding, Finding::Seams { .. })), "{findings:?}");
        assert_eq!((mesh.vertices.len(), mesh.edges().watertight()), (8, true));
        assert!(
            (mesh.volume_m3() / (0.0036 * f64::from(thickness_m)) - 1.0).abs() < 0.05,
            "{thickness_m}: {}",
            mesh.volume_m3()
        );
    }
    // Two sheets without sides, a tenth of a millimetre apart, are two open parts and stay so.
    let mut sheets = Prism::new(&[[0.0, 0.0], [0.06, 0.0], [0.06, 0.06], [0.0, 0.06]], 1e-4);
    sheets.faces.truncate(2);
    let (_, findings) = load(sheets.obj(), Format::Obj).unwrap();
    assert!(
        matches!(findings[..], [Finding::Components { dropped: 1, .. }, Finding::NotWatertight(_)]),
        "{findings:?}"
    );
}
