//! Decomposition of objects that are hollow around a vertical axis: cups, bowls, mugs.
//!
//! Half-planes through the axis and level planes cut the solid into small cells. In each cell the solid is one or more
//! stretches along the radius (wall, handle), so a cavity is never part of a cell. Cells are nearly convex. Neighbours
//! are then merged, the best pair first, as long as the hull of the merged cells stays close to the solid in them.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

use glam::{Vec2, Vec3};
use mvt_mesh::Mesh;

use super::hull::Hull;

/// Number of half-planes through the axis.
const SECTORS: usize = 48;
/// Number of level planes, number of those that are evenly spaced, and number of heights among which the others are
/// chosen.
const LEVELS: usize = 33;
const EVEN_LEVELS: usize = 12;
const SAMPLES: usize = 400;
/// Initial limit for the ratio of a merged piece's hull to its solid.
const SLACK: f64 = 1.2;

/// Stretch of solid along a radius, from the axis outward, metres.
#[derive(Clone, Copy)]
struct Run {
    from: f32,
    to: f32,
}

/// Cells that were merged.
struct Piece {
    points: Vec<Vec3>,
    /// Volume of the cells in it, m^3.
    solid_m3: f64,
    neighbours: BTreeSet<usize>,
}

/// Returns the convex pieces of a watertight mesh, if possible at most `max_pieces`.
pub(super) fn decompose(mesh: &Mesh, max_pieces: usize) -> Vec<Hull> {
    let mut pieces = merge(cells(mesh), max_pieces);
    // Drops scraps below a ten-thousandth, which arise where a stretch ends between two planes.
    let whole: f64 = pieces.iter().map(|piece| piece.solid_m3).sum();
    pieces.retain(|piece| piece.solid_m3 > 1e-4 * whole);
    pieces.iter().filter_map(|piece| Hull::of(&piece.points).ok()).collect()
}

/// Returns the vertical line through the centre of mass. It lies in the cavity also if a handle shifts the bounding
/// box.
fn axis(mesh: &Mesh) -> Vec2 {
    let (mut moment, mut volume) = (glam::DVec2::ZERO, 0.0);
    for corners in mesh.triangles() {
        let [a, b, c] = corners.map(Vec3::as_dvec3);
        let six_fold = a.dot(b.cross(c));
        moment += six_fold * (a + b + c).truncate() / 4.0;
        volume += six_fold;
    }
    (moment / volume).as_vec2()
}

/// Returns the segments in which a level plane cuts the surface, relative to the axis, each with the solid on its left.
fn section(mesh: &Mesh, axis: Vec2, level: f32) -> impl Iterator<Item = [Vec2; 2]> {
    mesh.triangles().filter_map(move |[a, b, c]| {
        // A segment runs along z x n for the outward normal n: from the falling edge of the face to the rising edge.
        let mut ends = [None; 2];
        for [p, q] in [[a, b], [b, c], [c, a]] {
            if (p.z >= level) != (q.z >= level) {
                let at = p.truncate().lerp(q.truncate(), (level - p.z) / (q.z - p.z)) - axis;
                ends[usize::from(p.z < level)] = Some(at);
            }
        }
        Some([ends[0]?, ends[1]?])
    })
}

/// Returns the heights of the level planes, denser where the section changes, because a floor is thinner than the even
/// spacing.
fn levels(mesh: &Mesh, axis: Vec2) -> Vec<f32> {
    let [low, high] = mesh.bounds_m();
    let height = |sample: usize| low.z + (high.z - low.z) * (sample as f32 + 0.5) / SAMPLES as f32;
    let area = |sample: usize| section(mesh, axis, height(sample)).map(|[p, q]| 0.5 * p.perp_dot(q)).sum::<f32>();
    let areas: Vec<f32> = (0..SAMPLES).map(area).collect();
    let mut chosen: BTreeSet<usize> = (0..SAMPLES).step_by(SAMPLES / EVEN_LEVELS).chain([SAMPLES - 1]).collect();
    while chosen.len() < LEVELS {
        let below = chosen.iter().zip(chosen.iter().skip(1));
        let misses = below.flat_map(|(&from, &to)| {
            let areas = &areas;
            (from + 1..to).map(move |at| {
                let share = (at - from) as f32 / (to - from) as f32;
                let straight = areas[from] + share * (areas[to] - areas[from]);
                ((areas[at] - straight).abs(), at)
            })
        });
        let Some((_, worst)) = misses.max_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        chosen.insert(worst);
    }
    chosen.into_iter().map(height).collect()
}

/// Returns the solid along every radius of every level, `[level][sector]`.
fn runs(mesh: &Mesh, axis: Vec2, levels: &[f32]) -> Vec<Vec<Vec<Run>>> {
    let along = |segments: &[[Vec2; 2]], direction: Vec2| -> Vec<Run> {
        let side = |p: Vec2| direction.perp_dot(p);
        let mut crossings: Vec<f32> = segments
            .iter()
            .filter(|[p, q]| (side(*p) >= 0.0) != (side(*q) >= 0.0))
            .map(|&[p, q]| direction.dot(p.lerp(q, side(p) / (side(p) - side(q)))))
            .filter(|&radius| radius > 0.0)
            .collect();
        crossings.sort_unstable_by(f32::total_cmp);
        // The last crossing leaves the solid, so with an odd number the axis is inside.
        if crossings.len() % 2 == 1 {
            crossings.insert(0, 0.0);
        }
        crossings.chunks_exact(2).map(|run| Run { from: run[0], to: run[1] }).collect()
    };
    levels
        .iter()
        .map(|&level| {
            let segments: Vec<[Vec2; 2]> = section(mesh, axis, level).collect();
            (0..SECTORS).map(|sector| along(&segments, direction(sector))).collect()
        })
        .collect()
}

/// Returns the direction of a half-plane.
fn direction(sector: usize) -> Vec2 {
    Vec2::from_angle(std::f32::consts::TAU * sector as f32 / SECTORS as f32)
}

/// Cuts the solid into cells.
fn cells(mesh: &Mesh) -> Vec<Piece> {
    let axis = axis(mesh);
    let levels = levels(mesh, axis);
    let runs = runs(mesh, axis, &levels);

    let mut pieces: Vec<Piece> = Vec::new();
    // For every run, the cells with this edge, which are neighbours.
    let mut users: Vec<Vec<Vec<Vec<usize>>>> =
        runs.iter().map(|level| level.iter().map(|radius| vec![Vec::new(); radius.len()]).collect()).collect();
    for level in 0..levels.len() - 1 {
        for sector in 0..SECTORS {
            let corners = [(level, 0), (level, 1), (level + 1, 0), (level + 1, 1)]
                .map(|(level, next)| (level, (sector + next) % SECTORS));
            let mut edges: Vec<(Run, usize, usize, usize)> = corners
                .into_iter()
                .flat_map(|(l, s)| runs[l][s].iter().enumerate().map(move |(i, &run)| (run, l, s, i)))
                .collect();
            edges.sort_by(|a, b| a.0.from.total_cmp(&b.0.from));
            let mut rest = &edges[..];
            while let Some(first) = rest.first() {
                // Stretches that overlap along the radius are one solid.
                let mut reach = first.0.to;
                let mut count = 1;
                while let Some(next) = rest.get(count).filter(|next| next.0.from <= reach) {
                    reach = reach.max(next.0.to);
                    count += 1;
                }
                let (cell, others) = rest.split_at(count);
                rest = others;
                let points: Vec<Vec3> = cell
                    .iter()
                    .flat_map(|&(run, l, s, _)| {
                        [run.from, run.to].map(|radius| (axis + radius * direction(s)).extend(levels[l]))
                    })
                    .collect();
                let Ok(hull) = Hull::of(&points) else { continue };
                let index = pieces.len();
                pieces.push(Piece { points, solid_m3: hull.volume_m3(), neighbours: BTreeSet::new() });
                for &(_, l, s, i) in cell {
                    users[l][s][i].push(index);
                }
            }
        }
    }
    for group in users.iter().flatten().flatten() {
        for (i, &a) in group.iter().enumerate() {
            for &b in &group[i + 1..] {
                pieces[a].neighbours.insert(b);
                pieces[b].neighbours.insert(a);
            }
        }
    }
    pieces
}

/// Possible merge: the excess of the hull in parts per million of the solid, then the pair, which gives ties a fixed
/// order.
type Candidate = Reverse<(u64, usize, usize)>;

/// Merges pieces, the pair with the least excess first. Raises the limit for the excess while there are too many
/// pieces.
fn merge(pieces: Vec<Piece>, max_pieces: usize) -> Vec<Piece> {
    let mut pieces: Vec<Option<Piece>> = pieces.into_iter().map(Some).collect();
    let mut queue: BinaryHeap<Candidate> = BinaryHeap::new();
    for a in 0..pieces.len() {
        let later = pieces[a].iter().flat_map(|piece| piece.neighbours.range(a + 1..)).copied().collect::<Vec<_>>();
        queue.extend(later.into_iter().filter_map(|b| candidate(&pieces, a, b)));
    }
    let mut left = pieces.len();
    let mut slack = SLACK;
    while let Some(Reverse((excess, a, b))) = queue.pop() {
        if pieces[a].is_none() || pieces[b].is_none() {
            continue;
        }
        while left > max_pieces && excess as f64 > (slack - 1.0) * 1e6 && slack < 1e3 {
            slack *= 1.1;
        }
        if excess as f64 > (slack - 1.0) * 1e6 {
            break;
        }
        let (Some(one), Some(other)) = (pieces[a].take(), pieces[b].take()) else { continue };
        let joined = pieces.len();
        let points = [one.points, other.points].concat();
        let points = Hull::of(&points).map_or(points, |hull| hull.vertices().to_vec());
        let mut neighbours: BTreeSet<usize> = &one.neighbours | &other.neighbours;
        neighbours.remove(&a);
        neighbours.remove(&b);
        for &neighbour in &neighbours {
            if let Some(piece) = &mut pieces[neighbour] {
                piece.neighbours.remove(&a);
                piece.neighbours.remove(&b);
                piece.neighbours.insert(joined);
            }
        }
        pieces.push(Some(Piece { points, solid_m3: one.solid_m3 + other.solid_m3, neighbours: neighbours.clone() }));
        queue.extend(neighbours.into_iter().filter_map(|neighbour| candidate(&pieces, neighbour, joined)));
        left -= 1;
    }
    pieces.into_iter().flatten().collect()
}

/// Returns the merge of two pieces; `None` if one was merged already or they have no hull.
fn candidate(pieces: &[Option<Piece>], a: usize, b: usize) -> Option<Candidate> {
    let (one, other) = (pieces.get(a)?.as_ref()?, pieces.get(b)?.as_ref()?);
    let hull = Hull::of(&[&one.points[..], &other.points[..]].concat()).ok()?;
    let excess = hull.volume_m3() / (one.solid_m3 + other.solid_m3) - 1.0;
    Some(Reverse(((excess.max(0.0) * 1e6) as u64, a, b)))
}
