//! What the engine asks of a machine: memory, kernels and products.

use std::fmt;

pub use mvt_training::Arithmetic;

/// Reason that a GPU cannot go on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is too little memory for a request.
    #[error("it has no {0} bytes of memory left")]
    Memory(usize),
    /// The network or its images do not suit the kernels.
    #[error("{0}")]
    Unsuitable(String),
    /// A call failed.
    #[error("{call}: {message}")]
    Call {
        /// The call.
        call: &'static str,
        /// What the library said.
        message: String,
    },
}

/// Argument of a kernel.
#[derive(Debug, Clone, Copy)]
pub enum Argument {
    /// Address in the machine's memory; 0 is null.
    Address(u64),
    /// Number of something.
    Count(u32),
    /// Switch or place.
    Integer(i32),
    /// Real number.
    Number(f32),
}

/// Blocks of a launch along x, y and z, and the threads of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Launch {
    /// Blocks along x, y and z.
    pub blocks: [u32; 3],
    /// Threads of a block.
    pub threads: u32,
}

/// Matrix of a product, row-major, in a batch of such matrices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Operand {
    /// Address of the first number.
    pub address: u64,
    /// Numbers from a row to the next.
    pub row: usize,
    /// Numbers from a matrix of the batch to the next.
    pub step: usize,
    /// Whether the rows in memory are the columns of the operand.
    pub is_transposed: bool,
}

/// `C = A B`, or `C = A B + C`, for each of `batch` products, where C has `size` rows and columns and A `inner` columns. A and B are
/// activations or weights as the machine stores activations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Product {
    /// Left operand.
    pub a: Operand,
    /// Right operand.
    pub b: Operand,
    /// Result; never transposed.
    pub c: Operand,
    /// Rows and columns of the result.
    pub size: [usize; 2],
    /// Columns of A.
    pub inner: usize,
    /// Number of products.
    pub batch: usize,
    /// Whether the product is added to the numbers in C.
    pub is_added: bool,
    /// Whether C holds 32-bit floats instead of activations.
    pub is_float: bool,
}

/// 3 x 3 convolution with zeros around a map `[images, rows, columns, inputs]`; weights `[outputs, 3, 3, inputs]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Window {
    /// Images, rows, columns and channels of the input.
    pub input: [usize; 4],
    /// Channels of the result.
    pub outputs: usize,
    /// 1 or 2.
    pub stride: usize,
}

impl Window {
    /// Returns images, rows, columns and channels of the result.
    pub fn output(self) -> [usize; 4] {
        let [images, rows, columns, _] = self.input;
        [images, rows.div_ceil(self.stride), columns.div_ceil(self.stride), self.outputs]
    }
}

/// Part of a convolution that a library computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Pass {
    /// Result from input and weights, without the bias.
    Forward,
    /// Gradient by the input from that by the result and the weights.
    ByInput,
    /// Gradient by the weights, added to 32-bit floats, from input and the gradient by the result.
    ByWeights,
}

/// Time of the calls of one kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CallTime {
    /// The kernel, or the library's function.
    pub call: &'static str,
    /// Calls.
    pub count: usize,
    /// Their time together, milliseconds.
    pub time_ms: f64,
}

/// A GPU, or a stand-in for tests. Calls return at once and run in their order; only [`download`](Self::download) waits.
///
/// # Safety
/// An implementation reads and writes nothing but the memory that the arguments name.
pub unsafe trait Machine: fmt::Debug {
    /// Returns a description such as "NVIDIA H100 80GB HBM3".
    fn name(&self) -> String;

    /// Returns the numbers that the kernels were compiled for.
    fn arithmetic(&self) -> Arithmetic;

    /// Returns the address of new memory, aligned to 256 bytes.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if there is none left.
    fn allocate(&self, bytes: usize) -> Result<u64, GpuError>;

    /// Gives memory back.
    ///
    /// # Safety
    /// The address comes from `allocate` and no later call uses it.
    unsafe fn free(&self, address: u64);

    /// Copies bytes to the machine.
    ///
    /// # Safety
    /// Memory of that size is at the address.
    ///
    /// # Errors
    /// If the copy fails.
    unsafe fn upload(&self, to: u64, bytes: &[u8]) -> Result<(), GpuError>;

    /// Waits for all calls and copies bytes from the machine.
    ///
    /// # Safety
    /// Memory of that size is at the address.
    ///
    /// # Errors
    /// If the copy or an earlier call failed.
    unsafe fn download(&self, from: u64, bytes: &mut [u8]) -> Result<(), GpuError>;

    /// Fills memory with zeros.
    ///
    /// # Safety
    /// Memory of that size is at the address.
    ///
    /// # Errors
    /// If the call fails.
    unsafe fn clear(&self, address: u64, bytes: usize) -> Result<(), GpuError>;

    /// Ends a step, and waits if several steps have not yet been computed.
    ///
    /// # Errors
    /// If a call failed.
    fn pace(&self) -> Result<(), GpuError>;

    /// Records the kernels, products and convolutions that `run` starts instead of starting them, so that they can be started together;
    /// returns the number of the recording. Returns `None` on a machine that cannot; then nothing is run.
    ///
    /// # Errors
    /// If `run` or the recording fails.
    fn record(&self, run: &mut dyn FnMut() -> Result<(), GpuError>) -> Result<Option<usize>, GpuError> {
        let _ = run;
        Ok(None)
    }

    /// Starts all calls of a recording.
    ///
    /// # Safety
    /// The memory of the recorded calls is still theirs.
    ///
    /// # Errors
    /// If there is no such recording, or the call fails.
    unsafe fn replay(&self, recording: usize) -> Result<(), GpuError> {
        Err(GpuError::Unsuitable(format!("there is no recording {recording}")))
    }

    /// Waits for all calls and returns the time of those since the last call of this, longest first; nothing on a machine that does not
    /// measure.
    fn times(&self) -> Vec<CallTime> {
        Vec::new()
    }

    /// Starts a kernel.
    ///
    /// # Safety
    /// The arguments are those of the kernel, and its addresses have the memory that it uses with this grid.
    ///
    /// # Errors
    /// If the call fails.
    unsafe fn launch(&self, kernel: &'static str, grid: Launch, arguments: &[Argument]) -> Result<(), GpuError>;

    /// Starts products of matrices.
    ///
    /// # Safety
    /// The operands have the memory that their sizes ask for.
    ///
    /// # Errors
    /// If the call fails.
    unsafe fn product(&self, product: &Product) -> Result<(), GpuError>;

    /// Starts a part of a convolution from two operands, in the order of [`Pass`], to a third. Returns false where there is no library
    /// for it.
    ///
    /// # Safety
    /// The addresses have the memory that the sizes ask for.
    ///
    /// # Errors
    /// If the call fails.
    unsafe fn convolve(&self, window: Window, pass: Pass, operands: [u64; 2], result: u64) -> Result<bool, GpuError>;
}
