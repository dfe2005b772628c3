//! Files that other programs write, each of which was once read wrongly or refused for a false reason.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a failed assumption in a test is a failed test"
)]

use std::fmt::Write as _;

use crate::prism::{CUBOID_M3, Prism, cuboid, defect, load, stl_binary};
use mvt_mesh::{Defect, Finding, Format, read, repair};

#[test]
fn lines_and_points_are_no_faces() {
    let box_obj = cuboid().obj();
    let helix: String =
        (0..40).map(|i| format!("v {} {} {}\n", (0.5 * i as f32).cos(), (0.5 * i as f32).sin(), i)).collect();
    let indices: String = (9..49).map(|i| format!(" {i}")).collect();
    for lines in [
        "l 1 2\n",
        "l 1 2 3\n",
        "l 1 2 7 8 1\n",
        "l 1/1 2/1 7/1\n",
        "p 1\n",
        "p 1 2 7\n",
        &format!("{helix}o curve\nl{indices}\n"),
    ] {
        let (mesh, findings) = load(format!("{box_obj}{lines}"), Format::Obj).unwrap();
        assert!(findings.is_empty(), "{lines}: {findings:?}");
        assert!((mesh.volume_m3() / CUBOID_M3 - 1.0).abs() < 1e-5, "{lines}");
    }
    let alone: String = box_obj.lines().filter(|line| line.starts_with('v')).map(|line| format!("{line}\n")).collect();
    assert!(defect(alone.clone() + "l 1 2 3 4\n", Format::Obj).contains("lines or points but no faces"));
    assert!(
        defect(alone + "cstype bezier\nsurf 0 1 0 1 1 2 3 4\n", Format::Obj)
            .contains("free-form surfaces but no faces")
    );
    let (_, findings) = load(box_obj + "surf 0 1 0 1 1 2 3 4\n", Format::Obj).unwrap();
    assert_eq!(findings, [Finding::FreeFormSurfaces(1)]);
}

#[test]
fn obj_text_of_every_kind_is_read() {
    let text = cuboid().obj();
    let utf16 =
        |bytes: fn(u16) -> [u8; 2]| format!("\u{feff}{text}").encode_utf16().flat_map(bytes).collect::<Vec<u8>>();
    let faces = |end: &str| {
        text.lines().map(|line| format!("{line}{}\n", if line.starts_with('f') { end } else { "" })).collect::<String>()
    };
    let vertices = |end: &str| {
        text.lines().map(|line| format!("{line}{}\n", if line.starts_with('v') { end } else { "" })).collect::<String>()
    };
    for (what, bytes) in [
        ("face goes on", text.replace(" 3 2 1", " 3 \\\n 2 \\  \r\n1").into_bytes()),
        ("vertex goes on", text.replace(" 0.06 ", "\\\n0.06 ").into_bytes()),
        ("normal goes on", (text.clone() + "vn 0 0 \\\n1\n").into_bytes()),
        ("comment ends with a backslash", ("# C:\\models\\\n".to_owned() + &text).into_bytes()),
        ("name ends with a backslash", ("mtllib C:\\models\\\no part\\\n".to_owned() + &text).into_bytes()),
        ("comment on the line", faces(" # side \\").into_bytes()),
        ("comment without a space", faces("#side").into_bytes()),
        ("mark", [b"\xef\xbb\xbf", text.as_bytes()].concat()),
        ("UTF-16, little", utf16(u16::to_le_bytes)),
        ("UTF-16, big", utf16(u16::to_be_bytes)),
        ("CR", text.replace('\n', "\r").into_bytes()),
        ("CR LF", text.replace('\n', "\r\n").into_bytes()),
        ("end of DOS", [text.as_bytes(), b"\x1a"].concat()),
        ("Latin-1", [b"o W\xfcrfel\nusemtl gr\xfcn\n", text.as_bytes()].concat()),
        ("weight", vertices(" 1.0").into_bytes()),
        ("colour", vertices(" 0.1 0.2 0.3").into_bytes()),
        ("colour with opacity", vertices(" 0.1 0.2 0.3 1").into_bytes()),
        ("colour of the first vertex", text.replacen("v 0 0 0", "v 0 0 0 1 1 1", 1).into_bytes()),
        ("tabs", text.replace(' ', "\t").into_bytes()),
        ("capitals", text.to_uppercase().into_bytes()),
        ("old name of faces", text.replace("f ", "fo ").into_bytes()),
        ("curves", (text.clone() + "cstype bezier\ndeg 3\ncurv 0 1 1 2 3 4\nparm u 0 1\nend\n").into_bytes()),
    ] {
        let (mesh, findings) = load(&bytes, Format::Obj).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert!(findings.is_empty(), "{what}: {findings:?}");
        assert!((mesh.volume_m3() / CUBOID_M3 - 1.0).abs() < 1e-5, "{what}");
    }
}

#[test]
fn faults_of_a_text_are_named_by_line() {
    let text = cuboid().obj();
    let obj = |bad: &str| defect(format!("# \\\n\n{text}f 1 2 \\\n3\n{bad}\nf 1 2 3\n"), Format::Obj);
    // Two lines, eight vertices, six faces and a face on two lines stand before the bad one.
    for (bad, part) in [
        ("v 0,06 0,02 0,0", "line 19: \"v 0,06 0,02 0,0\" is not three numbers with decimal points"),
        ("v 1 2", "line 19: \"v 1 2\""),
        ("v 1 2 3 0", "weight 0"),
        ("v 1 2 3 4 5", "five numbers"),
        ("f 1 2 x", "line 19: \"f 1 2 x\" is not a face of whole numbers"),
        ("f 1 2 -9", "line 19: a face names vertex -9"),
        ("f 1 2 0", "line 19: a face names vertex 0"),
        ("f 1 2 9", "line 19: a face names vertex 9, a vertex that does not exist; the file has 8"),
    ] {
        let said = obj(bad);
        assert!(said.contains(part), "{said}");
    }
    let stl =
        |bad: &str| defect(format!("solid\nfacet normal 0 0 1\nouter loop\nvertex {bad}\nendsolid\n"), Format::Stl);
    assert!(stl("0,1 0,2 0,3").contains("line 4: \"vertex 0,1 0,2 0,3\" is not three numbers with decimal points"));
    let ply = |from: &str, to: &str| defect(cuboid().ply_text().replacen(from, to, 1), Format::Ply);
    for (from, to, part) in [
        ("0.06 0 0", "0,06 0,0 0,0", "line 11: \"0,06 0,0 0,0\" has no valid \"x\" of element \"vertex\""),
        ("0.06 0 0", "0.06 0", "line 11: \"0.06 0\" has no valid \"z\""),
        ("4 3 2 1 0", "4 3 2 1", "line 18: \"4 3 2 1\" has no valid \"vertex_indices\""),
        ("4 3 2 1 0", "-4 3 2 1 0", "line 18"),
        ("0 0 0", "comment\n0 0 0", "line 10: \"comment\""),
        ("property float x", "property real x", "line 4: \"property real x\""),
    ] {
        let said = ply(from, to);
        assert!(said.contains(part), "{said}");
    }
}

/// The box as text STL.
fn stl_text() -> String {
    let mut text = "solid part\n".to_owned();
    for corners in cuboid().corners() {
        text += "facet normal 0 0 0\nouter loop\n";
        corners.iter().for_each(|v| writeln!(text, "vertex {} {} {}", v.x, v.y, v.z).unwrap());
        text += "endloop\nendfacet\n";
    }
    text + "endsolid part\n"
}

#[test]
fn stl_of_every_kind_is_read() {
    let text = stl_text();
    let binary = stl_binary("solid made by a program, one facet each", &cuboid().corners());
    let (first, second) = text.split_at(text.match_indices("endfacet\n").nth(5).unwrap().0 + 9);
    for (what, bytes) in [
        ("capitals", text.to_uppercase().into_bytes()),
        ("capitals at the end", text.replace("endsolid", "ENDSOLID").into_bytes()),
        ("mark", [b"\xef\xbb\xbf", text.as_bytes()].concat()),
        ("UTF-16", text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>()),
        ("CR", text.replace('\n', "\r").into_bytes()),
        ("end of DOS", [text.as_bytes(), b"\x1a"].concat()),
        ("two solids", format!("{first}endsolid part\nsolid vertex facet\n{second}").into_bytes()),
        ("long name", text.replace("part", &"/".repeat(2000)).into_bytes()),
        ("one line for a facet", text.replace("\nouter", " outer").replace("\nvertex", " vertex").into_bytes()),
        ("undefined normal", text.replace("normal 0 0 0", "normal -nan(ind) -1.#IND nan").into_bytes()),
        ("binary", binary.clone()),
    ] {
        let bytes = if what == "UTF-16" { [&[0xff, 0xfe], &bytes[..]].concat() } else { bytes };
        let (mesh, findings) = load(&bytes, Format::Stl).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert!(findings.is_empty(), "{what}: {findings:?}");
        assert!((mesh.volume_m3() / CUBOID_M3 - 1.0).abs() < 1e-5, "{what}");
    }

    let with_count = |count: u32, more: &[u8]| {
        let mut bytes = [&binary[..], more].concat();
        bytes[80..84].copy_from_slice(&count.to_le_bytes());
        bytes
    };
    let uncounted = |promised| Finding::Uncounted { promised, held: 12 };
    for (bytes, expected) in [
        (with_count(12, b"\r\n"), vec![Finding::TrailingBytes(2)]),
        (with_count(12, &[0; 500]), vec![Finding::TrailingBytes(500)]),
        (with_count(12, b"made by hand"), vec![Finding::TrailingBytes(12)]),
        (with_count(0, b""), vec![uncounted(0)]),
        (with_count(u32::MAX, b""), vec![uncounted(u32::MAX)]),
        (with_count(u32::MAX, b"\n"), vec![uncounted(u32::MAX), Finding::TrailingBytes(1)]),
    ] {
        let (mesh, findings) = load(bytes, Format::Stl).unwrap();
        assert_eq!(findings, expected);
        assert!((mesh.volume_m3() / CUBOID_M3 - 1.0).abs() < 1e-5);
    }
    for count in [11, 13, 774_905_944] {
        assert!(
            defect(with_count(count, b""), Format::Stl)
                .contains(&format!("promises {count} triangles, but the file has 600 bytes, enough for 12"))
        );
    }
    assert!(defect(&with_count(0, b"")[..84], Format::Stl).contains("no faces"));
    let page = format!("<html>{}</html>", "not found ".repeat(20));
    assert!(defect(page, Format::Stl).contains("the text does not begin with \"solid\""));
}

#[test]
fn ply_of_every_kind_is_read() {
    let prism = cuboid();
    let text = prism.ply_text();
    let (header, body) = text.split_once("end_header\n").unwrap();
    let wide = |more: &str, columns: &str| {
        let header = header.replace("property float z\n", &format!("property float z\n{more}"));
        let rows = body.lines().enumerate().map(|(i, line)| format!("{line}{}\n", if i < 8 { columns } else { "" }));
        format!("{header}end_header\n{}", rows.collect::<String>()).into_bytes()
    };
    let binary = prism.ply_binary();
    let at = binary.windows(11).position(|word| word == b"end_header\n").unwrap();
    let with_end = |end: &str| {
        [
            String::from_utf8(binary[..at].to_vec()).unwrap().replace('\n', end).as_bytes(),
            b"end_header",
            end.as_bytes(),
            &binary[at + 11..],
        ]
        .concat()
    };
    // The first byte of the data looks like the end of a line.
    let mut line_feed = Prism { vertices: prism.vertices.clone(), faces: prism.faces.clone() };
    line_feed.vertices[0].x = f32::from_le_bytes([b'\n', 0, 0, 0]);
    let line_feed = String::from_utf8_lossy(&line_feed.ply_binary()[..at + 11])
        .replace('\n', "\r")
        .into_bytes()
        .into_iter()
        .chain(line_feed.ply_binary()[at + 11..].iter().copied())
        .collect();
    let with_track = |is_first: bool| {
        let track = "element track 1\nproperty list ushort float descriptor\n";
        let data = [&2000_u16.to_le_bytes()[..], &[0x0a; 8000]].concat();
        let header = String::from_utf8(binary[..at].to_vec()).unwrap();
        let (before, rest) = header.split_at(header.find("element").unwrap());
        let body = &binary[at + 11..];
        match is_first {
            true => [before.as_bytes(), track.as_bytes(), rest.as_bytes(), b"end_header\n", &data, body].concat(),
            false => [header.as_bytes(), track.as_bytes(), b"end_header\n", body, &data].concat(),
        }
    };
    for (what, bytes) in [
        ("capitals", text.replace("ply\n", "PLY \n").into_bytes()),
        ("mark", [b"\xef\xbb\xbf", text.as_bytes()].concat()),
        ("UTF-16", [&[0xff, 0xfe], &text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>()[..]].concat()),
        ("CR", text.replace('\n', "\r").into_bytes()),
        ("CR LF", text.replace('\n', "\r\n").into_bytes()),
        ("mixed", text.replace("end_header\n", "end_header\r\n").into_bytes()),
        ("binary after CR LF", with_end("\r\n")),
        ("binary after CR", with_end("\r")),
        ("binary after CR that begins with LF", line_feed),
        ("version 1", text.replace("1.0", "1").into_bytes()),
        ("blank lines", text.replace("end_header\n", "end_header\n\n").into_bytes()),
        ("undefined normals", wide("property float nx\nproperty float ny\n", " -nan(ind) 1.#QNAN")),
        ("name with a space", wide("property float scalar_Scalar field\n", " 1")),
        ("64 bits", text.replace("list int int", "list uint8 int64").into_bytes()),
        ("other name", text.replace("vertex_indices", "vertex_indexes").into_bytes()),
        ("long foreign list, first", with_track(true)),
        ("long foreign list, last", with_track(false)),
        ("trailing bytes", [&binary[..], &[0; 9]].concat()),
        (
            "unknown point",
            text.replace("element vertex 8", "element vertex 9")
                .replace("4 3 2 1 0", "nan nan nan\n4 3 2 1 0")
                .into_bytes(),
        ),
        (
            "far point",
            text.replace("element vertex 8", "element vertex 9")
                .replace("4 3 2 1 0", "1e38 1e38 1e38\n4 3 2 1 0")
                .into_bytes(),
        ),
    ] {
        let (mesh, findings) = load(&bytes, Format::Ply).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert!(findings.is_empty(), "{what}: {findings:?}");
        assert!((mesh.volume_m3() / CUBOID_M3 - 1.0).abs() < 1e-5, "{what}");
    }
    let in_a_face = text.replace("element vertex 8", "element vertex 9").replace("4 3 2 1 0", "nan nan nan\n4 3 2 1 8");
    assert!(defect(in_a_face, Format::Ply).contains("vertex 8 has a coordinate that is not a finite number"));
}

#[test]
fn a_line_of_a_ply_text_is_one_entry() {
    let text = cuboid().ply_text();
    let face_columns: String =
        text.lines().map(|line| format!("{line}{}\n", if line.starts_with("4 ") { " 9 1 1 1" } else { "" })).collect();
    let vertex_columns = text.replace("0.06 0.02 0\n", "0.06 0.02 0 0 0 1\n");
    for (text, line, count) in [(face_columns, 18, 6), (vertex_columns, 12, 1)] {
        let (mesh, findings) = load(text, Format::Ply).unwrap();
        assert_eq!(findings, [Finding::SurplusNumbers { line, count }]);
        assert!((mesh.volume_m3() / CUBOID_M3 - 1.0).abs() < 1e-5);
    }
}

#[test]
fn units_are_asked_for_where_the_size_does_not_tell_them() {
    let folder = tempfile::tempdir().unwrap();
    let load_scaled = |side: f32, unit: &str| {
        let scale = side / 0.06;
        let mut prism = cuboid();
        prism.vertices.iter_mut().for_each(|v| *v *= scale);
        let path = folder.path().join("box.obj");
        std::fs::write(&path, prism.obj()).unwrap();
        let path = folder.path().join(format!("box.obj{unit}"));
        let (raw, _) = read(&path).unwrap();
        repair(&raw, "box.obj")
            .map(|(mesh, warnings)| (1e3 * mesh.extents_m().max_element(), warnings.len()))
            .map_err(|error| error.defect)
    };
    let close = |found: Result<(f32, usize), Defect>, side_mm: f32, warnings: usize| {
        let (found_mm, count) = found.unwrap();
        assert!((found_mm - side_mm).abs() < 1e-3 && count == warnings, "{found_mm} mm, {count} warnings");
    };
    close(load_scaled(0.06, ""), 60.0, 0);
    close(load_scaled(60.0, ""), 60.0, 1);
    for side in [1.5, 3.937, 10.0, 30.0] {
        let defect = load_scaled(side, "").unwrap_err();
        assert!(matches!(defect, Defect::AmbiguousUnit { .. }), "{defect}");
    }
    assert!(
        load_scaled(10.0, "")
            .unwrap_err()
            .to_string()
            .contains("10 units: centimetres, millimetres or inches? give the unit")
    );
    for side in [1.0, 1e5] {
        let said = load_scaled(side, "").unwrap_err().to_string();
        assert!(said.contains("give its unit behind the name of the file"), "{said}");
    }
    for (side, unit, side_mm) in [
        (0.06, ":m", 60.0),
        (0.6, ":dm", 60.0),
        (10.0, ":cm", 100.0),
        (10.0, ":mm", 10.0),
        (100.0, ":mm", 100.0),
        (1e5, ":um", 100.0),
        (4.0, ":in", 101.6),
    ] {
        close(load_scaled(side, unit), side_mm, 0);
    }
    // The box of 60 mm, a kilometre away.
    let far = cuboid().obj().replace("v 0", "v 1000");
    assert!(matches!(load(far, Format::Obj).unwrap().1[..], [Finding::FarFromOrigin { reach_m }] if reach_m > 1000.0));
    assert!(matches!(read(&folder.path().join("box.obj:yard")).unwrap_err().defect, Defect::UnknownFormat));
}
