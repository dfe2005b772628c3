//! Matrix products for small networks on CPUs, with the vector instructions that the machine has.
//!
//! [`multiply`](multiply::multiply) multiplies rows that a program already holds in memory, the pixels of an image for example, by a
//! matrix that is packed once. A linear layer, a 3 x 3 convolution and attention are all such products, and nothing is copied for any
//! of them. Every kernel exists for [`Instructions`] from plain SSE2 to Intel's AMX; tests compare them all with sums in f64.
//! [`depthwise`] convolves each channel by itself, and [`math`] has the activations that follow a product, lane by lane.
//!
//! ```
//! use mvt_products::Instructions;
//! use mvt_products::multiply::{LANES, Left, Packed, Target, Then, multiply};
//!
//! // Two rows of three numbers, and a matrix of three rows and two columns.
//! let left = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
//! let right = [[1.0, -1.0], [0.5, 2.0], [0.0, 1.0]];
//!
//! // Odd rows would split a pair of bf16 numbers, hence `exact`.
//! let instructions = Instructions::best().exact();
//! let packed = Packed::new(instructions, 1, 3, &[0.0, 0.0], |row, column| right[row][column]);
//! // The kernel writes whole vectors: columns beyond the second are zero.
//! let mut product = vec![0.0; 2 * LANES];
//! let target = Target { data: &mut product, first: 0, step: LANES, pitch: 0, then: Then::Store };
//! multiply(&packed, Left::rows(&left, 3), &mut Vec::new(), target);
//!
//! for (row, sums) in left.chunks(3).zip(product.chunks(LANES)) {
//!     for column in 0..2 {
//!         let naive: f32 = (0..3).map(|k| row[k] * right[k][column]).sum();
//!         assert!((sums[column] - naive).abs() < 1e-6);
//!     }
//! }
//! ```
//!
//! # Deliberately absent
//! - Threads: a product runs on the calling thread. Give each thread its own rows.
//! - Large matrices: the right operand is not blocked for the outer caches. From about 1,000 rows and columns on, `gemm` or `faer` suit.
//! - Other number types: operands and sums are f32; on two instruction sets the operands are rounded to bf16.
//! - Vectors of other architectures: ARM runs the kernel of four lanes, which the compiler vectorises.
//! - Transposed operands, strides within a row, and gradients.

pub mod depthwise;
#[cfg(target_arch = "x86_64")]
mod detect;
pub mod instructions;
pub mod math;
pub mod multiply;

pub use instructions::Instructions;
pub use pulp;
