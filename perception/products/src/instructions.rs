//! Which vector instructions the kernels run with.

use pulp::{Scalar128b, Simd, WithSimd};

/// Instruction sets that the kernels are compiled for.
///
/// The first two round the operands of matrix products to bf16 and add in f32; everything else is f32 on every path. Paths sum in
/// different orders, so that their results differ in the last bits, and those of the first two by what bf16 rounds away.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Instructions {
    /// bf16 products in tiles of 16 x 16 (Intel's AMX), the rest as in `Avx512`.
    Amx,
    /// bf16 products in pairs, the rest as in `Avx512`.
    Avx512Bf16,
    /// 16 lanes, fused multiply-add.
    Avx512,
    /// 8 lanes, fused multiply-add.
    Avx2,
    /// What every processor of the architecture has.
    Scalar,
}

impl Instructions {
    /// All of them, those with more lanes first.
    pub const ALL: [Self; 5] = [Self::Amx, Self::Avx512Bf16, Self::Avx512, Self::Avx2, Self::Scalar];

    /// The instruction sets of this machine. The last is always `Scalar`.
    pub fn available() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|set| set.is_available())
    }

    /// The fastest instruction set of this machine.
    pub fn best() -> Self {
        // Intel's cores start one product of bf16 pairs per cycle where they start two of f32; those of AMD start as many.
        let is_slower = |set: &Self| *set == Self::Avx512Bf16 && is_intel();
        Self::available().find(|set| !is_slower(set)).unwrap_or(Self::Scalar)
    }

    /// Name on the command line and in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Amx => "amx",
            Self::Avx512Bf16 => "avx512bf16",
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Scalar => "scalar",
        }
    }

    /// Whether this machine has it.
    pub fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Amx => super::multiply::has_amx() && Self::Avx512Bf16.is_available(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Bf16 => super::multiply::has_bf16(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Amx | Self::Avx512Bf16 | Self::Avx512 | Self::Avx2 => false,
            Self::Scalar => true,
        }
    }

    /// Whether matrix products take their operands as bf16.
    pub fn is_bf16(self) -> bool {
        matches!(self, Self::Amx | Self::Avx512Bf16)
    }

    /// The same without bf16.

    pub fn exact(self) -> Self {
        if self.is_bf16() { Self::Avx512 } else { self }
    }

    /// Runs an f32 kernel; as `Scalar` if the machine does not have the instruction set.
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
        // Four lanes that the compiler is free to put into a register of whatever machine this is.
        Simd::vectorize(Scalar128b, kernel)
    }
}

/// Whether Intel made the processor.
#[cfg(target_arch = "x86_64")]
fn is_intel() -> bool {
    let leaf = std::arch::x86_64::__cpuid(0);
    [leaf.ebx, leaf.edx, leaf.ecx].map(u32::to_le_bytes).as_flattened() == b"GenuineIntel"
}

#[cfg(not(target_arch = "x86_64"))]
fn is_intel() -> bool {
    false
}
