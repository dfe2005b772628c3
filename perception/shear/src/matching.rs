//! Which dot of one image is which of another.

/// A dot is looked for within this distance of where its neighbours let it expect, in pitches.
const REACH: f64 = 0.45;
/// Dots within this distance are neighbours, in pitches.
const NEIGHBOURS: f64 = 1.6;

/// Returns for each dot of the untouched image its place in another one; `None` for one that is not there. Those that lie farthest from
/// `centre` have moved least and are looked for first; others are expected to move as their neighbours have.
pub(crate) fn follow(
    untouched: &[[f64; 2]],
    seen: &[[f64; 2]],
    centre: Option<[f64; 2]>,
    pitch: f64,
) -> Vec<Option<[f64; 2]>> {
    // Why: notes/decisions/touch.md, "Dots are followed from the border inwards, then assigned anew by the fit".
    let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let mut order: Vec<usize> = (0..untouched.len()).collect();
    if let Some(centre) = centre {
        order.sort_by(|&a, &b| distance(untouched[b], centre).total_cmp(&distance(untouched[a], centre)));
    }
    let mut found = vec![None; untouched.len()];
    let mut is_taken = vec![false; seen.len()];
    for i in order {
        let start = untouched[i];
        let (mut count, mut sum) = (0.0, [0.0; 2]);
        for (neighbour, place) in untouched.iter().zip(&found) {
            if let Some(place) = place.filter(|_: &[f64; 2]| distance(start, *neighbour) < NEIGHBOURS * pitch) {
                count += 1.0;
                sum = [sum[0] + place[0] - neighbour[0], sum[1] + place[1] - neighbour[1]];
            }
        }
        let shift = sum.map(|sum| sum / f64::max(count, 1.0));
        let expected = [start[0] + shift[0], start[1] + shift[1]];
        let free = (0..seen.len()).filter(|&k| !is_taken[k]);
        let nearest = free.min_by(|&a, &b| distance(seen[a], expected).total_cmp(&distance(seen[b], expected)));
        if let Some(k) = nearest.filter(|&k| distance(seen[k], expected) < REACH * pitch) {
            is_taken[k] = true;
            found[i] = Some(seen[k]);
        }
    }
    found
}

/// Returns for each expected place the seen dot that is nearest to it, if it is within a reach and no other place is nearer to that dot.
pub(crate) fn nearest(expected: &[[f64; 2]], seen: &[[f64; 2]], reach: f64) -> Vec<Option<[f64; 2]>> {
    let square = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    let closest = |to: [f64; 2], among: &[[f64; 2]]| {
        (0..among.len()).min_by(|&a, &b| square(among[a], to).total_cmp(&square(among[b], to)))
    };
    let each = expected.iter().enumerate().map(|(i, place)| {
        let dot = seen[closest(*place, seen)?];
        (square(dot, *place) < reach * reach && closest(dot, expected) == Some(i)).then_some(dot)
    });
    each.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dot_belongs_to_the_nearest_place_alone() {
        let expected = [[0.0, 0.0], [1.0, 0.0], [5.0, 0.0]];
        let seen = [[0.9, 0.1], [5.6, 0.0]];
        assert_eq!(nearest(&expected, &seen, 2.0), [None, Some(seen[0]), Some(seen[1])]);
        assert_eq!(nearest(&expected, &seen, 0.5), [None, Some(seen[0]), None]);
        assert_eq!(nearest(&expected, &[], 0.5), [None; 3]);
    }

    /// A field that moves dots by more than half of their distance, as the gel does: strongly in the middle and little at the border.
    #[test]
    fn dots_are_followed_beyond_half_of_their_distance() {
        let places: Vec<[f64; 2]> = (0..72).map(|k| [f64::from(k % 8) * 1.38, f64::from(k / 8) * 1.38]).collect();
        let centre = [4.8, 5.5];
        let moved: Vec<[f64; 2]> = places
            .iter()
            .map(|p| {
                let square = (p[0] - centre[0]).powi(2) + (p[1] - centre[1]).powi(2);
                let fades = (-0.0805 * square).exp();
                [p[0] + 1.1 * fades, p[1] - 0.5 * fades]
            })
            .collect();
        let missing = [9, 30, 44];
        let seen: Vec<[f64; 2]> = (0..72).rev().filter(|k| !missing.contains(k)).map(|k| moved[k]).collect();
        let found = follow(&places, &seen, Some(centre), 1.38);
        for k in 0..72 {
            assert_eq!(found[k], (!missing.contains(&k)).then_some(moved[k]), "dot {k}");
        }
        // The nearest dots are often those of neighbours.
        assert_ne!(nearest(&places, &seen, 1.38), found);
    }
}
