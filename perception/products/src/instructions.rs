//! Vector instructions that the kernels run with.

use pulp::{Scalar128b, Simd, WithSimd};

#[cfg(target_arch = "x86_64")]
use crate::detect::{has_amx, has_bf16, is_intel};

// Why: notes/decisions/touch.md, "f32 between products".
/// Instruction sets that the kernels are compiled for.
///
/// The first two round the operands of matrix products to bf16 and add in f32; everything else is f32 on every path. Paths sum in
/// different orders, so their results differ in the last bits; on the first two they also differ by the rounding to bf16.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Instructions {
    /// bf16 products in tiles of 16 x 16 (Intel's AMX), the rest as in `Avx512`.
    Amx,
    /// bf16 products in pairs, the rest as in `Avx512`.
    Avx512Bf16,
    /// 16 lanes, fused multiply-add.
    Avx512,
    /// 8 lanes, fused multiply-add.
    Avx2,
    /// The basic instructions of the architecture, without fused multiply-add.
    Scalar,
}

impl Instructions {
    /// All instruction sets, those with more lanes first.
    pub const ALL: [Self; 5] = [Self::Amx, Self::Avx512Bf16, Self::Avx512, Self::Avx2, Self::Scalar];

    /// Returns the instruction sets of this machine. The last is always `Scalar`.
    pub fn available() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|set| set.is_available())
    }

    /// Returns the fastest instruction set of this machine.
    pub fn best() -> Self {
        // Why: notes/decisions/touch.md, "Instructions are chosen by processor model, never by a clock".
        // Intel's cores start one product of bf16 pairs per cycle but two of f32; AMD's cores start as many of both.
        let is_slower = |set: &Self| *set == Self::Avx512Bf16 && is_intel();
        Self::available().find(|set| !is_slower(set)).unwrap_or(Self::Scalar)
    }

    /// Returns the name in lower case, such as `avx2`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Amx => "amx",
            Self::Avx512Bf16 => "avx512bf16",
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Scalar => "scalar",
        }
    }

    /// Returns whether this machine has the instruction set.
    pub fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Amx => has_amx() && has_bf16(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Bf16 => has_bf16(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Amx | Self::Avx512Bf16 | Self::Avx512 | Self::Avx2 => false,
            Self::Scalar => true,
        }
    }

    /// Returns whether matrix products round their operands to bf16.
    pub fn is_bf16(self) -> bool {
        matches!(self, Self::Amx | Self::Avx512Bf16)
    }

    /// Returns the same instruction set without bf16.
    #[must_use]
    pub fn exact(self) -> Self {
        if self.is_bf16() { Self::Avx512 } else { self }
    }

    /// Runs an f32 kernel. Runs it as `Scalar` if the machine does not have the instruction set.
    pub fn run<K: WithSimd>(self, kernel: K) -> K::Output {
        #[cfg(target_arch = "x86_64")]
        match self {
            Self::Amx | Self::Avx512Bf16 | Self::Avx512 => {
                if let Some(simd) = pulp::x86::V4::try_new() {
                    return Simd::vectorize(simd, kernel);
                }
            }
            Self::Avx2 => {
                if let Some(simd) = pulp::x86::V3::try_new() {
                    return Simd::vectorize(simd, kernel);
                }
            }
            Self::Scalar => {}
        }
        // Four lanes, which the compiler may keep in a register of any machine.
        Simd::vectorize(Scalar128b, kernel)
    }
}

/// Returns false: the question matters on x86-64 only.
#[cfg(not(target_arch = "x86_64"))]
fn is_intel() -> bool {
    false
}
