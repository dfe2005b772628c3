//! Objects with thin walls, such as cups: their unseen inside is mostly air.

use glam::{UVec3, Vec3};

use super::{CAVITY_DEPTH_M, Space, cells, flatten, neighbour};

/// Most cells from one side of a thin wall to the other. Surface counts as seen one cell around the measured points, so that a wall of
/// 2 mm takes four to six.
const THIN_CELLS: usize = 7;
/// Bodies of as many cells are not followed to their other side.
const THICK_CELLS: usize = 40;
/// Cells from the end of a cavity, which is deep below the hull, to the wall beside it.
const BESIDE_CELLS: usize = 6;
/// Places at which a thin wall was seen from both sides, so that an object has thin walls.
const LEAST_PLACES: usize = 60;
/// A wall that no sensor has seen, such as the foot of a cup, lies up to this far below the hull of the seen points, metres.
const CLOSING_DEPTH_M: f32 = 0.004;
/// An unseen wall ends at the cavity or at a seen surface behind it within this distance, metres.
const BEHIND_M: f32 = 0.06;

impl Space {
    /// Whether a hollow object has thin walls: at most places where both sides of a wall were seen, they are near to each other. `cavity` are
    /// cells deep below the hull that were looked through.
    pub(super) fn is_thin_walled(&self, cavity: &[UVec3]) -> bool {
        let mut is_cavity = vec![false; self.passes.len()];
        cavity.iter().for_each(|&cell| is_cavity[flatten(cell)] = true);
        let (mut thin, mut thick) = (0, 0);
        for &cell in cavity {
            let sides = (0..6).filter(|&side| neighbour(cell, side).is_some_and(|beside| !is_cavity[flatten(beside)]));
            match sides.filter_map(|side| self.thickness(cell, side)).min() {
                Some(crossed) if crossed <= THIN_CELLS => thin += 1,
                Some(_) => thick += 1,
                None => {}
            }
        }
        thin >= LEAST_PLACES && thin > thick
    }

    /// Thickness in cells of the body beside a cell of a cavity; `None` where one of its surfaces was not seen.
    fn thickness(&self, cell: UVec3, side: usize) -> Option<usize> {
        let ahead = |cell: &UVec3| neighbour(*cell, side);
        let mut beside = std::iter::successors(ahead(&cell), ahead).map(flatten);
        let first = beside.by_ref().take(BESIDE_CELLS).find(|&i| !self.is_open_at(i))?;
        let body: Vec<usize> =
            std::iter::once(first).chain(beside).take(THICK_CELLS).take_while(|&i| !self.is_open_at(i)).collect();
        let ends_are_seen = self.near_surface[first] && body.last().is_some_and(|&last| self.near_surface[last]);
        (ends_are_seen && body.len() < THICK_CELLS).then_some(body.len())
    }

    /// Whether an unseen cell of an object with thin walls belongs to a wall: it lies little below a side of the hull, and no surface was seen
    /// behind it.
    pub(super) fn closes_a_wall(&self, centre: Vec3) -> bool {
        let mut sides = self.directions.iter().zip(&self.support_m);
        sides.any(|(outwards, support)| {
            support - outwards.dot(centre) < CLOSING_DEPTH_M && self.is_open_behind(centre, *outwards)
        })
    }

    /// Whether no surface was seen behind a point before a cavity begins.
    fn is_open_behind(&self, point: Vec3, outwards: Vec3) -> bool {
        let steps = (BEHIND_M / self.cell_m()) as usize;
        let behind = (1..=steps).filter_map(|k| self.index(point - outwards * (k as f32 * self.cell_m())));
        let end = behind.map(|i| (self.near_surface[i], self.is_open_at(i))).find(|(surface, open)| *surface || *open);
        end.is_none_or(|(surface, _)| !surface)
    }

    /// Cells deep below the hull of the seen points that sensors looked through, given the depth of each cell.
    pub(super) fn seen_cavity(&self, depths_m: &[f32]) -> Vec<UVec3> {
        let is_deep = |i: usize| self.is_open_at(i) && depths_m[i] > CAVITY_DEPTH_M;
        cells().filter(|&cell| is_deep(flatten(cell))).collect()
    }
}
