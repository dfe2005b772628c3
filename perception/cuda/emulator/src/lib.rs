//! Runs the CUDA kernels of [`mvt_cuda`] on the CPU, for tests on machines without a GPU.
//!
//! The text of the kernels is compiled as C++. The threads of a block run in turns, and barriers and exchanges within a warp hold as on a
//! GPU, so that the index arithmetic is tested as it stands. Products of matrices are plain loops. There is no library for convolutions.
//!
//! ```
//! use mvt_cuda::machine::Arithmetic;
//! use mvt_cuda::{DeviceArray, Gpu};
//! use mvt_cuda_emulator::Emulator;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let gpu = Gpu::new(Emulator::machine(Arithmetic::Exact));
//! let a = gpu.uploaded(&[1.0, 2.0])?;
//! let sum: DeviceArray<f32> = gpu.zeros(2)?;
//! gpu.accumulate(&sum, &gpu.add(&a, &a, None)?)?;
//! assert_eq!(sum.download()?, [2.0, 4.0]);
//! # Ok(())
//! # }
//! ```

use std::cell::RefCell;
use std::collections::HashMap;
use std::ffi::{CString, c_char, c_void};
use std::rc::Rc;
use std::sync::Mutex;

use mvt_cuda::machine::{Argument, Arithmetic, GpuError, Launch, Machine, Operand, Pass, Product, Window};

unsafe extern "C" {
    fn emulated_f32(name: *const c_char, blocks: *const u32, threads: u32, arguments: *mut *mut c_void) -> bool;
    fn emulated_bf16(name: *const c_char, blocks: *const u32, threads: u32, arguments: *mut *mut c_void) -> bool;
}

/// The emulator has one set of threads.
static RUNNING: Mutex<()> = Mutex::new(());

/// The CPU as a machine.
#[derive(Debug)]
pub struct Emulator {
    arithmetic: Arithmetic,
    bytes: usize,
    memory: RefCell<HashMap<u64, Vec<u64>>>,
}

impl Emulator {
    /// Returns an emulator with the kernels for some numbers. TF32 is computed as 32-bit floats.
    pub fn machine(arithmetic: Arithmetic) -> Rc<dyn Machine> {
        Self::with_memory(arithmetic, usize::MAX)
    }

    /// The same with so many bytes of memory.
    pub fn with_memory(arithmetic: Arithmetic, bytes: usize) -> Rc<dyn Machine> {
        Rc::new(Self { arithmetic, bytes, memory: RefCell::default() })
    }

    /// Returns a number of an operand.
    ///
    /// # Safety
    /// It lies in memory.
    unsafe fn get(&self, operand: Operand, batch: usize, [row, column]: [usize; 2], is_float: bool) -> f32 {
        let at = self.place(operand, batch, [row, column]);
        if self.arithmetic == Arithmetic::Bf16 && !is_float {
            // SAFETY: by the caller.
            f32::from_bits(u32::from(unsafe { *(operand.address as *const u16).add(at) }) << 16)
        } else {
            // SAFETY: by the caller.
            unsafe { *(operand.address as *const f32).add(at) }
        }
    }

    fn place(&self, operand: Operand, batch: usize, [row, column]: [usize; 2]) -> usize {
        let [row, column] = if operand.is_transposed { [column, row] } else { [row, column] };
        batch * operand.step + row * operand.row + column
    }

    /// Sets a number of an operand.
    ///
    /// # Safety
    /// It lies in memory.
    unsafe fn set(&self, operand: Operand, batch: usize, place: [usize; 2], is_float: bool, value: f32) {
        let at = self.place(operand, batch, place);
        if self.arithmetic == Arithmetic::Bf16 && !is_float {
            let bits = value.to_bits();
            let rounded = (bits + 0x7fff + ((bits >> 16) & 1)) >> 16;
            // SAFETY: by the caller.
            unsafe { *(operand.address as *mut u16).add(at) = rounded as u16 };
        } else {
            // SAFETY: by the caller.
            unsafe { *(operand.address as *mut f32).add(at) = value };
        }
    }
}

// SAFETY: kernels and copies touch what their arguments name.
unsafe impl Machine for Emulator {
    fn name(&self) -> String {
        "CPU in place of a GPU".to_owned()
    }

    fn arithmetic(&self) -> Arithmetic {
        self.arithmetic
    }

    fn allocate(&self, bytes: usize) -> Result<u64, GpuError> {
        let used: usize = self.memory.borrow().values().map(|block| 8 * block.len()).sum();
        if used.saturating_add(bytes) > self.bytes {
            return Err(GpuError::Memory(bytes));
        }
        // Memory of a GPU is not cleared either: a NaN shows where numbers are read before they are set.
        let block = vec![u64::MAX; bytes.div_ceil(8)];
        let address = block.as_ptr() as u64;
        self.memory.borrow_mut().insert(address, block);
        Ok(address)
    }

    unsafe fn free(&self, address: u64) {
        self.memory.borrow_mut().remove(&address);
    }

    unsafe fn upload(&self, to: u64, bytes: &[u8]) -> Result<(), GpuError> {
        // SAFETY: by the caller.
        unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), to as *mut u8, bytes.len()) };
        Ok(())
    }

    unsafe fn download(&self, from: u64, bytes: &mut [u8]) -> Result<(), GpuError> {
        // SAFETY: by the caller.
        unsafe { std::ptr::copy_nonoverlapping(from as *const u8, bytes.as_mut_ptr(), bytes.len()) };
        Ok(())
    }

    unsafe fn clear(&self, address: u64, bytes: usize) -> Result<(), GpuError> {
        // SAFETY: by the caller.
        unsafe { std::ptr::write_bytes(address as *mut u8, 0, bytes) };
        Ok(())
    }

    fn pace(&self) -> Result<(), GpuError> {
        Ok(())
    }

    unsafe fn launch(&self, kernel: &'static str, grid: Launch, arguments: &[Argument]) -> Result<(), GpuError> {
        let missing = || GpuError::Unsuitable(format!("there is no kernel {kernel}"));
        let name = CString::new(kernel).map_err(|_| missing())?;
        let mut values: Vec<u64> = arguments
            .iter()
            .map(|argument| match *argument {
                Argument::Address(address) => address,
                Argument::Count(count) => u64::from(count),
                Argument::Integer(integer) => integer as u32 as u64,
                Argument::Number(number) => u64::from(number.to_bits()),
            })
            .collect();
        let mut pointers: Vec<*mut c_void> = values.iter_mut().map(|value| std::ptr::from_mut(value).cast()).collect();
        let run = if self.arithmetic == Arithmetic::Bf16 { emulated_bf16 } else { emulated_f32 };
        let _one = RUNNING.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        // SAFETY: by the caller; the numbers lie at the start of their 8 bytes, since the machine is little-endian.
        let is_known = unsafe { run(name.as_ptr(), grid.blocks.as_ptr(), grid.threads, pointers.as_mut_ptr()) };
        if is_known { Ok(()) } else { Err(missing()) }
    }

    unsafe fn product(&self, product: &Product) -> Result<(), GpuError> {
        let &Product { a, b, c, size: [rows, columns], inner, batch, is_added, is_float } = product;
        for k in 0..batch {
            for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
                // SAFETY: by the caller.
                unsafe {
                    let terms =
                        (0..inner).map(|i| self.get(a, k, [row, i], false) * self.get(b, k, [i, column], false));
                    let sum = terms.sum::<f32>();
                    let kept = if is_added { self.get(c, k, [row, column], is_float) } else { 0.0 };
                    self.set(c, k, [row, column], is_float, sum + kept);
                }
            }
        }
        Ok(())
    }

    unsafe fn convolve(&self, _: Window, _: Pass, _: [u64; 2], _: u64) -> Result<bool, GpuError> {
        Ok(false)
    }
}
