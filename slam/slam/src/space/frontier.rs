//! The frontier: where the presumed inside of the object borders on space outside, and no surface was seen.

use glam::{IVec3, UVec3, Vec3};

use super::{CELLS, Space, flatten, neighbours};

/// A piece of surface that no sensor has seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrontierPatch {
    /// Its middle, in the frame of the field, metres.
    pub centre: Vec3,
    /// The direction out of the object, a unit vector.
    pub normal: Vec3,
    /// Its area, square metres.
    pub area_m2: f32,
}

impl Space {
    /// Returns the surface that must lie somewhere and that no sensor has seen: the border between the unseen inside and the space outside.
    pub fn frontier(&self) -> Vec<FrontierPatch> {
        let mut inside = vec![false; self.passes.len()];
        let unseen = self.unseen();
        let unseen_inside = unseen.iter().filter(|unseen| unseen.assumed.is_object());
        let cells: Vec<UVec3> = unseen_inside.filter_map(|unseen| self.cell(unseen.centre)).collect();
        for &cell in &cells {
            inside[flatten(cell)] = true;
        }
        let is_open = |cell: UVec3| !inside[flatten(cell)] && !self.near_surface[flatten(cell)];
        let area_m2 = self.cell_m() * self.cell_m();
        let patch = |cell: UVec3| {
            if !neighbours(cell).any(is_open) {
                return None;
            }
            let outwards = around(cell).filter(|&(near, _)| is_open(near)).map(|(_, step)| step.as_vec3().normalize());
            let normal = outwards.sum::<Vec3>().try_normalize()?;
            Some(FrontierPatch { centre: self.centre(cell), normal, area_m2 })
        };
        cells.into_iter().filter_map(patch).collect()
    }
}

/// The cells that share a face, an edge or a corner with a cell, with the steps to them.
fn around(cell: UVec3) -> impl Iterator<Item = (UVec3, IVec3)> {
    let steps = (0..27).map(|k| IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1)).filter(|step| *step != IVec3::ZERO);
    steps.filter_map(move |step| {
        let near = cell.as_ivec3() + step;
        (near.min_element() >= 0 && near.max_element() < CELLS as i32).then(|| (near.as_uvec3(), step))
    })
}
