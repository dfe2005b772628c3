//! Valid files of every kind, and the checksums that make mutated ones plausible again.

use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;
use std::sync::LazyLock;

use crate::trial::Original;
use crate::workplace::Workplace;

/// Folder with a short run in `out`, with a small field and few rays, so that its files are read fast.
static RUN: LazyLock<Workplace> = LazyLock::new(|| {
    let workplace = Workplace::new();
    let small = "--set slam.field.levels=[8] --set slam.scan.camera_hits=60 --set slam.scan.camera_misses=30 --set mesh_cell_mm=8";
    workplace
        .run(&format!(
            "run --object rubiks_cube_small --touch-depth truth --duration 0.4 --cameras side --quiet {small}"
        ))
        .good();
    workplace
});

/// Copies the folder of a short run.
pub fn copy_run(to: &Path) {
    for (file, bytes) in RUN.files("out") {
        let path = to.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

/// Returns a file of a short run.
pub fn of_run(file: &str) -> Vec<u8> {
    fs::read(RUN.path("out").join(file)).unwrap()
}

/// Returns a safetensors file twice: with its checksum, which finds every mutation but those of the header's first bytes, and without.
pub fn with_and_without_seal(bytes: Vec<u8>) -> [Original; 2] {
    const SEAL: &[u8] = b"\"checksum\":";
    let mut open = bytes.clone();
    if let Some(at) = bytes.windows(SEAL.len()).position(|window| window == SEAL) {
        // Another entry of the same length, which readers ignore.
        open[at..at + SEAL.len()].copy_from_slice(b"\"whatever\":");
    }
    [Original::new(bytes), Original::new(open)]
}

/// Sets the checksums of an MCAP file's chunks to 0, which means that there are none.
pub fn mcap_without_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 9) {
        let (is_chunk, length) = (head[0] == 6, u64::from_le_bytes(head[1..].try_into().unwrap()));
        if let Some(checksum) = bytes.get_mut(at + 33..at + 37).filter(|_| is_chunk) {
            checksum.fill(0);
        }
        at = usize::try_from(length)
            .ok()
            .and_then(|length| at.checked_add(9)?.checked_add(length))
            .unwrap_or(usize::MAX - 9);
    }
    bytes
}

/// Makes an archive of these files.
fn stored(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for &(name, bytes) in files {
        archive.start_file(name, options).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// Makes an archive with one array.
pub fn npz(array: &[u8]) -> Vec<u8> {
    stored(&[("depth.npy", array)])
}

/// Makes an archive with a small array of depths and the array as their scale.
pub fn npz_scale(array: &[u8]) -> Vec<u8> {
    stored(&[("depth.npy", npy("(2, 12, 16, )", 2 * 12 * 16).as_slice()), ("depth_scale.npy", array)])
}

/// Returns an array of f4 in NumPy's format.
pub fn npy(shape: &str, count: usize) -> Vec<u8> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16 + 1).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.push(b'\n');
    bytes.extend((0..count).flat_map(|k| (0.3 + 1e-3 * k as f32).to_le_bytes()));
    bytes
}

/// Computes the checksums of the chunks of a PNG file anew.
pub fn png_with_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    const SIGNATURE: usize = 8;
    let mut at = SIGNATURE;
    while let Some(length) = bytes.get(at..at + 4) {
        let length = u32::from_be_bytes(length.try_into().unwrap()) as usize;
        let end = at + 8 + length;
        let Some(chunk) = bytes.get(at + 4..end) else { break };
        let checksum = crc32fast::hash(chunk).to_be_bytes();
        let Some(place) = bytes.get_mut(end..end + 4) else { break };
        place.copy_from_slice(&checksum);
        at = end + 4;
    }
    bytes
}

/// Puts the checksums of the stored files of an archive into its directory, as far as it can be read.
pub fn zip_with_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    const ENTRY: &[u8] = b"PK\x01\x02";
    let number = |bytes: &[u8], at: usize, size: usize| -> Option<usize> {
        Some(bytes.get(at..at + size)?.iter().rev().fold(0, |sum, &byte| sum << 8 | usize::from(byte)))
    };
    let entries: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at..].starts_with(ENTRY)).collect();
    for entry in entries {
        let checksum = (|| {
            let (size, local) = (number(&bytes, entry + 20, 4)?, number(&bytes, entry + 42, 4)?);
            let start = local + 30 + number(&bytes, local + 26, 2)? + number(&bytes, local + 28, 2)?;
            bytes.get(start..start.checked_add(size)?).map(crc32fast::hash)
        })();
        if let Some((checksum, place)) = checksum.zip(bytes.get_mut(entry + 16..entry + 20)) {
            place.copy_from_slice(&checksum.to_le_bytes());
        }
    }
    bytes
}

/// Returns pictures of every kind of a size, as PNG or JPEG.
pub fn pictures(format: image::ImageFormat) -> Vec<Vec<u8>> {
    let colour = image::RgbImage::from_fn(60, 80, |x, y| image::Rgb([x as u8, 3 * y as u8, (x * y) as u8]));
    let colour = image::DynamicImage::ImageRgb8(colour);
    let mut kinds = vec![image::DynamicImage::ImageLuma8(colour.to_luma8()), colour];
    if format == image::ImageFormat::Png {
        kinds.extend([kinds[1].to_luma16().into(), kinds[1].to_rgba16().into(), kinds[1].to_luma_alpha8().into()]);
    }
    let encoded = |kind: &image::DynamicImage| {
        let mut bytes = Cursor::new(Vec::new());
        kind.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    kinds.iter().map(encoded).collect()
}

/// Computes the checksums of a recording's blocks anew, which stand in its tables.
pub fn seal_blocks(recording: &Path) {
    for (table, blocks) in
        [("about.json", "shapes.bin"), ("shapes.jsonl", "shapes.bin"), ("frames.jsonl", "images.bin")]
    {
        let blocks = fs::read(recording.join(blocks)).unwrap();
        let text = fs::read_to_string(recording.join(table)).unwrap();
        let mut values = serde_json::Deserializer::from_str(&text).into_iter::<serde_json::Value>();
        let mut sealed = String::new();
        while let Some(Ok(mut value)) = values.next() {
            seal_value(&mut value, &blocks);
            sealed += &format!("{value}\n");
        }
        fs::write(recording.join(table), sealed).unwrap();
    }
}

fn seal_value(value: &mut serde_json::Value, blocks: &[u8]) {
    let number =
        |value: &serde_json::Value, key| value.get(key).and_then(serde_json::Value::as_u64).map(|n| n as usize);
    if let (Some(at), Some(bytes), Some(_)) = (number(value, "at"), number(value, "bytes"), number(value, "crc32"))
        && let Some(block) = blocks.get(at..at.saturating_add(bytes))
    {
        value["crc32"] = crc32fast::hash(block).into();
    } else if let Some(fields) = value.as_object_mut() {
        fields.values_mut().for_each(|field| seal_value(field, blocks));
    }
}

/// Returns a box of 40 x 50 x 60 mm as OBJ, STL in text and binary, and PLY in text and binary.
pub fn meshes(format: mvt_mesh::Format) -> Vec<Vec<u8>> {
    let vertices: Vec<[f32; 3]> =
        (0..8).map(|i| [(i & 1) as f32 * 0.04, (i >> 1 & 1) as f32 * 0.05, (i >> 2) as f32 * 0.06]).collect();
    let faces: [[usize; 3]; 12] = [
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
    let line = |[x, y, z]: [f32; 3]| format!("{x} {y} {z}\n");
    let bytes = |[x, y, z]: [f32; 3]| [x.to_le_bytes(), y.to_le_bytes(), z.to_le_bytes()].concat();
    match format {
        mvt_mesh::Format::Obj => {
            let lines = vertices.iter().map(|&v| format!("v {}", line(v)));
            let quad = ["f -8 -6 -5\n".to_owned(), "vt 0 1\nvn 0 0 1\nf 1/1/1 2//1 4/1\n".to_owned()];
            let faces = faces.iter().map(|[a, b, c]| format!("f {} {}// {}\n", a + 1, b + 1, c + 1));
            vec![lines.chain(faces).chain(quad).collect::<String>().into_bytes()]
        }
        mvt_mesh::Format::Stl => {
            let corners = |face: &[usize; 3]| face.map(|v| format!("vertex {}", line(vertices[v]))).concat();
            let facet = |face| format!("facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n", corners(face));
            let text: String = faces.iter().map(facet).collect();
            let mut binary = vec![b' '; 80];
            binary.extend((faces.len() as u32).to_le_bytes());
            for face in &faces {
                binary.extend([0; 12]);
                face.iter().for_each(|&v| binary.extend(bytes(vertices[v])));
                binary.extend([0; 2]);
            }
            vec![format!("solid box\n{text}endsolid box\n").into_bytes(), binary]
        }
        mvt_mesh::Format::Ply => {
            let header = |encoding: &str| {
                format!(
                    "ply\nformat {encoding} 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\nelement face 12\n\
                     property list uchar int vertex_indices\nend_header\n"
                )
            };
            let lines =
                vertices.iter().map(|&v| line(v)).chain(faces.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n")));
            let mut binary = header("binary_little_endian").into_bytes();
            vertices.iter().for_each(|&v| binary.extend(bytes(v)));
            for face in &faces {
                binary.push(3);
                face.iter().for_each(|&v| binary.extend((v as u32).to_le_bytes()));
            }
            vec![(header("ascii") + &lines.collect::<String>()).into_bytes(), binary]
        }
        other => panic!("{other:?}"),
    }
}
