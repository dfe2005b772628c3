//! Maps and tokens in memory.

use mvt_products::multiply::{LANES, Windows};

/// Pixels row by row with their channels side by side, in a frame of zeros if convolutions read it; or tokens, first one per patch, then
/// those without a patch. Channels beyond those of the network are zero.
#[derive(Debug, Clone, Default)]
pub(super) struct FeatureMap {
    pub(super) height: usize,
    pub(super) width: usize,
    /// Numbers of a pixel.
    pub(super) channels: usize,
    /// Width of the frame.
    halo: usize,
    /// Tokens behind the last row; only without a frame.
    extra: usize,
    pub(super) data: Vec<f32>,
}

impl FeatureMap {
    /// Returns zeros with a frame for convolutions.
    pub(super) fn framed([height, width]: [usize; 2], channels: usize) -> Self {
        Self::new(height, width, channels.next_multiple_of(LANES), 1, 0)
    }

    /// Returns zeros without a frame: `height * width` tokens and `extra` more.
    pub(super) fn tokens([height, width]: [usize; 2], extra: usize, channels: usize) -> Self {
        Self::new(height, width, channels.next_multiple_of(LANES), 0, extra)
    }

    /// Returns zeros with a frame of `halo` pixels.
    pub(super) fn with_halo([height, width]: [usize; 2], halo: usize, channels: usize) -> Self {
        Self::new(height, width, channels.next_multiple_of(LANES), halo, 0)
    }

    /// Copies tokens without a frame into the frame of this map.
    pub(super) fn copy_rows(&mut self, tokens: &Self) {
        let row = self.width * self.channels;
        for (k, from) in tokens.data.chunks_exact(row).enumerate() {
            let at = self.at(k, 0);
            self.data[at..at + row].copy_from_slice(from);
        }
    }

    /// Copies the first `width` channels of other tokens by their indices, as many pieces side by side as a token of this map takes; zeros
    /// where there is no token.
    pub(super) fn gather(&mut self, from: &Self, width: usize, tokens: &[Option<usize>]) {
        let pieces = tokens.len() / self.count().max(1);
        for (to, tokens) in self.data.chunks_exact_mut(self.channels).zip(tokens.chunks_exact(pieces.max(1))) {
            for (to, token) in to.chunks_exact_mut(width).zip(tokens) {
                match token {
                    Some(token) => to.copy_from_slice(&from.data[token * from.channels..][..width]),
                    None => to.fill(0.0),
                }
            }
        }
    }

    /// Adds tokens to those of this map that `tokens` names.
    pub(super) fn scatter_add(&mut self, from: &Self, tokens: &[Option<usize>]) {
        for (from, token) in from.data.chunks_exact(from.channels).zip(tokens) {
            if let Some(token) = token {
                let to = &mut self.data[token * self.channels..][..from.len()];
                to.iter_mut().zip(from).for_each(|(to, x)| *to += x);
            }
        }
    }

    /// Returns zeros for an image of the sensor. Its few channels are not padded to a whole vector.
    pub(super) fn image([height, width]: [usize; 2], channels: usize, halo: usize) -> Self {
        Self::new(height, width, channels.next_multiple_of(2), halo, 0)
    }

    fn new(height: usize, width: usize, channels: usize, halo: usize, extra: usize) -> Self {
        let pixels = (height + 2 * halo) * (width + 2 * halo) + extra;
        Self { height, width, channels, halo, extra, data: vec![0.0; pixels * channels] }
    }

    /// Returns the distance from a row to the next, in numbers.
    pub(super) fn pitch(&self) -> usize {
        (self.width + 2 * self.halo) * self.channels
    }

    /// Returns the index of a pixel.
    pub(super) fn at(&self, row: usize, column: usize) -> usize {
        (row + self.halo) * self.pitch() + (column + self.halo) * self.channels
    }

    /// Returns the number of tokens, those without a patch included.
    pub(super) fn count(&self) -> usize {
        self.height * self.width + self.extra
    }

    /// Returns each pixel by itself; tokens lie in one row, those without a patch included.
    pub(super) fn pixels(&self) -> Windows {
        let (columns, rows) = if self.halo == 0 { (self.count(), 1) } else { (self.width, self.height) };
        Windows { first: self.at(0, 0), step: self.channels, pitch: self.pitch(), columns, rows, segment_pitch: 0 }
    }

    /// Returns each pixel by itself, row by row, without the tokens that have no patch.
    pub(super) fn rows(&self) -> Windows {
        Windows { columns: self.width, rows: self.height, ..self.pixels() }
    }

    /// Returns squares of `side` pixels without overlap, one segment per row of a square.
    pub(super) fn patches(&self, side: usize) -> Windows {
        Windows {
            first: self.at(0, 0),
            step: side * self.channels,
            pitch: side * self.pitch(),
            columns: self.width / side,
            rows: self.height / side,
            segment_pitch: self.pitch(),
        }
    }

    /// Returns squares of 3 x 3 pixels around every pixel, or around every second pixel of every second row.
    pub(super) fn neighbourhoods(&self, stride: usize) -> Windows {
        debug_assert_eq!(self.halo, 1, "a convolution reads the frame");
        Windows {
            first: 0,
            step: stride * self.channels,
            pitch: stride * self.pitch(),
            columns: self.width.div_ceil(stride),
            rows: self.height.div_ceil(stride),
            segment_pitch: self.pitch(),
        }
    }
}
