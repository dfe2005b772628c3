//! Places of tokens in windows and squares.

// Why: notes/decisions/touch.md, "Windows are lists of tokens".
/// Windows of a block of `swin` over the tokens of a map. The map is padded below and to the right to whole windows, then shifted cyclically
/// up and to the left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShiftedWindows {
    /// Token at each place, window by window and row by row; `None` is padding.
    pub tokens: Vec<Option<usize>>,
    /// Region of each place. A place attends to those of its own region in its window: others are no neighbours in the map.
    pub regions: Vec<u8>,
}

impl ShiftedWindows {
    /// Divides a map into windows of `side` tokens a side. They are shifted by half a side, but not along an axis with a single window.
    pub fn new([rows, columns]: [usize; 2], side: usize, is_shifted: bool) -> Self {
        let padded = [rows, columns].map(|count| count.next_multiple_of(side));
        let shift = padded.map(|count| if is_shifted && count > side { side / 2 } else { 0 });
        let region =
            |axis: usize, at: usize| u8::from(at >= padded[axis] - side) + u8::from(at >= padded[axis] - shift[axis]);
        let (mut tokens, mut regions) = (Vec::new(), Vec::new());
        for top in (0..padded[0]).step_by(side) {
            for left in (0..padded[1]).step_by(side) {
                for (i, j) in (top..top + side).flat_map(|i| (left..left + side).map(move |j| (i, j))) {
                    let (row, column) = ((i + shift[0]) % padded[0], (j + shift[1]) % padded[1]);
                    tokens.push((row < rows && column < columns).then_some(row * columns + column));
                    regions.push(3 * region(0, i) + region(1, j));
                }
            }
        }
        Self { tokens, regions }
    }

    /// Returns the place of each of the map's `count` tokens.
    pub fn places(&self, count: usize) -> Vec<Option<usize>> {
        let mut places = vec![None; count];
        for (place, token) in self.tokens.iter().enumerate() {
            if let Some(to) = token.and_then(|token| places.get_mut(token)) {
                *to = Some(place);
            }
        }
        places
    }
}

/// Returns the row in the table of relative positions for a query and a key, places in a window of `side` tokens a side.
pub fn relative_position(side: usize, query: usize, key: usize) -> usize {
    let along = |query: usize, key: usize| query + side - 1 - key;
    along(query / side, key / side) * (2 * side - 1) + along(query % side, key % side)
}

/// Returns the tokens of the squares of 2 x 2 tokens of a map, square by square and row by row; `None` beyond the map.
pub fn squares([rows, columns]: [usize; 2]) -> Vec<Option<usize>> {
    let token = |row: usize, column: usize| (row < rows && column < columns).then_some(row * columns + column);
    let corners = (0..rows).step_by(2).flat_map(|row| (0..columns).step_by(2).map(move |column| (row, column)));
    corners
        .flat_map(|(row, column)| {
            [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(down, right)| token(row + down, column + right))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_hold_every_token_once_and_only_neighbours_attend() {
        for (size, is_shifted) in [([6, 8], false), ([6, 8], true), ([3, 7], true), ([20, 15], true), ([1, 1], true)] {
            let (side, count) = (3, size[0] * size[1]);
            let windows = ShiftedWindows::new(size, side, is_shifted);
            let mut tokens: Vec<usize> = windows.tokens.iter().copied().flatten().collect();
            tokens.sort_unstable();
            assert!(tokens.into_iter().eq(0..count), "{size:?}");
            let places = windows.places(count);
            assert!(places.iter().enumerate().all(|(token, place)| windows.tokens[place.unwrap()] == Some(token)));
            for (tokens, regions) in windows.tokens.chunks(9).zip(windows.regions.chunks(9)) {
                for (a, b) in (0..81).map(|k| (k / 9, k % 9)).filter(|&(a, b)| regions[a] == regions[b]) {
                    let (Some(a), Some(b)) = (tokens[a], tokens[b]) else { continue };
                    let apart = |a: usize, b: usize| a.abs_diff(b) < side;
                    assert!(apart(a / size[1], b / size[1]) && apart(a % size[1], b % size[1]), "{size:?}: {a}, {b}");
                }
            }
        }
    }

    #[test]
    fn squares_reach_beyond_odd_maps() {
        assert_eq!(squares([1, 3]), [Some(0), Some(1), None, None, Some(2), None, None, None]);
    }
}
