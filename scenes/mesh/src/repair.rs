//! Makes one closed outward surface in metres of the mesh in a file.

use std::collections::{HashMap, HashSet, VecDeque};

use glam::Vec3;

use crate::error::{Defect, MeshError};
use crate::limits::{MAX_EXTENT_M, MILLIMETRES_ABOVE_M, MILLIMETRES_FROM, MIN_EXTENT_M};
use crate::mesh::{Mesh, triangle_area_m2};
use crate::warning::{Finding, MeshWarning};
use crate::{read, seams};

/// Greatest coordinate above which single precision rounds by more than a hundredth of a millimetre, metres.
const VISIBLY_ROUNDED_ABOVE_M: f64 = 100.0;

/// Makes one clean surface of the mesh in a file, and reports the changes.
///
/// Works in this order: checks coordinates and indices; merges equal vertices, and at open edges those that lie close together; drops
/// faces without an area and duplicate faces; keeps the part with the largest area; scales a file in millimetres ([`MILLIMETRES_ABOVE_M`]); turns
/// faces until neighbours agree on the outside, and all faces if they looked inward. Reports holes and leaves them.
///
/// # Errors
/// [`MeshError`] for a defect that cannot be repaired. The error and the warnings contain `file` as the name of the
/// mesh.
pub fn repair(mesh: &Mesh, file: &str) -> Result<(Mesh, Vec<MeshWarning>), MeshError> {
    let mut findings = Vec::new();
    read::named(clean(mesh, &mut findings).map(|mesh| (mesh, findings)), file)
}

fn clean(raw: &Mesh, findings: &mut Vec<Finding>) -> Result<Mesh, Defect> {
    check(raw)?;
    let raw = merged(raw);
    let (mut mesh, mut dropped) = without_scraps(&raw);
    if mesh.edges().open > 0
        && let Some((closed, seams)) = seams::close(&raw)
    {
        findings.push(seams);
        (mesh, dropped) = without_scraps(&closed);
    }
    findings.extend(dropped);
    if mesh.faces.is_empty() {
        return Err(Defect::NoFaces);
    }

    let mut mesh = largest_part(&mesh, findings);
    let extent = f64::from(mesh.extents_m().max_element());
    if extent > MILLIMETRES_ABOVE_M {
        if extent < MILLIMETRES_FROM {
            return Err(Defect::AmbiguousUnit { extent });
        }
        mesh.vertices.iter_mut().for_each(|v| *v *= 0.001);
        findings.push(Finding::ScaledFromMillimetres { extent });
    }
    let extent_m = f64::from(mesh.extents_m().max_element());
    if !(MIN_EXTENT_M..=MAX_EXTENT_M).contains(&extent_m) {
        return Err(Defect::Size { extent_m });
    }
    let reach_m = mesh.bounds_m().iter().fold(0.0, |reach: f64, corner| reach.max(corner.abs().max_element().into()));
    if reach_m > VISIBLY_ROUNDED_ABOVE_M {
        findings.push(Finding::FarFromOrigin { reach_m });
    }

    let turned = agree_on_outside(&mut mesh.faces)?;
    if turned > 0 {
        findings.push(Finding::InconsistentWinding(turned));
    }
    // An open sheet encloses no volume; the sign of its computed volume is a rounding error.
    if mesh.volume_m3() < -1e-6 * mesh.area_m2() * extent_m {
        mesh.faces.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
        findings.push(Finding::Inverted);
    }
    let edges = mesh.edges();
    if !edges.watertight() {
        findings.push(Finding::NotWatertight(edges));
    }
    Ok(mesh)
}

/// Drops faces without an area and duplicate faces.
fn without_scraps(mesh: &Mesh) -> (Mesh, Vec<Finding>) {
    let mut findings = Vec::new();
    let mut count_dropped = |before: usize, after: usize, finding: fn(usize) -> Finding| {
        if before != after {
            findings.push(finding(before - after));
        }
    };
    let has_area = |&&[a, b, c]: &&[u32; 3]| {
        let corners = [a, b, c].map(|v| mesh.vertices[v as usize]);
        a != b && b != c && c != a && triangle_area_m2(corners) > 0.0
    };
    let solid: Vec<[u32; 3]> = mesh.faces.iter().filter(has_area).copied().collect();
    count_dropped(mesh.faces.len(), solid.len(), Finding::DegenerateFaces);
    let (all, faces) = (solid.len(), without_duplicates(solid));
    count_dropped(all, faces.len(), Finding::DuplicateFaces);
    (Mesh { vertices: mesh.vertices.clone(), faces }, findings)
}

/// Checks that all coordinates are finite and all faces name existing vertices.
///
/// # Errors
/// [`Defect::NotFinite`] or [`Defect::IndexOutOfRange`].
pub fn check(mesh: &Mesh) -> Result<(), Defect> {
    if let Some(vertex) = mesh.vertices.iter().position(|v| !v.is_finite()) {
        return Err(Defect::NotFinite { vertex });
    }
    let vertices = mesh.vertices.len();
    for (face, corners) in mesh.faces.iter().enumerate() {
        if let Some(&index) = corners.iter().find(|&&index| index as usize >= vertices) {
            return Err(Defect::IndexOutOfRange { face, index, vertices });
        }
    }
    Ok(())
}

/// Returns the same surface with one vertex for each position that a face uses, in the order of first use.
fn merged(mesh: &Mesh) -> Mesh {
    let mut known: HashMap<[u32; 3], u32> = HashMap::new();
    let mut vertices = Vec::new();
    let mut index_of = |position: Vec3| {
        // Maps -0.0 to 0.0.
        let key = (position + Vec3::ZERO).to_array().map(f32::to_bits);
        *known.entry(key).or_insert_with(|| {
            vertices.push(position);
            vertices.len() as u32 - 1
        })
    };
    let faces = mesh.faces.iter().map(|face| face.map(|v| index_of(mesh.vertices[v as usize]))).collect();
    Mesh { vertices, faces }
}

/// Keeps one of each set of faces with the same corners, in the direction of the majority. Two faces with opposite
/// directions are a fold without thickness; both are dropped, because the surface is closed without them. If this would
/// drop all faces, the mesh is a sheet exported with both sides, and the first side is kept.
fn without_duplicates(faces: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
    // Sorted corners, and whether the permutation is even.
    let key = |&[a, b, c]: &[u32; 3]| {
        let mut sorted = [a, b, c];
        sorted.sort_unstable();
        (sorted, [[a, b, c], [b, c, a], [c, a, b]].contains(&sorted))
    };
    let mut balance: HashMap<[u32; 3], i64> = HashMap::new();
    for face in &faces {
        let (corners, even) = key(face);
        *balance.entry(corners).or_default() += if even { 1 } else { -1 };
    }
    let mut kept = HashSet::new();
    let once: Vec<[u32; 3]> = faces
        .iter()
        .filter(|face| {
            let (corners, even) = key(face);
            let wanted = balance.get(&corners).copied().unwrap_or_default();
            wanted.signum() == if even { 1 } else { -1 } && kept.insert(corners)
        })
        .copied()
        .collect();
    if once.is_empty() {
        return faces.into_iter().filter(|face| kept.insert(key(face).0)).collect();
    }
    once
}

/// Returns pairs of faces that share an edge, and whether both run along it the same way, which means that they
/// disagree on the outside. Where more than two faces meet, pairs each face with the next, with `None` because such an
/// edge decides nothing.
fn neighbours(faces: &[[u32; 3]]) -> Vec<(usize, usize, Option<bool>)> {
    let mut edges: Vec<([u32; 2], usize, bool)> = Vec::with_capacity(3 * faces.len());
    for (face, &[a, b, c]) in faces.iter().enumerate() {
        edges.extend([[a, b], [b, c], [c, a]].map(|[from, to]| ([from.min(to), from.max(to)], face, from < to)));
    }
    edges.sort_unstable();
    let mut pairs = Vec::with_capacity(edges.len() / 2);
    for same in edges.chunk_by(|a, b| a.0 == b.0) {
        for pair in same.windows(2) {
            let same_way = (same.len() == 2).then_some(pair[0].2 == pair[1].2);
            pairs.push((pair[0].1, pair[1].1, same_way));
        }
    }
    pairs
}

/// Returns the part with the largest area. Faces that share an edge belong to one part.
fn largest_part(mesh: &Mesh, findings: &mut Vec<Finding>) -> Mesh {
    let mut parent: Vec<usize> = (0..mesh.faces.len()).collect();
    fn root(parent: &mut [usize], mut face: usize) -> usize {
        while parent[face] != face {
            parent[face] = parent[parent[face]];
            face = parent[face];
        }
        face
    }
    for (a, b, _) in neighbours(&mesh.faces) {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        parent[a.max(b)] = a.min(b);
    }
    let parts: Vec<usize> = (0..mesh.faces.len()).map(|face| root(&mut parent, face)).collect();
    let mut area_m2 = vec![0.0; mesh.faces.len()];
    for (&part, corners) in parts.iter().zip(mesh.triangles()) {
        area_m2[part] += triangle_area_m2(corners);
    }
    // Every kept face has an area, so every part has one.
    let count = area_m2.iter().filter(|&&area| area > 0.0).count();
    if count <= 1 {
        // Drops vertices without faces, which would widen the bounding box.
        return merged(mesh);
    }
    let largest = (0..area_m2.len()).rev().max_by(|&a, &b| area_m2[a].total_cmp(&area_m2[b])).unwrap_or(0);
    let whole: f64 = area_m2.iter().sum();
    findings.push(Finding::Components { dropped: count - 1, area_share: 1.0 - area_m2[largest] / whole });
    let faces = mesh.faces.iter().zip(&parts).filter(|&(_, &part)| part == largest).map(|(&face, _)| face).collect();
    merged(&Mesh { vertices: mesh.vertices.clone(), faces })
}

/// Turns as few faces as possible so that neighbours run along their common edge in opposite ways. Returns their
/// number.
fn agree_on_outside(faces: &mut [[u32; 3]]) -> Result<usize, Defect> {
    let mut beside: Vec<Vec<(usize, bool)>> = vec![Vec::new(); faces.len()];
    for (a, b, same_way) in neighbours(faces) {
        if let Some(same_way) = same_way {
            beside[a].push((b, same_way));
            beside[b].push((a, same_way));
        }
    }
    let mut turn: Vec<Option<bool>> = vec![None; faces.len()];
    let mut turned = 0;
    for seed in 0..faces.len() {
        if turn[seed].is_some() {
            continue;
        }
        turn[seed] = Some(false);
        let mut patch = vec![seed];
        let mut queue = VecDeque::from([(seed, false)]);
        while let Some((face, is_turned)) = queue.pop_front() {
            for &(next, same_way) in &beside[face] {
                let wanted = is_turned ^ same_way;
                match turn[next] {
                    None => {
                        turn[next] = Some(wanted);
                        patch.push(next);
                        queue.push_back((next, wanted));
                    }
                    Some(decided) if decided != wanted => return Err(Defect::NotOrientable),
                    Some(_) => {}
                }
            }
        }
        // The first face of a patch may be wrong, so the majority of the patch keeps its direction.
        let minority = patch.iter().filter(|&&face| turn[face] == Some(true)).count();
        let keep = 2 * minority <= patch.len();
        for &face in patch.iter().filter(|&&face| turn[face] == Some(keep)) {
            let [_, b, c] = &mut faces[face];
            std::mem::swap(b, c);
        }
        turned += if keep { minority } else { patch.len() - minority };
    }
    Ok(turned)
}
