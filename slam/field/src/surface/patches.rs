//! Which of a cell's crossed edges belong to the same sheet of the surface.
//!
//! Bit 0, 1 and 2 of a corner's number are its x, y and z in the cell. Edge 4 a + k runs along axis a; the bits of k are its
//! place along the other two axes, in their order.

/// For each set of inside corners, the sheet of each edge.
pub(super) struct Patches {
    of_edge: Vec<[u8; 12]>,
}

/// In place of a sheet: the edge does not cross the surface.
const NONE: u8 = u8::MAX;

/// x, y and z of a corner, 0 or 1.
pub(super) fn corner(number: usize) -> [usize; 3] {
    [number & 1, number >> 1 & 1, number >> 2]
}

/// The edge along `axis` at a place on the other axes, 0 or 1; the place on `axis` does not matter.
pub(super) fn edge(axis: usize, place: [usize; 3]) -> usize {
    let [first, second] = others(axis);
    4 * axis + place[first] + 2 * place[second]
}

/// The corners at the ends of an edge.
pub(super) fn ends(edge: usize) -> [usize; 2] {
    let axis = edge / 4;
    let [first, second] = others(axis);
    let start = (edge & 1) << first | (edge >> 1 & 1) << second;
    [start, start | 1 << axis]
}

fn others(axis: usize) -> [usize; 2] {
    match axis {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    }
}

impl Patches {
    /// Sheets that a cell can have: four corners may be inside without being neighbours.
    pub(super) const MOST: usize = 4;

    pub(super) fn new() -> Self {
        Self { of_edge: (0..=u8::MAX).map(sheets).collect() }
    }

    /// The sheet of an edge, from 0, in a cell whose inside corners have their bit set in `inside`.
    pub(super) fn of(&self, inside: u8, edge: usize) -> Option<usize> {
        let sheet = self.of_edge[usize::from(inside)][edge];
        (sheet != NONE).then_some(usize::from(sheet))
    }
}

/// Joins crossed edges face by face. The rule sees only the corners of the face, so that the cells on both sides agree; inside
/// corners across a diagonal of a face are apart.
fn sheets(inside: u8) -> [u8; 12] {
    let is_inside = |corner: usize| inside >> corner & 1 == 1;
    let crossed = |edge: usize| {
        let [start, end] = ends(edge);
        is_inside(start) != is_inside(end)
    };
    let mut sheet: [usize; 12] = std::array::from_fn(|edge| edge);
    let mut join = |a: usize, b: usize| {
        let (from, to) = (sheet[a].max(sheet[b]), sheet[a].min(sheet[b]));
        sheet.iter_mut().filter(|sheet| **sheet == from).for_each(|sheet| *sheet = to);
    };
    for axis in 0..3 {
        let [u, v] = others(axis);
        for side in 0..2 {
            let at = |on_u: usize, on_v: usize| {
                let mut place = [0; 3];
                (place[axis], place[u], place[v]) = (side, on_u, on_v);
                place
            };
            let edges = [edge(u, at(0, 0)), edge(v, at(1, 0)), edge(u, at(0, 1)), edge(v, at(0, 0))];
            let crossings: Vec<usize> = edges.into_iter().filter(|&edge| crossed(edge)).collect();
            match crossings[..] {
                [a, b] => join(a, b),
                [_, _, _, _] => {
                    for (on_u, on_v) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let [x, y, z] = at(on_u, on_v);
                        if is_inside(x | y << 1 | z << 2) {
                            join(edge(u, at(on_u, on_v)), edge(v, at(on_u, on_v)));
                        }
                    }
                }
                _ => {}
            }
        }
    }
    // Number them from 0 in the order of their lowest edge.
    let mut names = Vec::new();
    std::array::from_fn(|edge| {
        if !crossed(edge) {
            return NONE;
        }
        let name = names.iter().position(|&name| name == sheet[edge]).unwrap_or_else(|| {
            names.push(sheet[edge]);
            names.len() - 1
        });
        name as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inside_corners_across_a_diagonal_are_apart() {
        let count = |corners: &[usize]| {
            let inside = corners.iter().fold(0, |inside, corner| inside | 1 << corner);
            let patches = Patches::new();
            (0..12).filter_map(|edge| patches.of(inside, edge)).max().map_or(0, |last| last + 1)
        };
        assert_eq!(count(&[]), 0);
        assert_eq!(count(&[0, 1, 2, 3, 4, 5, 6, 7]), 0);
        assert_eq!(count(&[0]), 1);
        assert_eq!(count(&[0, 1]), 1, "along an edge");
        assert_eq!(count(&[0, 3]), 2, "across a face");
        assert_eq!(count(&[0, 7]), 2, "across the cell");
        assert_eq!(count(&[1, 2, 4, 5, 6, 7]), 1, "all but two across a face");
        assert_eq!(count(&[0, 3, 5, 6]), Patches::MOST);
    }
}
