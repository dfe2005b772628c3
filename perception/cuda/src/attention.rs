//! Attention between all tokens of an image, or those of a window, with its scores in memory.

use std::rc::Rc;

use mvt_training::backend::WindowAttention;

use crate::gpu::{Gpu, Multiply, View, each, launch, warps};
use crate::machine::{Argument, GpuError};
use crate::memory::{DeviceArray, Real};
use crate::tape::{Node, Var, back};

/// Rows of scores start at multiples of this, so that products may read several numbers at once.
const ALIGNMENT: usize = 8;

/// Sizes of an attention.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    /// Images or windows.
    images: usize,
    tokens: usize,
    heads: usize,
    /// Channels of a head.
    size: usize,
    /// Numbers from a row of scores to the next.
    pitch: usize,
}

impl Sizes {
    fn new(qkv: &Var, heads: usize) -> Self {
        let [images, tokens, triple] = qkv.sides();
        Self { images, tokens, heads, size: triple / 3 / heads, pitch: tokens.next_multiple_of(ALIGNMENT) }
    }

    fn batch(self) -> usize {
        self.images * self.heads
    }

    /// Returns the numbers of queries.
    fn part(self) -> usize {
        self.batch() * self.tokens * self.size
    }

    fn shape(self) -> [usize; 3] {
        [self.images, self.tokens, self.heads * self.size]
    }

    fn factor(self) -> f32 {
        1.0 / (self.size as f32).sqrt()
    }

    /// Moves numbers between tokens and heads.
    fn moved(
        self,
        gpu: &Gpu,
        kernel: &'static str,
        x: &DeviceArray<Real>,
        parts: usize,
    ) -> Result<DeviceArray<Real>, GpuError> {
        let Self { images, tokens, heads, size, .. } = self;
        let y: DeviceArray<Real> = gpu.array(parts * self.part())?;
        gpu.check(&[(x.len(), y.len())])?;
        let sizes = [y.len(), images, tokens, parts, heads, size].map(Argument::from);
        let arguments: Vec<Argument> = [Argument::from(&y), x.into()].into_iter().chain(sizes).collect();
        gpu.launch(kernel, each(y.len()), &arguments)?;
        Ok(y)
    }

    /// Returns queries (0), keys (1) or values (2) of all heads: `[tokens, size]` each.
    fn view(self, heads: &DeviceArray<Real>, part: usize) -> View {
        View::new(heads, part * self.part(), self.size, self.tokens * self.size)
    }

    fn scores(self, scores: &DeviceArray<Real>) -> View {
        View::new(scores, 0, self.pitch, self.tokens * self.pitch)
    }

    /// Multiplies `[tokens, inner]` matrices to `[tokens, columns]`.
    fn multiply(self, columns: usize, inner: usize) -> Multiply {
        Multiply { batch: self.batch(), ..Multiply::new([self.tokens, columns], inner) }
    }

    /// Returns products of queries and keys.
    fn products(self, gpu: &Gpu, heads: &DeviceArray<Real>) -> Result<DeviceArray<Real>, GpuError> {
        let scores = gpu.array(self.batch() * self.tokens * self.pitch)?;
        let keys = self.view(heads, 1).transposed();
        gpu.multiply(self.view(heads, 0), keys, self.scores(&scores), self.multiply(self.tokens, self.size))?;
        Ok(scores)
    }

    /// Returns the result for the shares of the tokens.
    fn mixed(
        self,
        gpu: &Gpu,
        heads: &DeviceArray<Real>,
        shares: &DeviceArray<Real>,
    ) -> Result<DeviceArray<Real>, GpuError> {
        let mixed = gpu.array(self.part())?;
        let multiply = self.multiply(self.size, self.tokens);
        gpu.multiply(self.scores(shares), self.view(heads, 2), self.view(&mixed, 0), multiply)?;
        self.moved(gpu, "join_heads", &mixed, 1)
    }

    /// Returns the gradients by queries, keys and values, and by the scores times `factor`.
    fn unmixed(
        self,
        gpu: &Gpu,
        heads: &DeviceArray<Real>,
        shares: &DeviceArray<Real>,
        g: &DeviceArray<Real>,
    ) -> Result<[DeviceArray<Real>; 2], GpuError> {
        let g = self.moved(gpu, "split_heads", g, 1)?;
        let g_view = self.view(&g, 0);
        let by_scores: DeviceArray<Real> = gpu.array(shares.len())?;
        let values = self.view(heads, 2).transposed();
        gpu.multiply(g_view, values, self.scores(&by_scores), self.multiply(self.tokens, self.size))?;
        let (rows, factor) = (self.batch() * self.tokens, self.factor());
        launch!(gpu, "softmax_back", warps(rows), &by_scores, shares, rows, self.tokens, self.pitch, factor)?;
        let by_heads: DeviceArray<Real> = gpu.array(3 * self.part())?;
        let multiply = self.multiply(self.size, self.tokens);
        let scores = self.scores(&by_scores);
        gpu.multiply(scores, self.view(heads, 1), self.view(&by_heads, 0), multiply)?;
        gpu.multiply(scores.transposed(), self.view(heads, 0), self.view(&by_heads, 1), multiply)?;
        gpu.multiply(self.scores(shares).transposed(), g_view, self.view(&by_heads, 2), multiply)?;
        Ok([self.moved(gpu, "join_heads", &by_heads, 3)?, by_scores])
    }
}

/// Softmax attention of `heads` heads over queries, keys and values `[images, tokens, 3 width]`.
pub fn attention(gpu: &Rc<Gpu>, qkv: &Var, heads: usize) -> Var {
    let sizes = Sizes::new(qkv, heads);
    Var::compute(gpu, &sizes.shape(), [qkv], |gpu, [qkv], _| {
        let heads = sizes.moved(gpu, "split_heads", qkv.values(), 3)?;
        let shares = sizes.products(gpu, &heads)?;
        let rows = sizes.batch() * sizes.tokens;
        launch!(gpu, "softmax", warps(rows), &shares, rows, sizes.tokens, sizes.pitch, sizes.factor())?;
        let y = sizes.mixed(gpu, &heads, &shares)?;
        let gpu = gpu.clone();
        let back = back(move |g, slopes| {
            let [by_qkv, _] = sizes.unmixed(&gpu, &heads, &shares, &g)?;
            slopes.give(&qkv, by_qkv)
        });
        Ok((y, back))
    })
}

/// Attention in windows `[windows, tokens, 3 width]`, image by image, with a table of relative positions.
pub fn window_attention(gpu: &Rc<Gpu>, qkv: &Var, table: &Var, attention: &WindowAttention) -> Var {
    let &WindowAttention { heads, side, ref regions } = attention;
    let sizes = Sizes::new(qkv, heads);
    let windows = regions.len() / (side * side);
    Var::compute(gpu, &sizes.shape(), [qkv, table], |gpu: &Rc<Gpu>, [qkv, table]: [Rc<Node>; 2], _| {
        let heads = sizes.moved(gpu, "split_heads", qkv.values(), 3)?;
        let shares = sizes.products(gpu, &heads)?;
        let (rows, factor, pitch) = (sizes.batch() * sizes.tokens, sizes.factor(), sizes.pitch);
        let apart = gpu.indices(regions.iter().map(|&region| i32::from(region)))?;
        let positions = &table.parameter()?.values;
        let count = sizes.heads;
        launch!(
            gpu,
            "window_softmax",
            warps(rows),
            &shares,
            positions,
            &apart,
            rows,
            pitch,
            count,
            side,
            windows,
            factor
        )?;
        let y = sizes.mixed(gpu, &heads, &shares)?;
        let gpu = gpu.clone();
        let back = back(move |g, slopes| {
            let [by_qkv, by_scores] = sizes.unmixed(&gpu, &heads, &shares, &g)?;
            if let Some(sum) = &table.parameter()?.gradient {
                let (images, grid) = (sizes.images, warps(sum.len()));
                launch!(gpu, "table_back", grid, sum, &by_scores, images, pitch, count, side, factor)?;
            }
            slopes.give(&qkv, by_qkv)
        });
        Ok((y, back))
    })
}
