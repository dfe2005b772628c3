//! Vector instructions that the kernels run with.

use pulp::{Scalar, Simd, WithSimd};

/// Instruction sets that the kernels are compiled for. Each machine has the last ones of the list, at least `Scalar`.
///
/// The enum is the field's own: the touch networks' sets also say how a matrix product rounds, and their `Scalar` adds four lanes side
/// by side where the field adds number by number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FieldInstructions {
    /// 16 lanes, fused multiply-add.
    Avx512,
    /// 8 lanes, fused multiply-add.
    Avx2,
    /// Basic instructions of the architecture, without fused multiply-add.
    Scalar,
}

impl FieldInstructions {
    /// Returns the instruction sets of this machine, those with more lanes first.
    pub fn available() -> impl Iterator<Item = Self> {
        [Self::Avx512, Self::Avx2, Self::Scalar].into_iter().filter(|set| set.is_available())
    }

    /// Returns the instruction set with the most lanes of this machine.
    pub fn best() -> Self {
        Self::available().next().unwrap_or(Self::Scalar)
    }

    /// Returns whether this machine has the instruction set.
    pub fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx512 | Self::Avx2 => false,
            Self::Scalar => true,
        }
    }

    /// Runs a kernel. Runs it as `Scalar` if the machine does not have the instruction set.
    pub(super) fn run<K: WithSimd>(self, kernel: K) -> K::Output {
        #[cfg(target_arch = "x86_64")]
        match self {
            Self::Avx512 => {
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
        Simd::vectorize(Scalar, kernel)
    }
}
