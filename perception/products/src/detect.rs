//! Instructions of the processor that `pulp` does not detect: bf16 products and AMX.

use std::arch::asm;
use std::arch::x86_64::{__cpuid, __cpuid_count};
use std::sync::OnceLock;

use pulp::x86::V4;

pulp::simd_type! {
    /// Proof that the machine multiplies bf16.
    pub(crate) struct Bf16Features {
        avx512f: "avx512f",
        avx512bw: "avx512bw",
        avx512cd: "avx512cd",
        avx512dq: "avx512dq",
        avx512vl: "avx512vl",
        avx512bf16: "avx512bf16",
    }
}

/// Returns whether Intel made the processor.
pub(crate) fn is_intel() -> bool {
    let leaf = __cpuid(0);
    [leaf.ebx, leaf.edx, leaf.ecx].map(u32::to_le_bytes).as_flattened() == b"GenuineIntel"
}

/// Returns whether the machine multiplies bf16.
pub(crate) fn has_bf16() -> bool {
    Bf16Features::try_new().is_some() && V4::try_new().is_some()
}

/// Returns whether the machine has tiles for bf16 and the system lets this process use them. Requests the permission once.
pub(crate) fn has_amx() -> bool {
    static GRANTED: OnceLock<bool> = OnceLock::new();
    *GRANTED.get_or_init(|| {
        // Leaf 7: edx bit 22 is AMX-BF16, bit 24 AMX-TILE.
        let edx = __cpuid_count(7, 0).edx;
        edx >> 22 & 1 == 1 && edx >> 24 & 1 == 1 && is_granted()
    })
}

/// Requests Linux to let the process use tile registers.
#[cfg(target_os = "linux")]
fn is_granted() -> bool {
    /// `arch_prctl`.
    const CALL: i64 = 158;
    const ARCH_REQ_XCOMP_PERM: u64 = 0x1023;
    /// Tile data among the processor's state components.
    const XTILEDATA: u64 = 18;
    let mut answer = CALL;
    // SAFETY: the call reads no memory of this process; the kernel changes rcx and r11, as for any call.
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
