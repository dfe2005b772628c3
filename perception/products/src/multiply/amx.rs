//! Products in the tiles of Intel's AMX: 16 windows by 16 columns by 32 bf16 numbers in one instruction.
//!
//! Rust's intrinsics for it are not stable, hence assembly. A thread's tiles are configured when a product begins and given back when
//! it ends, so that nothing of them is alive outside [`run`].

use std::arch::asm;
use std::arch::x86_64::__cpuid_count;
use std::sync::OnceLock;

use pulp::{NullaryFnOnce, x86::V4};

use super::{Product, WIDTH};

/// Words of a segment that one instruction takes, 32 numbers.
pub(super) const STEP: usize = 16;
/// Windows of a tile.
const ROWS: usize = 16;
/// Windows whose panels' products are formed before going on, so that they stay in the cache from panel to panel.
const BLOCK: usize = 128;
/// Windows past the last one of a row that tiles may touch; what comes of them is not used.
pub(super) const OVERHANG: usize = 2 * ROWS - 1;

/// Whether the machine has tiles for bf16 and the system lets this process use them. Asks for the permission, once.
pub(in super::super) fn has_amx() -> bool {
    static GRANTED: OnceLock<bool> = OnceLock::new();
    *GRANTED.get_or_init(|| {
        // Leaf 7: edx bit 22 is AMX-BF16, bit 24 AMX-TILE.
        let edx = __cpuid_count(7, 0).edx;
        edx >> 22 & 1 == 1 && edx >> 24 & 1 == 1 && is_granted()
    })
}

/// Asks Linux to let the process use tile registers.
#[cfg(target_os = "linux")]
fn is_granted() -> bool {
    /// `arch_prctl`.
    const CALL: i64 = 158;
    const ARCH_REQ_XCOMP_PERM: u64 = 0x1023;
    /// Tile data among the processor's state components.
    const XTILEDATA: u64 = 18;
    let mut answer = CALL;
    // SAFETY: the call reads no memory of ours; the kernel changes rcx and r11, as for any call.
    unsafe {
        asm!("syscall", inout("rax") answer, in("rdi") ARCH_REQ_XCOMP_PERM, in("rsi") XTILEDATA,
            out("rcx") _, out("r11") _, options(nostack));
    }
    answer == 0
}

#[cfg(not(target_os = "linux"))]
fn is_granted() -> bool {
    false
}

/// The operand of `ldtilecfg`: all eight tiles have 16 rows of 64 bytes.
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

/// Forms all products; nothing on a machine without tiles, for which nothing is packed.
pub(super) fn run(product: Product<'_>) {
    let Some(simd) = V4::try_new().filter(|_| has_amx()) else { return };
    let mut row_bytes = [0; 16];
    let mut rows = [0; 16];
    row_bytes[..8].fill(64);
    rows[..8].fill(ROWS as u8);
    let configuration = Configuration { palette: 1, start_row: 0, reserved: [0; 14], row_bytes, rows };
    // SAFETY: the processor has tiles and the system lets us use them; the configuration is a valid one.
    unsafe { asm!("ldtilecfg [{}]", in(reg) &raw const configuration, options(nostack, readonly)) };
    simd.vectorize(Job(simd, product));
    // SAFETY: as above.
    unsafe { asm!("tilerelease", options(nostack, nomem)) };
}

/// The products of `TILES` times 16 windows with a panel of `VECTORS` vectors.
///
/// Tiles 0 to 3 hold sums, 4 and 5 windows, 6 and 7 the panel. Between two pieces of assembly the compiler leaves tiles alone: it
/// does not know of them.
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
    assert!((TILES * ROWS - 1) * windows.step + (segments - 1) * windows.segment_pitch + length <= left.len());
    let panel = &product.weights.words[segments * length * output..];
    assert!(segments * length * VECTORS * ROWS <= panel.len());
    assert!(length.is_multiple_of(STEP));

    let mut right = panel.as_ptr();
    let (step_bytes, panel_bytes) = (4 * windows.step, 64 * VECTORS);
    // SAFETY: tiles are configured. What is read lies within what was asserted above: `TILES * ROWS` windows of `segments` segments
    // of `length` words, and as many words times the panel's width; what is written fits in `block`.
    unsafe {
        asm!("tilezero tmm0", "tilezero tmm1", "tilezero tmm2", "tilezero tmm3", options(nostack, nomem));
        for segment in 0..segments {
            let mut at = left[segment * windows.segment_pitch..].as_ptr();
            for _ in 0..length / STEP {
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
                at = at.add(STEP);
                right = right.add(STEP * VECTORS * ROWS);
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
