//! The ray caster against analytic shapes, single rays in double precision, and itself on other instruction sets.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use glam::{DVec3, Vec3, Vec3A};
use mvt_frames::camera::{Intrinsics, look_at};
use mvt_frames::{Camera, Isometry, Object, World};
use mvt_mesh::Mesh;
use mvt_render::rays::{Caster, Faces, Hits, Instance, MISS, PixelWindow, RayInstructions, RayMesh};
use mvt_render::tessellation::tessellate;
use mvt_robot::hand::{Primitive, UPRIGHT};
use nalgebra as na;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ray::{Ray, RayHit};
use obvhs::{Boundable, BvhBuildParams};
use proptest::prelude::*;

fn ellipsoid(semi: [f64; 3]) -> Mesh {
    tessellate(&Primitive::Ellipsoid { centre: [0.0; 3], semi, orientation_wxyz: UPRIGHT }, 64)
}

/// A closed shape with bumps and hollows, like objects that hands turn.
fn blob() -> Mesh {
    let mut mesh = ellipsoid([0.03, 0.03, 0.03]);
    for p in &mut mesh.vertices {
        let d = p.normalize();
        *p *= 1.0 + 0.15 * (7.0 * d.x).sin() * (5.0 * d.y + 1.0).cos() + 0.1 * (9.0 * d.z).sin();
    }
    mesh
}

/// Single rays in double precision over a tree of their own: slow, and the oracle for the caster.
struct SingleRays {
    tree: Bvh2,
    triangles: Vec<[Vec3A; 3]>,
}

/// Box of a triangle with a margin that covers the rounding of box tests.
struct Bounds(Aabb);

impl Boundable for Bounds {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl SingleRays {
    fn new(mesh: &RayMesh) -> Self {
        let triangles: Vec<[Vec3A; 3]> = (0..mesh.len() as u32).map(|k| mesh.corners(k)).collect();
        let reach = triangles.iter().flatten().fold(0.0f32, |reach, p| reach.max(p.abs().max_element()));
        let margin = Vec3A::splat(1e-6 * reach);
        let bounds = |corners: &[Vec3A; 3]| {
            let Aabb { min, max } = Aabb::from_points(corners);
            Bounds(Aabb::new(min - margin, max + margin))
        };
        let bounds: Vec<Bounds> = triangles.iter().map(bounds).collect();
        let tree = build_bvh2(&bounds, BvhBuildParams::medium_build(), &mut std::time::Duration::default());
        Self { tree, triangles }
    }

    /// Distance of the nearest hit at t > 0, on either side of the triangles, in lengths of the direction.
    fn cast(&self, origin: Vec3A, direction: Vec3A) -> Option<f32> {
        if self.triangles.is_empty() {
            return None;
        }
        let mut nearest = f32::INFINITY;
        self.tree.ray_traverse(Ray::new_inf(origin, direction), &mut RayHit::none(), |_, k| {
            let triangle = self.triangles[self.tree.primitive_indices[k] as usize];
            let t = intersect(triangle.map(Vec3A::as_dvec3), origin.as_dvec3(), direction.as_dvec3());
            let t = t.map_or(f32::INFINITY, |t| t as f32);
            nearest = nearest.min(t);
            t
        });
        nearest.is_finite().then_some(nearest)
    }
}

/// Moeller and Trumbore's test: the distance of the hit.
fn intersect([a, b, c]: [DVec3; 3], origin: DVec3, direction: DVec3) -> Option<f64> {
    let (ab, ac) = (b - a, c - a);
    let p = direction.cross(ac);
    let determinant = ab.dot(p);
    let s = origin - a;
    let u = s.dot(p) / determinant;
    let q = s.cross(ab);
    let v = direction.dot(q) / determinant;
    let t = ac.dot(q) / determinant;
    // The margin of 1e-9 closes gaps at edges. If the determinant vanishes, NaN and infinities fail.
    (u >= -1e-9 && v >= -1e-9 && u + v <= 1.0 + 1e-9 && t > 0.0).then_some(t)
}

fn camera(eye: [f64; 3], target: [f64; 3]) -> Isometry<Camera, World> {
    look_at(eye.into(), target.into(), na::Vector3::new(0.1, 0.05, 1.0))
}

fn image(width: usize, height: usize) -> Intrinsics {
    Intrinsics::from_fov_y(width, height, 45f64.to_radians())
}

fn cast(
    instructions: RayInstructions,
    meshes: &[(&RayMesh, Isometry<Object, World>)],
    eye: Isometry<Camera, World>,
    k: &Intrinsics,
) -> Hits {
    let instances: Vec<_> = meshes.iter().map(|&(mesh, pose)| Instance::new(mesh, eye.inverse() * pose)).collect();
    let mut hits = Hits::new(PixelWindow::whole(k));
    Caster::new(instructions).cast(&instances, k, Faces::Both, &mut hits);
    hits
}

fn scene() -> (RayMesh, RayMesh, Isometry<Object, World>) {
    let box_ = tessellate(&Primitive::Box { centre: [0.0; 3], half: [0.02, 0.05, 0.01], orientation_wxyz: UPRIGHT }, 0);
    let pose = Isometry::from_parts([0.01, 0.02, -0.03], [0.8, 0.3, -0.5, 0.1]);
    (RayMesh::new(&blob()), RayMesh::new(&box_), pose)
}

#[test]
fn all_instruction_sets_agree_to_the_bit() {
    let (blob, box_, pose) = scene();
    let k = image(333, 251);
    let eye = camera([0.1, -0.05, 0.08], [0.0; 3]);
    let render =
        |instructions| cast(instructions, &[(&blob, Isometry::identity()), (&box_, pose), (&blob, pose)], eye, &k);
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let sets = RayInstructions::available();
    let first = render(sets[0]);
    assert!(first.triangle().iter().filter(|&&t| t != MISS).count() > 10_000);
    for &set in &sets[1..] {
        let other = render(set);
        assert_eq!(bits(first.depth()), bits(other.depth()), "{}", set.name());
        assert_eq!(first.triangle(), other.triangle());
        assert_eq!(first.instance(), other.instance());
        assert_eq!(bits(first.barycentric().0), bits(other.barycentric().0));
        assert_eq!(bits(first.barycentric().1), bits(other.barycentric().1));
    }
}

#[test]
fn tiles_agree_with_single_rays() {
    let (blob, box_, pose) = scene();
    let k = image(301, 203);
    let eye = camera([0.09, -0.05, 0.08], [0.0; 3]);
    let hits = cast(RayInstructions::best(), &[(&blob, Isometry::identity()), (&box_, pose)], eye, &k);
    let singles = [&blob, &box_].map(SingleRays::new);
    let (mut different, mut worst) = (0, 0.0f64);
    for (pixel, &depth) in hits.depth().iter().enumerate() {
        let direction = k.unproject((pixel % k.width) as f64, (pixel / k.width) as f64, 1.0).coords();
        let single = [(&singles[0], Isometry::identity()), (&singles[1], pose)].map(|(mesh, pose)| {
            let to_mesh = (pose.inverse() * eye).untyped();
            let vector = |v: na::Vector3<f64>| Vec3A::new(v.x as f32, v.y as f32, v.z as f32);
            mesh.cast(vector(to_mesh.translation.vector), vector(to_mesh.rotation * direction))
        });
        let nearest = single.into_iter().flatten().fold(f32::INFINITY, f32::min);
        if nearest.is_infinite() && depth.is_infinite() {
            continue;
        }
        // A ray that grazes a silhouette may pass it on either side.
        if (nearest - depth).abs() > 1e-4 || nearest.is_infinite() != depth.is_infinite() {
            different += 1;
        } else {
            let (u, v) = (hits.barycentric().0[pixel], hits.barycentric().1[pixel]);
            let mesh = [&blob, &box_][hits.instance()[pixel] as usize];
            let pose = [Isometry::identity(), pose][hits.instance()[pixel] as usize];
            // A ray that grazes a face magnifies rounding errors.
            let normal = mesh.flat_normal(hits.triangle()[pixel]).as_dvec3();
            let normal = pose.untyped().rotation * na::Vector3::new(normal.x, normal.y, normal.z);
            let slope = normal.dot(&(eye.untyped().rotation * direction)).abs();
            worst = worst.max(f64::from((depth - nearest).abs()) * slope);
            let p = mesh.point(hits.triangle()[pixel], u, v).as_dvec3();
            let seen = (eye.inverse() * pose).untyped() * na::Point3::new(p.x, p.y, p.z);
            assert!((seen.coords - direction * f64::from(depth)).norm() < 2e-5, "barycentrics point elsewhere");
        }
    }
    assert!(different <= 2, "{different} pixels differ");
    assert!(worst < 1e-7, "distance to the surface differs by {worst} m");
}

#[test]
fn sphere_box_and_cylinder_have_their_analytic_depth() {
    // The cylinder is the middle of a long capsule.
    let radius = 0.03;
    let shapes = [
        Primitive::Ellipsoid { centre: [0.0; 3], semi: [radius; 3], orientation_wxyz: UPRIGHT },
        Primitive::Box { centre: [0.0; 3], half: [radius; 3], orientation_wxyz: UPRIGHT },
        Primitive::Capsule { from: [0.0, 0.0, -2.0], to: [0.0, 0.0, 2.0], radius },
    ];
    let k = image(320, 240);
    let eye = camera([0.2, 0.15, 0.1], [0.0; 3]);
    for (which, shape) in shapes.iter().enumerate() {
        let mesh = RayMesh::new(&tessellate(shape, 160));
        let hits = cast(RayInstructions::best(), &[(&mesh, Isometry::identity())], eye, &k);
        let exact = |u: usize, v: usize| {
            let o = eye.origin().coords();
            let d = eye.untyped().rotation * k.unproject(u as f64, v as f64, 1.0).coords();
            let quadratic = |a: f64, b: f64, c: f64| (b * b - a * c >= 0.0).then(|| (-b - (b * b - a * c).sqrt()) / a);
            match which {
                0 => quadratic(d.dot(&d), o.dot(&d), o.dot(&o) - radius * radius),
                1 => {
                    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
                    for axis in 0..3 {
                        let (a, b) = ((-radius - o[axis]) / d[axis], (radius - o[axis]) / d[axis]);
                        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
                    }
                    (enter <= leave).then_some(enter)
                }
                _ => {
                    let (o, d) = (o.xy(), d.xy());
                    quadratic(d.dot(&d), o.dot(&d), o.dot(&o) - radius * radius)
                }
            }
        };
        let mut worst = 0.0f64;
        for v in 1..k.height - 1 {
            for u in 1..k.width - 1 {
                // Away from the silhouette.
                let ring = [(u, v), (u - 1, v), (u + 1, v), (u, v - 1), (u, v + 1)].map(|(u, v)| exact(u, v));
                let found = hits.depth()[v * k.width + u];
                match ring[0] {
                    Some(depth) if ring.iter().all(Option::is_some) => {
                        worst = worst.max((f64::from(found) - depth).abs());
                    }
                    None if ring.iter().all(Option::is_none) => assert!(found.is_infinite(), "({u}, {v}) hits nothing"),
                    _ => {}
                }
            }
        }
        println!("{shape:?}: worst depth error {:.4} mm", worst * 1e3);
        assert!(worst < 1e-4, "{shape:?}: {worst} m");
    }
}

#[test]
fn closed_meshes_have_no_pin_holes() {
    // From inside every ray hits, whichever edges and corners it meets; straight views put many pixels exactly on them.
    let meshes = [
        blob(),
        ellipsoid([0.04, 0.03, 0.05]),
        tessellate(&Primitive::Box { centre: [0.0; 3], half: [0.04; 3], orientation_wxyz: UPRIGHT }, 0),
    ];
    let mut rays = 0;
    for mesh in meshes.iter().map(RayMesh::new) {
        for (n, target) in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 1.0, 1.0], [0.3, -0.2, 0.9]]
            .into_iter()
            .enumerate()
        {
            // Odd sizes have a pixel on the axis, and an eye at the centre looks straight at corners of the mesh.
            let k = Intrinsics::from_fov_y(801, 601, 100f64.to_radians());
            let eye = if n % 2 == 0 { [0.0; 3] } else { [0.003, -0.002, 0.001] };
            let eye = look_at(eye.into(), target.into(), na::Vector3::z());
            let hits = cast(RayInstructions::best(), &[(&mesh, Isometry::identity())], eye, &k);
            assert_eq!(hits.triangle().iter().filter(|&&t| t == MISS).count(), 0, "towards {target:?}");
            rays += hits.triangle().len();
        }
    }
    println!("no hole in {rays} rays");
}

#[test]
fn windows_repeated_casts_and_sides() {
    let (mesh, box_, _) = scene();
    let k = image(160, 120);
    let eye = camera([0.12, 0.0, 0.03], [0.0; 3]);
    let whole = cast(RayInstructions::best(), &[(&mesh, Isometry::identity())], eye, &k);
    let instance = [Instance::new(&mesh, eye.inverse() * Isometry::<Object, World>::identity())];
    let mut caster = Caster::default();

    // A window equals that part of the whole image.
    let mut part = Hits::new(PixelWindow { columns: 13..14, rows: 0..1 });
    for window in [
        PixelWindow { columns: 50..111, rows: 33..90 },
        PixelWindow { columns: 77..78, rows: 60..61 },
        PixelWindow { columns: 3..3, rows: 0..9 },
    ] {
        part.reset(window.clone());
        caster.cast(&instance, &k, Faces::Both, &mut part);
        let expected: Vec<f32> = window
            .rows
            .clone()
            .flat_map(|v| window.columns.clone().map(move |u| (u, v)))
            .map(|(u, v)| whole.depth()[v * k.width + u])
            .collect();
        for (a, b) in part.depth().iter().zip(&expected) {
            assert!((a == b) || (a - b).abs() < 1e-7, "{a} {b}");
        }
        assert_eq!(part.depth().len(), expected.len());
    }

    // A later cast replaces only the hits that lie behind its own.
    let near: Isometry<Object, World> = Isometry::translation(0.06, 0.0, 0.0);
    let both = cast(RayInstructions::best(), &[(&mesh, Isometry::identity()), (&box_, near)], eye, &k);
    let mut hits = Hits::new(PixelWindow::whole(&k));
    caster.cast(&[Instance::new(&box_, eye.inverse() * near)], &k, Faces::Both, &mut hits);
    let in_front = hits.triangle().iter().filter(|&&t| t != MISS).count();
    caster.cast(&instance, &k, Faces::Front, &mut hits);
    assert_eq!(hits.depth(), both.depth());
    assert!(in_front > 0 && hits.triangle().iter().filter(|&&t| t != MISS).count() > in_front);
    assert!(hits.triangle().contains(&MISS));

    // From inside only back faces are in view.
    let inside = look_at(na::Vector3::zeros(), na::Vector3::x(), na::Vector3::z());
    let instance = [Instance::new(&mesh, inside.inverse() * Isometry::<Object, World>::identity())];
    hits.reset(PixelWindow::whole(&k));
    caster.cast(&instance, &k, Faces::Front, &mut hits);
    assert!(hits.triangle().iter().all(|&t| t == MISS));
}

#[test]
fn nothing_to_hit_is_not_an_error() {
    let nan = Vec3::new(f32::NAN, 0.0, 0.0);
    let broken = Mesh {
        vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Y, nan, Vec3::X * 2.0],
        faces: vec![[0, 1, 3], [0, 1, 9], [0, 1, 4], [1, 1, 2], [0, 1, 2]],
    };
    let mesh = RayMesh::new(&broken);
    assert_eq!((mesh.len(), mesh.face(0)), (1, 4), "one face is sound");
    let empty = RayMesh::new(&Mesh::default());
    assert!(empty.is_empty());
    let behind = Isometry::translation(0.0, 0.0, 5.0);
    let k = image(16, 16);
    let hits =
        cast(RayInstructions::best(), &[(&empty, Isometry::identity()), (&mesh, behind)], Isometry::identity(), &k);
    assert!(hits.depth().iter().all(|d| d.is_infinite()));
}

#[test]
fn vertex_normals_are_weighted_by_angle() {
    // trimesh.creation.box().vertex_normals are (+-1, +-1, +-1) / sqrt 3 however its faces are cut in two: weights by
    // area or by face would favour the sides with two triangles at a corner.
    let corner = |k: u32| Vec3::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2 & 1) as f32);
    let mesh = Mesh {
        vertices: (0..8).map(corner).collect(),
        faces: [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
            .iter()
            .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect(),
    };
    let mesh = RayMesh::new(&mesh);
    for triangle in 0..mesh.len() as u32 {
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)] {
            let expected = (mesh.point(triangle, u, v) - Vec3A::splat(0.5)) * 2.0 / 3f32.sqrt();
            assert!((mesh.smooth_normal(triangle, u, v) - expected).length() < 1e-6);
        }
        let outward = mesh.point(triangle, 0.3, 0.3) - Vec3A::splat(0.5);
        assert!((mesh.flat_normal(triangle).dot(outward) - 0.5).abs() < 1e-6);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Soups of large and small triangles, seen from anywhere: near, inside, edge-on.
    #[test]
    fn any_soup_agrees_with_single_rays(
        corners in prop::collection::vec(prop::array::uniform3(-1.0f32..1.0), 3..60),
        scale in 0.01f32..0.5,
        eye in prop::array::uniform3(-0.6f64..0.6),
    ) {
        let vertices: Vec<Vec3> = corners.iter().map(|&p| Vec3::from(p) * scale).collect();
        let faces = (0..vertices.len() as u32 / 3).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let mesh = RayMesh::new(&Mesh { vertices, faces });
        let k = image(40, 30);
        let eye = camera(eye, [0.01, 0.02, 0.03]);
        let hits = cast(RayInstructions::best(), &[(&mesh, Isometry::identity())], eye, &k);
        let (axes, origin) = eye.to_f32();
        let singles = SingleRays::new(&mesh);
        let mut different = 0;
        for (pixel, &depth) in hits.depth().iter().enumerate() {
            let d = k.unproject((pixel % k.width) as f64, (pixel / k.width) as f64, 1.0).coords();
            let single = singles.cast(origin, axes * Vec3A::new(d.x as f32, d.y as f32, -1.0));
            let expected = single.unwrap_or(f32::INFINITY);
            let agree = if expected.is_finite() {
                (depth - expected).abs() <= 1e-4 * expected.max(0.01)
            } else {
                depth.is_infinite()
            };
            if !agree {
                different += 1;
            }
        }
        prop_assert!(different <= 2, "{different} pixels differ");
    }
}
