//! Connected parts of a mesh.

use mvt_mesh::Mesh;

/// The connected part of a mesh with the largest area, without the vertices of the others. Faces that share a vertex are connected.
pub(super) fn largest_component(mesh: &Mesh) -> Mesh {
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    for &[a, b, c] in &mesh.faces {
        for other in [b, c] {
            let (a, b) = (root(&mut parent, a), root(&mut parent, other));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut area = vec![0.0f64; mesh.vertices.len()];
    for (&[v, _, _], [a, b, c]) in mesh.faces.iter().zip(mesh.triangles()) {
        area[root(&mut parent, v) as usize] += f64::from((b - a).cross(c - a).length());
    }
    // The first of the largest, so that ties do not depend on anything else.
    let Some(largest) = (0..area.len()).max_by(|&i, &j| area[i].total_cmp(&area[j]).then(j.cmp(&i))) else {
        return Mesh::default();
    };
    let mut vertices = Vec::new();
    let index: Vec<u32> = (0..mesh.vertices.len())
        .map(|v| {
            if root(&mut parent, v as u32) as usize == largest {
                vertices.push(mesh.vertices[v]);
            }
            (vertices.len() as u32).saturating_sub(1)
        })
        .collect();
    let kept = mesh.faces.iter().filter(|face| root(&mut parent, face[0]) as usize == largest);
    Mesh { faces: kept.map(|face| face.map(|v| index[v as usize])).collect(), vertices }
}

/// The lowest vertex of a part, as far as parts are known.
fn root(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        let above = parent[parent[vertex as usize] as usize];
        parent[vertex as usize] = above;
        vertex = above;
    }
    vertex
}
