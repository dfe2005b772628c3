//! Prisms as files of every format.

#![allow(dead_code, reason = "each test uses a part of it")]

use std::fmt::Write as _;

use glam::{Quat, Vec3};
use mvt_mesh::{Finding, Format, Mesh, read_bytes, repair};

/// Reads and repairs a file. Returns all findings, too.
pub fn load(bytes: impl AsRef<[u8]>, format: Format) -> Result<(Mesh, Vec<Finding>), String> {
    let (raw, read) = read_bytes(bytes.as_ref(), format, "f").map_err(|error| error.to_string())?;
    let (mesh, repaired) = repair(&raw, "f").map_err(|error| error.to_string())?;
    Ok((mesh, read.into_iter().chain(repaired).map(|warning| warning.finding).collect()))
}

pub fn defect(bytes: impl AsRef<[u8]>, format: Format) -> String {
    load(bytes, format).expect_err("a bad file was accepted")
}

/// Prism over an outline (counter-clockwise): its vertices, and its faces as polygons.
pub struct Prism {
    pub vertices: Vec<Vec3>,
    pub faces: Vec<Vec<usize>>,
}

impl Prism {
    pub fn new(outline: &[[f32; 2]], height: f32) -> Self {
        let n = outline.len();
        let vertices = [0.0, height].into_iter().flat_map(|z| outline.iter().map(move |&[x, y]| Vec3::new(x, y, z)));
        // The two sides of a bridge to a hole are inside the solid. Large outlines here have none.
        let is_bridge = |&i: &usize| {
            (0..n.min(100)).any(|j| [outline[j], outline[(j + 1) % n]] == [outline[(i + 1) % n], outline[i]])
        };
        let sides = (0..n).filter(|i| !is_bridge(i)).map(|i| vec![i, (i + 1) % n, (i + 1) % n + n, i + n]);
        let faces = [(0..n).rev().collect(), (n..2 * n).collect()].into_iter().chain(sides);
        Self { vertices: vertices.collect(), faces: faces.collect() }
    }

    /// Begins every face at another corner.
    pub fn begun_at(mut self, corner: usize) -> Self {
        self.faces.iter_mut().for_each(|face| {
            let corners = face.len();
            face.rotate_left(corner % corners);
        });
        self
    }

    pub fn turned(mut self, turn: Quat) -> Self {
        self.vertices.iter_mut().for_each(|v| *v = turn * *v);
        self
    }

    pub fn obj(&self) -> String {
        let mut text = String::new();
        self.vertices.iter().for_each(|v| writeln!(text, "v {} {} {}", v.x, v.y, v.z).unwrap());
        for face in &self.faces {
            text += "f";
            face.iter().for_each(|v| write!(text, " {}", v + 1).unwrap());
            text += "\n";
        }
        text
    }

    pub fn ply_header(&self, encoding: &str) -> String {
        format!(
            "ply\nformat {encoding} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {}\nproperty list int int vertex_indices\nend_header\n",
            self.vertices.len(),
            self.faces.len()
        )
    }

    pub fn ply_text(&self) -> String {
        let mut text = self.ply_header("ascii");
        self.vertices.iter().for_each(|v| writeln!(text, "{} {} {}", v.x, v.y, v.z).unwrap());
        for face in &self.faces {
            write!(text, "{}", face.len()).unwrap();
            face.iter().for_each(|v| write!(text, " {v}").unwrap());
            text += "\n";
        }
        text
    }

    pub fn ply_binary(&self) -> Vec<u8> {
        let mut bytes = self.ply_header("binary_little_endian").into_bytes();
        bytes.extend(self.vertices.iter().flat_map(Vec3::to_array).flat_map(f32::to_le_bytes));
        for face in &self.faces {
            bytes.extend([face.len()].iter().chain(face).flat_map(|&v| (v as i32).to_le_bytes()));
        }
        bytes
    }

    pub fn corners(&self) -> Vec<[Vec3; 3]> {
        let (mesh, _) = read_bytes(self.obj().as_bytes(), Format::Obj, "prism").unwrap();
        mesh.triangles().collect()
    }
}

/// A box of 60 x 20 x 40 mm.
pub fn cuboid() -> Prism {
    Prism::new(&[[0.0, 0.0], [0.06, 0.0], [0.06, 0.02], [0.0, 0.02]], 0.04)
}

pub const CUBOID_M3: f64 = 0.06 * 0.02 * 0.04;

pub fn stl_binary(header: &str, corners: &[[Vec3; 3]]) -> Vec<u8> {
    let mut bytes = header.as_bytes().to_vec();
    bytes.resize(80, 0);
    bytes.extend((corners.len() as u32).to_le_bytes());
    for triangle in corners {
        bytes.extend([0; 12]);
        bytes.extend(triangle.iter().flat_map(Vec3::to_array).flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}
