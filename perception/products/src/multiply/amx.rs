//! Products in the tiles of Intel's AMX: 16 windows by 16 columns by 32 bf16 numbers in one instruction.
//!
//! Rust's intrinsics for AMX are not stable, hence assembly. A product configures the thread's tiles when it begins and releases them
//! when it ends, so that no tile is in use outside [`run`].

use std::arch::asm;

use pulp::{NullaryFnOnce, x86::V4};

use super::packed::{TILE_WORDS, WIDTH};
use super::product::Product;
use crate::detect::has_amx;

/// Windows of a tile.
const ROWS: usize = 16;
/// Windows that are multiplied by all panels before the next ones, so that they stay in the cache.
const BLOCK: usize = 128;
/// Windows past the last one of a row that tiles may read; their products are not used.
pub(super) const OVERHANG: usize = 2 * ROWS - 1;

/// Operand of `ldtilecfg`: all eight tiles have 16 rows of 64 bytes.
#[repr(C, align(64))]
struct Configuration {
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    row_bytes: [u16; 16],
    rows: [u8; 16],
}

struct Job<'a>(V4, Product<'a>);

impl NullaryFnOnce for Job<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self(simd, mut product) = self;
        let (windows, outputs) = (product.windows, product.weights.outputs);
        let mut block = [[0.0; WIDTH]; 2 * ROWS];
        for row in 0..windows.rows {
            for begin in (0..windows.columns).step_by(BLOCK) {
                let end = (begin + BLOCK).min(windows.columns);
                for output in (0..outputs).step_by(WIDTH) {
                    for column in (begin..end).step_by(2 * ROWS) {
                        let rows = (end - column).min(2 * ROWS);
                        match (rows > ROWS, output + WIDTH <= outputs) {
                            (true, true) => tile::<2, 2>(&product, row, column, output, &mut block),
                            (true, false) => tile::<2, 1>(&product, row, column, output, &mut block),
                            (false, true) => tile::<1, 2>(&product, row, column, output, &mut block),
                            (false, false) => tile::<1, 1>(&product, row, column, output, &mut block),
                        }
                        if output + WIDTH <= outputs {
                            product.finish::<V4, 2>(simd, &block[..rows], row, column, output);
                        } else {
                            product.finish::<V4, 1>(simd, &block[..rows], row, column, output);
                        }
                    }
                }
            }
        }
    }
}

/// Forms all products. Does nothing on a machine without tiles, where no matrix is packed for them.
pub(super) fn run(product: Product<'_>) {
    let Some(simd) = V4::try_new().filter(|_| has_amx()) else { return };
    let mut row_bytes = [0; 16];
    let mut rows = [0; 16];
    row_bytes[..8].fill(64);
    rows[..8].fill(ROWS as u8);
    let configuration = Configuration { palette: 1, start_row: 0, reserved: [0; 14], row_bytes, rows };
    // SAFETY: the processor has tiles and the system lets this process use them; the configuration is valid.
    unsafe { asm!("ldtilecfg [{}]", in(reg) &raw const configuration, options(nostack, readonly)) };
    simd.vectorize(Job(simd, product));
    // SAFETY: the processor has tiles, and no product is under way.
    unsafe { asm!("tilerelease", options(nostack, nomem)) };
}

/// Forms the products of `TILES` times 16 windows with a panel of `VECTORS` vectors.
///
/// Tiles 0 to 3 hold sums, 4 and 5 windows, 6 and 7 the panel. The compiler never uses tiles between two pieces of assembly: it does
/// not know of them.
#[inline(always)]
fn tile<const TILES: usize, const VECTORS: usize>(
    product: &Product<'_>,
    row: usize,
    column: usize,
    output: usize,
    block: &mut [[f32; WIDTH]; 2 * ROWS],
) {
    let (left, windows) = (product.left, product.windows);
    let (segments, length) = (product.weights.segments, product.weights.words_of_segment());
    let left = &left[windows.first + row * windows.pitch + column * windows.step..];
    let rows = (TILES * ROWS - 1).saturating_mul(windows.step);
    assert!(rows.saturating_add((segments - 1) * windows.segment_pitch + length) <= left.len());
    let panel = &product.weights.words[segments * length * output..];
    assert!(segments * length * VECTORS * ROWS <= panel.len());
    assert!(length.is_multiple_of(TILE_WORDS));

    let mut right = panel.as_ptr();
    let (step_bytes, panel_bytes) = (4 * windows.step, 64 * VECTORS);
    // SAFETY: tiles are configured. The assertions above bound all reads: `TILES * ROWS` windows of `segments` segments of `length`
    // words, and as many words times the panel's width. The stored tiles fit in `block`.
    unsafe {
        asm!("tilezero tmm0", "tilezero tmm1", "tilezero tmm2", "tilezero tmm3", options(nostack, nomem));
        for segment in 0..segments {
            let mut at = left[segment * windows.segment_pitch..].as_ptr();
            for _ in 0..length / TILE_WORDS {
                asm!("tileloadd tmm4, [{at} + {step}]", "tileloadd tmm6, [{right} + {width}]", "tdpbf16ps tmm0, tmm4, tmm6",
                    at = in(reg) at, step = in(reg) step_bytes, right = in(reg) right, width = in(reg) panel_bytes,
                    options(nostack, readonly));
                if VECTORS == 2 {
                    asm!("tileloadd tmm7, [{right} + {width}]", "tdpbf16ps tmm1, tmm4, tmm7",
                        right = in(reg) right.add(ROWS), width = in(reg) panel_bytes, options(nostack, readonly));
                }
                if TILES == 2 {
                    asm!("tileloadd tmm5, [{at} + {step}]", "tdpbf16ps tmm2, tmm5, tmm6",
                        at = in(reg) at.add(ROWS * windows.step), step = in(reg) step_bytes, options(nostack, readonly));
                    if VECTORS == 2 {
                        asm!("tdpbf16ps tmm3, tmm5, tmm7", options(nostack, nomem));
                    }
                }
                at = at.add(TILE_WORDS);
                right = right.add(TILE_WORDS * VECTORS * ROWS);
            }
        }
        let to = block.as_mut_ptr().cast::<f32>();
        asm!("tilestored [{to} + {width}], tmm0", to = in(reg) to, width = in(reg) 4 * WIDTH, options(nostack));
        if VECTORS == 2 {
            asm!("tilestored [{to} + {width}], tmm1", to = in(reg) to.add(ROWS), width = in(reg) 4 * WIDTH, options(nostack));
        }
        if TILES == 2 {
            let to = to.add(ROWS * WIDTH);
            asm!("tilestored [{to} + {width}], tmm2", to = in(reg) to, width = in(reg) 4 * WIDTH, options(nostack));
            if VECTORS == 2 {
                asm!("tilestored [{to} + {width}], tmm3", to = in(reg) to.add(ROWS), width = in(reg) 4 * WIDTH, options(nostack));
            }
        }
    }
}
