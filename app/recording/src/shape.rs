//! Blocks of shapes: a mesh and a coarse grid of signed distances for slices.

use glam::Vec3;
use mvt_mesh::Mesh;
use mvt_run::report::ShapePoint;
use mvt_run::sdf_grid::SdfGrid;

/// Estimated shape at a frame, in the object's coordinates.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RecordedShape {
    /// Number of the frame.
    pub frame: u64,
    /// The surface.
    pub mesh: Mesh,
    /// Signed distances around it.
    pub sdf: Option<SdfGrid>,
    /// Its scores, where the true shape is known.
    pub point: Option<ShapePoint>,
}

/// Size of the head of a block: counts of vertices and faces, whether there is a grid, its counts, first node and cell.
const HEAD_BYTES: usize = 4 * (3 + 3 + 4);
/// Most nodes of a grid along an axis.
const LARGEST_GRID: usize = 1024;

/// Encodes a mesh and distances around it: head, vertices (f32), faces (u32), distances (i8). Little-endian.
pub fn encode(mesh: &Mesh, sdf: Option<&SdfGrid>) -> Vec<u8> {
    let mut block = Vec::with_capacity(HEAD_BYTES + 12 * (mesh.vertices.len() + mesh.faces.len()));
    let (counts, low, cell_m) = sdf.map_or(([0; 3], Vec3::ZERO, 0.0), |sdf| (sdf.counts, sdf.low, sdf.cell_m));
    for count in
        [mesh.vertices.len() as u32, mesh.faces.len() as u32, u32::from(sdf.is_some())].into_iter().chain(counts)
    {
        block.extend(count.to_le_bytes());
    }
    for number in low.to_array().into_iter().chain([cell_m]) {
        block.extend(number.to_le_bytes());
    }
    block.extend(mesh.vertices.iter().flat_map(Vec3::to_array).flat_map(f32::to_le_bytes));
    block.extend(mesh.faces.iter().flatten().flat_map(|corner| corner.to_le_bytes()));
    block.extend(sdf.iter().flat_map(|sdf| &sdf.values).map(|value| *value as u8));
    block
}

/// Decodes the mesh and the distances of a block.
pub fn decode(block: &[u8]) -> Result<(Mesh, Option<SdfGrid>), &'static str> {
    let (head, body) = block.split_at_checked(HEAD_BYTES).ok_or("a shape ends in the middle")?;
    let (words, _) = head.as_chunks::<4>();
    let counts: [u32; 6] = std::array::from_fn(|k| u32::from_le_bytes(words[k]));
    let numbers: [f32; 4] = std::array::from_fn(|k| f32::from_le_bytes(words[6 + k]));
    let [vertices, faces, has_grid, columns, rows, layers] = counts;
    let grid = [columns, rows, layers].map(|count| count as usize);
    if grid.iter().any(|&count| count > LARGEST_GRID) {
        return Err("the grid of a shape is too large");
    }
    // In u64 none of these can overflow.
    let nodes = grid.iter().map(|&count| count as u64).product::<u64>();
    let expected = 12 * (u64::from(vertices) + u64::from(faces)) + nodes;
    if expected != body.len() as u64 {
        return Err("the size of a shape differs from its head");
    }
    let (coordinates, body) = body.split_at(12 * vertices as usize);
    let (corners, values) = body.split_at(12 * faces as usize);
    let vector = |bytes: &[[u8; 4]]| Vec3::from_array(std::array::from_fn(|k| f32::from_le_bytes(bytes[k])));
    let vertices: Vec<Vec3> = coordinates.as_chunks::<4>().0.chunks_exact(3).map(vector).collect();
    let face = |bytes: &[[u8; 4]]| std::array::from_fn(|k| u32::from_le_bytes(bytes[k]));
    let faces: Vec<[u32; 3]> = corners.as_chunks::<4>().0.chunks_exact(3).map(face).collect();
    if faces.iter().flatten().any(|&corner| corner as usize >= vertices.len()) {
        return Err("a face names a vertex that does not exist");
    }
    if vertices.iter().any(|vertex| vertex.is_nan() || vertex.length_squared() > 1e4) {
        return Err("invalid vertex");
    }
    let [x, y, z, cell_m] = numbers;
    let low = Vec3::new(x, y, z);
    if has_grid != 0 && (!low.is_finite() || !cell_m.is_normal() || cell_m < 0.0 || grid.contains(&0)) {
        return Err("invalid grid of distances");
    }
    let sdf = (has_grid != 0).then(|| SdfGrid {
        low,
        cell_m,
        counts: [columns, rows, layers],
        values: values.iter().map(|&value| value as i8).collect(),
    });
    Ok((Mesh { vertices, faces }, sdf))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn example() -> (Mesh, SdfGrid) {
        let mesh = Mesh {
            vertices: vec![Vec3::ZERO, Vec3::new(0.1, 0.25, -1e-7), Vec3::Y, Vec3::NEG_Z],
            faces: vec![[0, 1, 2], [0, 2, 3]],
        };
        // The distance from the plane x = 1 mm.
        let values = (0..3 * 4 * 2).map(|k| ((k % 3) * 8 - 4) as i8).collect();
        (mesh, SdfGrid { low: Vec3::splat(-0.001), cell_m: 0.002, counts: [3, 4, 2], values })
    }

    #[test]
    fn shapes_are_decoded_without_loss() {
        let (mesh, sdf) = example();
        assert_eq!(decode(&encode(&mesh, Some(&sdf))).unwrap(), (mesh.clone(), Some(sdf)));
        assert_eq!(decode(&encode(&mesh, None)).unwrap(), (mesh, None));
    }

    #[test]
    fn distances_are_interpolated_only_within_the_grid() {
        let (_, sdf) = example();
        for x_mm in [-1.0f32, -0.3, 0.0, 1.9, 3.0] {
            let point = Vec3::new(x_mm, 0.4, 0.1) * 1e-3;
            assert!((sdf.distance_m(point).unwrap() - x_mm * 1e-3).abs() < 1e-7, "{x_mm}");
        }
        for outside in [Vec3::splat(-0.0011), Vec3::new(0.0, 0.0, 0.0011), Vec3::NAN, Vec3::INFINITY] {
            assert_eq!(sdf.distance_m(outside), None);
        }
    }

    #[test]
    fn a_grid_with_countless_nodes_is_refused() {
        let (mesh, sdf) = example();
        let mut block = encode(&mesh, Some(&sdf));
        block[12..24].fill(0xff);
        assert_eq!(decode(&block), Err("the grid of a shape is too large"));
    }

    proptest! {
        #[test]
        fn damaged_shapes_are_errors_or_other_shapes(
            at in any::<prop::sample::Index>(),
            byte in any::<u8>(),
            cut in any::<bool>(),
        ) {
            let (mesh, sdf) = example();
            let mut block = encode(&mesh, Some(&sdf));
            let at = at.index(block.len());
            if cut { block.truncate(at) } else { block[at] = byte }
            if let Ok((mesh, _)) = decode(&block) {
                prop_assert_eq!(mesh.triangles().count(), mesh.faces.len());
            }
        }
    }
}
