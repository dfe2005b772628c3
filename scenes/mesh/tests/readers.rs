//! Mesh files of every format: valid files give the same mesh, invalid files give an error with the file's name, and
//! damage causes neither a panic nor a large allocation.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a failed assumption in a test is a failed test"
)]

use std::fmt::Write as _;

use glam::Vec3;
use mvt_mesh::{Defect, EdgeCount, Finding, Format, Mesh, MeshError, read, read_bytes, repair};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// A 40 x 50 x 60 mm box, outward.
fn cuboid() -> Mesh {
    let vertices =
        (0..8).map(|i| Vec3::new((i & 1) as f32 * 0.04, (i >> 1 & 1) as f32 * 0.05, (i >> 2) as f32 * 0.06)).collect();
    let faces = vec![
        [0, 2, 3],
        [0, 3, 1],
        [4, 5, 7],
        [4, 7, 6],
        [0, 1, 5],
        [0, 5, 4],
        [2, 6, 7],
        [2, 7, 3],
        [0, 4, 6],
        [0, 6, 2],
        [1, 3, 7],
        [1, 7, 5],
    ];
    Mesh { vertices, faces }
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Obj,
    StlText,
    StlBinary,
    PlyText,
    PlyLittle,
    PlyBig,
}

const KINDS: [Kind; 6] = [Kind::Obj, Kind::StlText, Kind::StlBinary, Kind::PlyText, Kind::PlyLittle, Kind::PlyBig];

impl Kind {
    fn format(self) -> Format {
        match self {
            Self::Obj => Format::Obj,
            Self::StlText | Self::StlBinary => Format::Stl,
            Self::PlyText | Self::PlyLittle | Self::PlyBig => Format::Ply,
        }
    }
}

/// Writes a mesh as other programs would.
fn written(mesh: &Mesh, kind: Kind) -> Vec<u8> {
    let mut text = String::new();
    let mut bytes = Vec::new();
    let corners = |face: &[u32; 3]| face.map(|v| mesh.vertices[v as usize]);
    match kind {
        Kind::Obj => {
            text += "# a comment\nmtllib none.mtl\no thing\n";
            for v in &mesh.vertices {
                writeln!(text, "v {} {} {}", v.x, v.y, v.z).unwrap();
            }
            for [a, b, c] in &mesh.faces {
                writeln!(text, "f {} {}// {}", a + 1, b + 1, c + 1).unwrap();
            }
        }
        Kind::StlText => {
            text += "solid thing\n";
            for face in &mesh.faces {
                text += "facet normal 0 0 0\n outer loop\n";
                for v in corners(face) {
                    writeln!(text, "  vertex {:e} {:e} {:e}", v.x, v.y, v.z).unwrap();
                }
                text += " endloop\nendfacet\n";
            }
            text += "endsolid thing\n";
        }
        Kind::StlBinary => {
            // Many programs begin binary files with "solid" as well.
            bytes.extend_from_slice(b"solid made by a program that should know better");
            bytes.resize(80, b' ');
            bytes.extend((mesh.faces.len() as u32).to_le_bytes());
            for face in &mesh.faces {
                bytes.extend([0; 12]);
                bytes.extend(corners(face).iter().flat_map(Vec3::to_array).flat_map(f32::to_le_bytes));
                bytes.extend([0; 2]);
            }
        }
        Kind::PlyText | Kind::PlyLittle | Kind::PlyBig => {
            let encoding = match kind {
                Kind::PlyText => "ascii",
                Kind::PlyLittle => "binary_little_endian",
                _ => "binary_big_endian",
            };
            // Colours beside the position, and an element that the reader ignores.
            write!(
                text,
                "ply\nformat {encoding} 1.0\ncomment thing\nelement vertex {}\nproperty uchar red\nproperty double x\n\
                 property float y\nproperty float z\nelement edge 1\nproperty list uchar short ends\nelement face {}\n\
                 property list uchar int vertex_indices\nend_header\n",
                mesh.vertices.len(),
                mesh.faces.len()
            )
            .unwrap();
            if matches!(kind, Kind::PlyText) {
                for v in &mesh.vertices {
                    writeln!(text, "255 {} {} {}", v.x, v.y, v.z).unwrap();
                }
                text += "2 0 1\n";
                for [a, b, c] in &mesh.faces {
                    writeln!(text, "3 {a} {b} {c}").unwrap();
                }
            } else {
                bytes.extend(text.as_bytes());
                text.clear();
                macro_rules! put {
                    ($number:expr) => {
                        if matches!(kind, Kind::PlyBig) {
                            bytes.extend($number.to_be_bytes());
                        } else {
                            bytes.extend($number.to_le_bytes());
                        }
                    };
                }
                for v in &mesh.vertices {
                    put!(255_u8);
                    put!(f64::from(v.x));
                    put!(v.y);
                    put!(v.z);
                }
                put!(2_u8);
                put!(0_i16);
                put!(1_i16);
                for face in &mesh.faces {
                    put!(3_u8);
                    for &v in face {
                        put!(v as i32);
                    }
                }
            }
        }
    }
    bytes.extend(text.as_bytes());
    bytes
}

fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    mesh.triangles().collect()
}

#[test]
fn every_format_gives_the_same_triangles() {
    let expected = cuboid();
    for kind in KINDS {
        let (found, notes) = read_bytes(&written(&expected, kind), kind.format(), "box").unwrap();
        assert!(notes.is_empty(), "{kind:?}: {notes:?}");
        assert_eq!(corners(&found), corners(&expected), "{kind:?}");
        let (clean, warnings) = repair(&found, "box").unwrap();
        assert_eq!(clean.vertices.len(), 8, "{kind:?}: equal vertices are merged");
        assert!(warnings.is_empty(), "{kind:?}: {warnings:?}");
        assert!((clean.volume_m3() - 0.04 * 0.05 * 0.06).abs() < 1e-11);
    }
}

#[test]
fn polygons_become_fans_and_negative_indices_count_back() {
    let obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n";
    assert_eq!(read_bytes(obj.as_bytes(), Format::Obj, "o").unwrap().0.faces, [[0, 1, 2], [0, 2, 3]]);
    let ply = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
               element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";
    assert_eq!(read_bytes(ply.as_bytes(), Format::Ply, "p").unwrap().0.faces, [[0, 1, 2], [0, 2, 3]]);
}

/// tobj overflows at such numbers.
#[test]
fn numbers_of_normals_and_texture_coordinates_are_ignored() {
    let far = "6148914691236517206";
    let obj = format!("v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\n vn 0 0 1\nf 1/{far}/{far} 2/-9/{far} 3//{far}\n");
    assert_eq!(read_bytes(obj.as_bytes(), Format::Obj, "o").unwrap().0.faces, [[0, 1, 2]]);
}

fn defect(bytes: &[u8], format: Format) -> Defect {
    let whole = read_bytes(bytes, format, "bad.file").and_then(|(mesh, _)| repair(&mesh, "bad.file"));
    let MeshError { file, defect } = whole.expect_err("a bad file was accepted");
    assert_eq!(file, "bad.file");
    defect
}

#[test]
fn files_cut_off_are_refused() {
    for kind in KINDS {
        let bytes = written(&cuboid(), kind);
        let short = &bytes[..bytes.len() - 40];
        if matches!(kind, Kind::Obj) {
            // An OBJ file has neither an end mark nor counts, so a missing part only shows as a hole.
            let (_, found) = findings(&read_bytes(short, Format::Obj, "f").unwrap().0);
            assert!(matches!(found[..], [Finding::NotWatertight(_)]), "{found:?}");
            continue;
        }
        let found = defect(short, kind.format());
        assert!(matches!(found, Defect::WrongLength { .. } | Defect::Syntax(_)), "{kind:?}: {found:?}");
    }
}

#[test]
fn headers_that_promise_too_much_are_refused_without_the_memory() {
    let mut stl = written(&cuboid(), Kind::StlBinary);
    stl[80..84].copy_from_slice(&(u32::MAX - 1).to_le_bytes());
    assert!(matches!(defect(&stl, Format::Stl), Defect::WrongLength { .. }));
    for count in ["4000000000", "18446744073709551615"] {
        let ply = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n\
             property float z\nelement face {count}\nproperty list uint int vertex_indices\nend_header\n"
        );
        assert!(matches!(defect(ply.as_bytes(), Format::Ply), Defect::WrongLength { .. }));
        let nothing = format!("ply\nformat ascii 1.0\nelement vertex {count}\nend_header\n");
        assert!(matches!(defect(nothing.as_bytes(), Format::Ply), Defect::Syntax(_)));
        let list = "ply\nformat ascii 1.0\nelement x 1\nproperty list uint int y\nend_header\n4000000000 1 2\n";
        assert!(matches!(defect(list.as_bytes(), Format::Ply), Defect::Syntax(_)));
    }
}

#[test]
fn bad_numbers_and_indices_are_refused_by_place() {
    let with = |change: &dyn Fn(&mut Mesh)| {
        let mut mesh = cuboid();
        change(&mut mesh);
        repair(&mesh, "bad.file").map(|_| ()).unwrap_err().to_string()
    };
    let nan = with(&|mesh| mesh.vertices[5].y = f32::NAN);
    assert_eq!(nan, "bad.file: vertex 5 has a coordinate that is not a finite number");
    assert!(with(&|mesh| mesh.vertices[0].x = f32::INFINITY).contains("vertex 0"));
    let index = with(&|mesh| mesh.faces[3][1] = 8);
    assert_eq!(index, "bad.file: face 3 names vertex 8, but there are 8 vertices");
    assert!(with(&|mesh| mesh.faces.clear()).contains("no faces"));
    assert!(with(&|mesh| mesh.vertices.fill(Vec3::ONE)).contains("no faces with an area"));
    assert!(
        with(&|mesh| mesh.vertices.iter_mut().for_each(|v| *v *= 0.01))
            .contains("largest side is 0.600 mm, but it must be from 5 to 600 mm")
    );
    assert!(with(&|mesh| mesh.vertices.iter_mut().for_each(|v| *v *= 1e6)).contains("largest side is 60000."));
    let obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n";
    assert!(matches!(defect(obj, Format::Obj), Defect::Syntax(text) if text.contains("vertex that does not exist")));
}

fn findings(mesh: &Mesh) -> (Mesh, Vec<Finding>) {
    let (clean, warnings) = repair(mesh, "f").unwrap();
    (clean, warnings.into_iter().map(|warning| warning.finding).collect())
}

#[test]
fn millimetres_inverted_normals_and_mixed_windings_are_repaired() {
    let expected = cuboid();
    let mut large = cuboid();
    large.vertices.iter_mut().for_each(|v| *v *= 1000.0);
    let (clean, found) = findings(&large);
    assert!(matches!(found[..], [Finding::ScaledFromMillimetres { extent }] if extent == 60.0));
    assert!((clean.volume_m3() - expected.volume_m3()).abs() < 1e-10);

    let mut inverted = cuboid();
    inverted.faces.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
    let (clean, found) = findings(&inverted);
    assert_eq!(found, [Finding::Inverted]);
    assert!(clean.volume_m3() > 0.0);

    // Any faces may be turned, also the one at which the search begins.
    for turned in [vec![0], vec![5], vec![0, 3, 7, 11]] {
        let mut mixed = cuboid();
        for &face in &turned {
            mixed.faces[face].swap(1, 2);
        }
        let (clean, found) = findings(&mixed);
        assert_eq!(found, [Finding::InconsistentWinding(turned.len())]);
        assert!((clean.volume_m3() - expected.volume_m3()).abs() < 1e-10);
    }
}

#[test]
fn small_parts_duplicates_slivers_and_holes_are_reported() {
    let mut crumb = cuboid();
    let first = crumb.vertices.len() as u32;
    crumb.vertices.extend(cuboid().vertices.iter().map(|v| *v * 0.1 + Vec3::X));
    crumb.faces.extend(cuboid().faces.iter().map(|face| face.map(|v| v + first)));
    let (clean, found) = findings(&crumb);
    assert_eq!((clean.vertices.len(), clean.faces.len()), (8, 12));
    assert!(
        matches!(found[..], [Finding::Components { dropped: 1, area_share }] if (area_share - 0.01 / 1.01).abs() < 1e-4)
    );

    let mut twice = cuboid();
    twice.faces.push([2, 3, 0]);
    twice.faces.push([4, 4, 5]);
    let (clean, found) = findings(&twice);
    assert_eq!(found, [Finding::DegenerateFaces(1), Finding::DuplicateFaces(1)]);
    assert_eq!(clean.faces.len(), 12);

    // A fold without thickness on a closed surface: both of its faces are dropped.
    let mut fold = cuboid();
    fold.vertices.push(Vec3::new(-0.01, -0.01, 0.03));
    fold.faces.extend([[0, 4, 8], [4, 0, 8]]);
    let (clean, found) = findings(&fold);
    assert_eq!(found, [Finding::DuplicateFaces(2)]);
    assert!(clean.edges().watertight());

    let mut open = cuboid();
    open.faces.pop();
    assert_eq!(findings(&open).1, [Finding::NotWatertight(EdgeCount { open: 3, crowded: 0 })]);
}

#[test]
fn a_one_sided_band_is_refused() {
    let n = 12;
    let vertices = (0..n)
        .flat_map(|i| {
            let angle = std::f32::consts::TAU * i as f32 / n as f32;
            let ring = Vec3::new(angle.cos(), angle.sin(), 0.0);
            let across = ring * (0.5 * angle).cos() + Vec3::Z * (0.5 * angle).sin();
            [ring * 0.05 + across * 0.01, ring * 0.05 - across * 0.01]
        })
        .collect();
    // The last pair meets the first one upside down.
    let at = |i: u32, side: u32| if i == n { 1 - side } else { 2 * i + side };
    let faces =
        (0..n).flat_map(|i| [[at(i, 0), at(i + 1, 0), at(i + 1, 1)], [at(i, 0), at(i + 1, 1), at(i, 1)]]).collect();
    let error = repair(&Mesh { vertices, faces }, "band.obj").unwrap_err();
    assert!(matches!(error.defect, Defect::NotOrientable), "{error}");
}

#[test]
fn missing_files_and_other_formats_are_refused_by_name() {
    let missing = read(std::path::Path::new("/no/such/file.stl")).unwrap_err();
    assert!(missing.to_string().starts_with("/no/such/file.stl: "), "{missing}");
    assert!(matches!(read(std::path::Path::new("thing.gltf")).unwrap_err().defect, Defect::UnknownFormat));
    for format in [Format::Stl, Format::Ply] {
        assert!(matches!(defect(b"", format), Defect::Syntax(_)));
    }
    assert!(matches!(defect(b"", Format::Obj), Defect::NoFaces));
}

/// Reads and repairs any bytes. An accepted mesh must be sound.
fn survives(bytes: &[u8], format: Format) {
    let Ok((mesh, _)) = read_bytes(bytes, format, "fuzz") else { return };
    // At most one vertex for each byte, so memory is bounded by the file.
    assert!(mesh.vertices.len() <= bytes.len() && mesh.faces.len() <= bytes.len());
    if let Ok((clean, _)) = repair(&mesh, "fuzz") {
        assert!(!clean.faces.is_empty() && clean.vertices.iter().all(|v| v.is_finite()));
        assert!(clean.faces.iter().flatten().all(|&v| (v as usize) < clean.vertices.len()));
        assert!(clean.volume_m3() > -1e-6 * clean.area_m2() && clean.area_m2() > 0.0);
        assert!(clean.extents_m().max_element() <= 0.6);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, rng_seed: RngSeed::Fixed(2), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        kind in 0..KINDS.len(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0_u8..4), 1..8),
    ) {
        let mut bytes = written(&cuboid(), KINDS[kind]);
        for (place, value, how) in edits {
            if bytes.is_empty() {
                break;
            }
            let at = place.index(bytes.len());
            match how {
                0 => bytes[at] = value,
                1 => bytes[at] ^= 1 << (value % 8),
                2 => bytes.truncate(at),
                _ => bytes.insert(at, value),
            }
        }
        survives(&bytes, KINDS[kind].format());
    }

    #[test]
    fn damaged_words_never_panic(
        kind in prop::sample::select(vec![Kind::Obj, Kind::StlText, Kind::PlyText]),
        place in any::<prop::sample::Index>(),
        word in prop::sample::select(vec![
            "nan", "inf", "-1", "1e999", "18446744073709551616", "-9223372036854775808", "", "\u{00e9}", "f", "vertex", "0", "list",
        ]),
    ) {
        let text = String::from_utf8(written(&cuboid(), kind)).unwrap();
        let mut words: Vec<&str> = text.split(' ').collect();
        let at = place.index(words.len());
        words[at] = word;
        survives(words.join(" ").as_bytes(), kind.format());
    }

    #[test]
    fn noise_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..400), format in 0..3) {
        let format = [Format::Obj, Format::Stl, Format::Ply][format as usize];
        survives(&bytes, format);
    }

    #[test]
    fn triangle_soups_are_repaired_or_refused(
        points in prop::collection::vec((0_u8..4, 0_u8..4, 0_u8..4), 3..12),
        triples in prop::collection::vec((0_u32..14, 0_u32..14, 0_u32..14), 0..40),
    ) {
        let vertices = points.iter().map(|&(x, y, z)| Vec3::new(x.into(), y.into(), z.into()) * 0.02).collect();
        let faces = triples.iter().map(|&(a, b, c)| [a, b, c]).collect();
        if let Ok((clean, _)) = repair(&Mesh { vertices, faces }, "soup") {
            assert!(clean.volume_m3() > -1e-6 * clean.area_m2());
            // A second repair changes nothing.
            let (again, warnings) = repair(&clean, "soup").unwrap();
            assert_eq!(corners(&again), corners(&clean));
            assert_eq!(again.vertices.len(), clean.vertices.len());
            let quiet = warnings.iter().all(|warning| matches!(warning.finding, Finding::NotWatertight(_)));
            assert!(quiet, "{warnings:?}");
        }
    }
}
