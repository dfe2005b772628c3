//! An NVIDIA GPU through the driver, NVRTC, cuBLAS and cuDNN, which are loaded when a GPU is asked for.

mod convolutions;

use std::cell::{Cell, RefCell};
use std::collections::{HashMap, VecDeque};
use std::ffi::{CStr, CString, c_int, c_void};
use std::fmt;
use std::rc::Rc;
use std::sync::{Mutex, PoisonError};

use cudarc::cublas::sys::{
    self as blas, cublasComputeType_t as Compute, cublasOperation_t as Turn, cudaDataType as Kind,
};
use cudarc::driver::sys as driver;
use cudarc::{cublas, nvrtc};
use mvt_training::mvt_touch::device::NoGpu;

use convolutions::{Convolutions, failed};

use crate::machine::{Argument, Arithmetic, CallTime, GpuError, Launch, Machine, Operand, Pass, Product, Window};

/// The text of all kernels.
const KERNELS: &str = concat!(
    include_str!("kernels/common.cu"),
    include_str!("kernels/pointwise.cu"),
    include_str!("kernels/reduce.cu"),
    include_str!("kernels/optimiser.cu"),
    include_str!("kernels/convolution.cu"),
    include_str!("kernels/scan.cu"),
);
/// Memory that cuBLAS asks for on recent GPUs, bytes.
const BLAS_WORKSPACE: usize = 32 << 20;
/// Steps that may wait in the queue of the GPU.
const QUEUED: usize = 2;

/// The first NVIDIA GPU.
pub struct Nvidia {
    name: String,
    arithmetic: Arithmetic,
    stream: driver::CUstream,
    module: driver::CUmodule,
    kernels: RefCell<HashMap<&'static str, driver::CUfunction>>,
    blas: blas::cublasHandle_t,
    /// cuDNN, if it is installed.
    convolutions: Option<Convolutions>,
    /// Address and size of the memory beside the operands of a convolution. Smaller ones are kept as well: recordings use them.
    workspace: Cell<(u64, usize)>,
    workspaces: RefCell<Vec<u64>>,
    device: driver::CUdevice,
    /// Memory of the host that the GPU reads by itself, with the event behind its last use.
    staged: RefCell<Vec<Staged>>,
    steps: RefCell<VecDeque<driver::CUevent>>,
    recordings: RefCell<Vec<driver::CUgraphExec>>,
    /// Events before and behind each call, if it measures.
    measured: Option<RefCell<Vec<MeasuredCall>>>,
}

/// Name of a call, and events before and behind it.
type MeasuredCall = (&'static str, [driver::CUevent; 2]);

/// Memory of the host from which the GPU copies.
struct Staged {
    memory: *mut c_void,
    bytes: usize,
    used: driver::CUevent,
}

impl fmt::Debug for Nvidia {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Nvidia").field("name", &self.name).field("arithmetic", &self.arithmetic).finish_non_exhaustive()
    }
}

/// Checks a call of the driver.
fn check(call: &'static str, result: driver::CUresult) -> Result<(), GpuError> {
    if result == driver::CUresult::CUDA_SUCCESS {
        return Ok(());
    }
    let mut text = std::ptr::null();
    // SAFETY: the driver is loaded, or there would be no result; it returns a static string or null.
    let message = unsafe {
        driver::cuGetErrorString(result, &raw mut text);
        if text.is_null() { format!("{result:?}") } else { CStr::from_ptr(text).to_string_lossy().into_owned() }
    };
    Err(GpuError::Call { call, message })
}

/// Looks for NVIDIA's libraries and a GPU.
///
/// # Errors
/// [`NoGpu`] names the missing part.
pub fn find() -> Result<(), NoGpu> {
    // First, since calls of a missing library panic.
    // SAFETY: loading NVIDIA's libraries runs nothing but their initialisers, which have no preconditions.
    let [has_driver, has_compiler, has_products] =
        unsafe { [driver::is_culib_present(), nvrtc::sys::is_culib_present(), blas::is_culib_present()] };
    if !has_driver {
        return Err(NoGpu::Library("the library of NVIDIA's driver (libcuda)"));
    }
    if !has_compiler {
        return Err(NoGpu::Library("the compiler of the CUDA toolkit (libnvrtc)"));
    }
    if !has_products {
        return Err(NoGpu::Library("the CUDA toolkit's library of matrix products (libcublas)"));
    }
    let mut count = 0;
    // SAFETY: the driver is loaded and `count` is a place for a number.
    let result = unsafe {
        match driver::cuInit(0) {
            driver::CUresult::CUDA_SUCCESS => driver::cuDeviceGetCount(&raw mut count),
            other => other,
        }
    };
    match result {
        driver::CUresult::CUDA_SUCCESS if count > 0 => Ok(()),
        driver::CUresult::CUDA_SUCCESS => Err(NoGpu::Device("it counts 0".to_owned())),
        driver::CUresult::CUDA_ERROR_STUB_LIBRARY => Err(NoGpu::Stub),
        error => Err(NoGpu::Device(format!("{error:?}"))),
    }
}

impl Nvidia {
    /// Takes the first GPU into use by this thread and compiles the kernels for it.
    ///
    /// # Errors
    /// If a library is missing or a call fails.
    pub fn open(arithmetic: Arithmetic) -> Result<Rc<dyn Machine>, GpuError> {
        Self::prepare(arithmetic, false)
    }

    /// The same, with the time of each call measured.
    ///
    /// # Errors
    /// If a library is missing or a call fails.
    pub fn measuring(arithmetic: Arithmetic) -> Result<Rc<dyn Machine>, GpuError> {
        Self::prepare(arithmetic, true)
    }

    fn prepare(arithmetic: Arithmetic, measures: bool) -> Result<Rc<dyn Machine>, GpuError> {
        find().map_err(|error| GpuError::Unsuitable(error.to_string()))?;
        let (mut device, mut context, mut stream) = (0, std::ptr::null_mut(), std::ptr::null_mut());
        let mut name = [0; 256];
        let (mut major, mut minor) = (0, 0);
        // SAFETY: the driver is initialised; all places are valid for what is written to them.
        unsafe {
            check("cuDeviceGet", driver::cuDeviceGet(&raw mut device, 0))?;
            check("cuDevicePrimaryCtxRetain", driver::cuDevicePrimaryCtxRetain(&raw mut context, device))?;
            check("cuCtxSetCurrent", driver::cuCtxSetCurrent(context))?;
            let flags = driver::CUstream_flags::CU_STREAM_NON_BLOCKING as u32;
            check("cuStreamCreate", driver::cuStreamCreate(&raw mut stream, flags))?;
            check("cuDeviceGetName", driver::cuDeviceGetName(name.as_mut_ptr(), 256, device))?;
            use driver::CUdevice_attribute_enum as Attribute;
            for (place, attribute) in [
                (&mut major, Attribute::CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR),
                (&mut minor, Attribute::CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR),
            ] {
                check("cuDeviceGetAttribute", driver::cuDeviceGetAttribute(place, attribute, device))?;
            }
        }
        if major < 8 && arithmetic == Arithmetic::Bf16 {
            return Err(GpuError::Unsuitable(format!(
                "it has compute capability {major}.{minor}, and bf16 needs 8.0; choose gpu_arithmetic = \"exact\""
            )));
        }
        // SAFETY: the driver wrote a string that ends with 0.
        let name = unsafe { CStr::from_ptr(name.as_ptr()) }.to_string_lossy().into_owned();
        let code = code(arithmetic, [major, minor])?;
        let mut module = std::ptr::null_mut();
        // SAFETY: the code is an image for this device, and the context is current.
        unsafe { check("cuModuleLoadData", driver::cuModuleLoadData(&raw mut module, code.as_ptr().cast()))? };
        let blas = cublas::result::create_handle().map_err(failed("cublasCreate"))?;
        // SAFETY: handle and stream were just made.
        unsafe { cublas::result::set_stream(blas, stream.cast()) }.map_err(failed("cublasSetStream"))?;
        let mut workspace = 0;
        // SAFETY: the place is valid; the memory is freed after the handle.
        unsafe {
            check("cuMemAlloc", driver::cuMemAlloc_v2(&raw mut workspace, BLAS_WORKSPACE))?;
            let set = blas::cublasSetWorkspace_v2(blas, workspace as *mut c_void, BLAS_WORKSPACE);
            set.result().map_err(failed("cublasSetWorkspace"))?;
        }
        let convolutions = Convolutions::open(stream, arithmetic)?;
        let (kernels, staged, steps, recordings) = Default::default();
        let (workspace, workspaces) = (Cell::new((0, 0)), RefCell::new(vec![workspace]));
        let measured = measures.then(RefCell::default);
        Ok(Rc::new(Self {
            name,
            arithmetic,
            stream,
            module,
            kernels,
            blas,
            convolutions,
            workspace,
            workspaces,
            device,
            staged,
            steps,
            recordings,
            measured,
        }))
    }

    fn kernel(&self, name: &'static str) -> Result<driver::CUfunction, GpuError> {
        if let Some(kernel) = self.kernels.borrow().get(name) {
            return Ok(*kernel);
        }
        let text = CString::new(name).map_err(failed("cuModuleGetFunction"))?;
        let mut kernel = std::ptr::null_mut();
        // SAFETY: the module stays loaded.
        let result = unsafe { driver::cuModuleGetFunction(&raw mut kernel, self.module, text.as_ptr()) };
        check("cuModuleGetFunction", result)?;
        self.kernels.borrow_mut().insert(name, kernel);
        Ok(kernel)
    }

    /// Makes a call, and measures it.
    fn timed(&self, call: &'static str, run: impl FnOnce() -> Result<(), GpuError>) -> Result<(), GpuError> {
        let Some(measured) = &self.measured else { return run() };
        let mut events = [std::ptr::null_mut(); 2];
        for event in &mut events {
            // SAFETY: the place is valid for the event.
            check("cuEventCreate", unsafe { driver::cuEventCreate(event, 0) })?;
        }
        // SAFETY: the events were just made.
        check("cuEventRecord", unsafe { driver::cuEventRecord(events[0], self.stream) })?;
        run()?;
        // SAFETY: as above.
        check("cuEventRecord", unsafe { driver::cuEventRecord(events[1], self.stream) })?;
        measured.borrow_mut().push((call, events));
        Ok(())
    }

    /// Returns memory of so many bytes beside the operands of a call.
    fn workspace(&self, bytes: usize) -> Result<u64, GpuError> {
        let (address, size) = self.workspace.get();
        if size >= bytes {
            return Ok(address);
        }
        // Twice the size, so that a few sizes serve all convolutions.
        let bytes = (2 * size).max(bytes);
        let address = self.allocate(bytes)?;
        self.workspaces.borrow_mut().push(address);
        self.workspace.set((address, bytes));
        Ok(address)
    }
}

impl Drop for Nvidia {
    fn drop(&mut self) {
        // SAFETY: everything is ours, and nothing runs once the stream has ended. An error would leave something behind, no more.
        unsafe {
            let _ = driver::cuStreamSynchronize(self.stream);
            for graph in self.recordings.take() {
                let _ = driver::cuGraphExecDestroy(graph);
            }
            // Before the stream that it uses.
            drop(self.convolutions.take());
            let _ = cublas::result::destroy_handle(self.blas);
            self.workspaces.take().into_iter().for_each(|address| self.free(address));
            for Staged { memory, used, .. } in self.staged.take() {
                let _ = (driver::cuMemFreeHost(memory), driver::cuEventDestroy_v2(used));
            }
            for event in self.steps.take() {
                let _ = driver::cuEventDestroy_v2(event);
            }
            let _ = driver::cuModuleUnload(self.module);
            let _ = driver::cuStreamDestroy_v2(self.stream);
            let _ = driver::cuDevicePrimaryCtxRelease_v2(self.device);
        }
    }
}

/// Code of the kernels by their numbers and the compute capability, compiled once.
static CODE: Mutex<Vec<Code>> = Mutex::new(Vec::new());

/// Numbers of the kernels, compute capability and code.
type Code = (Arithmetic, [c_int; 2], Vec<u8>);

/// Returns the code of the kernels for a device of this compute capability.
fn code(arithmetic: Arithmetic, capability: [c_int; 2]) -> Result<Vec<u8>, GpuError> {
    let mut known = CODE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, _, code)) = known.iter().find(|(of, on, _)| (*of, *on) == (arithmetic, capability)) {
        return Ok(code.clone());
    }
    let code = compile(arithmetic, capability)?;
    known.push((arithmetic, capability, code.clone()));
    Ok(code)
}

/// Compiles the kernels for a device of this compute capability.
fn compile(arithmetic: Arithmetic, [major, minor]: [c_int; 2]) -> Result<Vec<u8>, GpuError> {
    let call = failed::<nvrtc::result::NvrtcError>("NVRTC");
    let text = CString::new(KERNELS).map_err(failed("NVRTC"))?;
    let program = nvrtc::result::create_program(&text, Some(c"kernels.cu")).map_err(&call)?;
    let mut options = vec![format!("--gpu-architecture=sm_{major}{minor}"), "--std=c++17".to_owned()];
    if arithmetic == Arithmetic::Bf16 {
        options.push("-DBF16".to_owned());
    }
    if arithmetic != Arithmetic::Exact {
        // Errors of a few units in the last place are far below those of the products.
        options.push("--use_fast_math".to_owned());
    }
    // SAFETY: the program was just made; the code has room for what is written to it.
    unsafe {
        let compiled = nvrtc::result::compile_program(program, &options).map_err(&call).and_then(|()| {
            let mut len = 0;
            nvrtc::sys::nvrtcGetCUBINSize(program, &raw mut len).result().map_err(&call)?;
            let mut code = vec![0_u8; len];
            nvrtc::sys::nvrtcGetCUBIN(program, code.as_mut_ptr().cast()).result().map_err(&call)?;
            Ok(code)
        });
        let compiled = compiled.map_err(|error| {
            let log = nvrtc::result::get_program_log(program).unwrap_or_default();
            let log: String = log.iter().take_while(|&&c| c != 0).map(|&c| char::from(c as u8)).collect();
            GpuError::Unsuitable(format!("the kernels cannot be compiled for sm_{major}{minor} ({error}): {log}"))
        });
        nvrtc::result::destroy_program(program).map_err(&call)?;
        compiled
    }
}

// SAFETY: every call names its memory; the libraries touch nothing else.
unsafe impl Machine for Nvidia {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn arithmetic(&self) -> Arithmetic {
        self.arithmetic
    }

    fn allocate(&self, bytes: usize) -> Result<u64, GpuError> {
        let mut address = 0;
        // SAFETY: the context is current.
        match unsafe { driver::cuMemAlloc_v2(&raw mut address, bytes) } {
            driver::CUresult::CUDA_ERROR_OUT_OF_MEMORY => Err(GpuError::Memory(bytes)),
            result => check("cuMemAlloc", result).map(|()| address),
        }
    }

    unsafe fn free(&self, address: u64) {
        // SAFETY: by the caller.
        let result = unsafe { driver::cuMemFree_v2(address) };
        if let Err(error) = check("cuMemFree", result) {
            tracing::warn!("memory of the GPU is lost: {error}");
        }
    }

    unsafe fn upload(&self, to: u64, bytes: &[u8]) -> Result<(), GpuError> {
        if bytes.is_empty() {
            return Ok(());
        }
        let mut staged = self.staged.borrow_mut();
        // SAFETY: the events were recorded on this stream.
        let is_free = |piece: &Staged| unsafe { driver::cuEventQuery(piece.used) } == driver::CUresult::CUDA_SUCCESS;
        let fits = |piece: &Staged| piece.bytes >= bytes.len() && piece.bytes / 2 <= bytes.len().max(4096);
        let at = match staged.iter().position(|piece| fits(piece) && is_free(piece)) {
            Some(at) => at,
            None => {
                let size = bytes.len().max(4096);
                let (mut memory, mut used) = (std::ptr::null_mut(), std::ptr::null_mut());
                // SAFETY: the places are valid for what is written to them.
                unsafe {
                    check("cuMemHostAlloc", driver::cuMemHostAlloc(&raw mut memory, size, 0))?;
                    let flags = driver::CUevent_flags::CU_EVENT_DISABLE_TIMING as u32;
                    check("cuEventCreate", driver::cuEventCreate(&raw mut used, flags))?;
                }
                staged.push(Staged { memory, bytes: size, used });
                staged.len() - 1
            }
        };
        let Staged { memory, used, .. } = staged[at];
        // SAFETY: the piece is long enough and the GPU has read what was in it; by the caller the memory at `to` is, too.
        unsafe {
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), memory.cast(), bytes.len());
            check("cuMemcpyHtoD", driver::cuMemcpyHtoDAsync_v2(to, memory, bytes.len(), self.stream))?;
            check("cuEventRecord", driver::cuEventRecord(used, self.stream))
        }
    }

    unsafe fn download(&self, from: u64, bytes: &mut [u8]) -> Result<(), GpuError> {
        // SAFETY: by the caller; the copy has ended when the stream has.
        unsafe {
            let copied = driver::cuMemcpyDtoHAsync_v2(bytes.as_mut_ptr().cast(), from, bytes.len(), self.stream);
            check("cuMemcpyDtoH", copied)?;
            check("cuStreamSynchronize", driver::cuStreamSynchronize(self.stream))
        }
    }

    unsafe fn clear(&self, address: u64, bytes: usize) -> Result<(), GpuError> {
        // SAFETY: by the caller.
        check("cuMemsetD8", unsafe { driver::cuMemsetD8Async(address, 0, bytes, self.stream) })
    }

    fn pace(&self) -> Result<(), GpuError> {
        let mut steps = self.steps.borrow_mut();
        let mut event = std::ptr::null_mut();
        // SAFETY: the events are ours and were recorded on this stream.
        unsafe {
            if steps.len() == QUEUED
                && let Some(oldest) = steps.pop_front()
            {
                check("cuEventSynchronize", driver::cuEventSynchronize(oldest))?;
                event = oldest;
            } else {
                let flags = driver::CUevent_flags::CU_EVENT_DISABLE_TIMING as u32;
                check("cuEventCreate", driver::cuEventCreate(&raw mut event, flags))?;
            }
            check("cuEventRecord", driver::cuEventRecord(event, self.stream))?;
        }
        steps.push_back(event);
        Ok(())
    }

    fn record(&self, run: &mut dyn FnMut() -> Result<(), GpuError>) -> Result<Option<usize>, GpuError> {
        if self.measured.is_some() {
            return Ok(None);
        }
        let (mut graph, mut started) = (std::ptr::null_mut(), std::ptr::null_mut());
        // SAFETY: the places are valid for what is written to them; the recording is ended whether or not `run` succeeds.
        unsafe {
            let mode = driver::CUstreamCaptureMode::CU_STREAM_CAPTURE_MODE_RELAXED;
            check("cuStreamBeginCapture", driver::cuStreamBeginCapture_v2(self.stream, mode))?;
            let run = run();
            check("cuStreamEndCapture", driver::cuStreamEndCapture(self.stream, &raw mut graph))?;
            run?;
            check("cuGraphInstantiate", driver::cuGraphInstantiateWithFlags(&raw mut started, graph, 0))?;
            check("cuGraphDestroy", driver::cuGraphDestroy(graph))?;
        }
        let mut recordings = self.recordings.borrow_mut();
        recordings.push(started);
        Ok(Some(recordings.len() - 1))
    }

    unsafe fn replay(&self, recording: usize) -> Result<(), GpuError> {
        let missing = || GpuError::Unsuitable(format!("there is no recording {recording}"));
        let graph = *self.recordings.borrow().get(recording).ok_or_else(missing)?;
        // SAFETY: by the caller.
        check("cuGraphLaunch", unsafe { driver::cuGraphLaunch(graph, self.stream) })
    }

    fn times(&self) -> Vec<CallTime> {
        let Some(measured) = &self.measured else { return Vec::new() };
        let mut times: HashMap<&'static str, CallTime> = HashMap::new();
        for (call, [before, behind]) in measured.take() {
            let mut time_ms = 0.0;
            // SAFETY: the events were recorded on this stream; nobody else has them.
            unsafe {
                let _ = driver::cuEventSynchronize(behind);
                let _ = driver::cuEventElapsedTime_v2(&raw mut time_ms, before, behind);
                let _ = (driver::cuEventDestroy_v2(before), driver::cuEventDestroy_v2(behind));
            }
            let sum = times.entry(call).or_insert(CallTime { call, count: 0, time_ms: 0.0 });
            (sum.count, sum.time_ms) = (sum.count + 1, sum.time_ms + f64::from(time_ms));
        }
        let mut times: Vec<CallTime> = times.into_values().collect();
        times.sort_by(|a, b| b.time_ms.total_cmp(&a.time_ms));
        times
    }

    unsafe fn launch(&self, kernel: &'static str, grid: Launch, arguments: &[Argument]) -> Result<(), GpuError> {
        let function = self.kernel(kernel)?;
        let mut values = [0_u64; 32];
        let mut pointers = [std::ptr::null_mut::<c_void>(); 32];
        if arguments.len() > values.len() {
            return Err(GpuError::Unsuitable(format!("{} arguments for kernel {kernel}", arguments.len())));
        }
        for ((value, pointer), argument) in values.iter_mut().zip(&mut pointers).zip(arguments) {
            // The kernel reads as many of the 8 bytes as its argument has, from the first on.
            *value = match *argument {
                Argument::Address(address) => address,
                Argument::Count(count) => u64::from(count),
                Argument::Integer(integer) => u64::from(integer as u32),
                Argument::Number(number) => u64::from(number.to_bits()),
            };
            *pointer = std::ptr::from_mut(value).cast();
        }
        let [x, y, z] = grid.blocks;
        self.timed(kernel, || {
            // SAFETY: by the caller.
            check(kernel, unsafe {
                let nothing = std::ptr::null_mut();
                driver::cuLaunchKernel(
                    function,
                    x,
                    y,
                    z,
                    grid.threads,
                    1,
                    1,
                    0,
                    self.stream,
                    pointers.as_mut_ptr(),
                    nothing,
                )
            })
        })
    }

    unsafe fn product(&self, product: &Product) -> Result<(), GpuError> {
        let Product { a, b, c, size: [rows, columns], inner, batch, is_added, is_float } = *product;
        let (factor, keep) = (1.0_f32, if is_added { 1.0_f32 } else { 0.0 });
        let kind = if self.arithmetic == Arithmetic::Bf16 { Kind::CUDA_R_16BF } else { Kind::CUDA_R_32F };
        let result_kind = if is_float { Kind::CUDA_R_32F } else { kind };
        let compute = match self.arithmetic {
            Arithmetic::Exact => Compute::CUBLAS_COMPUTE_32F_PEDANTIC,
            Arithmetic::Tf32 => Compute::CUBLAS_COMPUTE_32F_FAST_TF32,
            Arithmetic::Bf16 => Compute::CUBLAS_COMPUTE_32F,
        };
        // cuBLAS reads matrices column by column, and so sees all of them transposed: C' = B' A'.
        let turn = |operand: Operand| if operand.is_transposed { Turn::CUBLAS_OP_T } else { Turn::CUBLAS_OP_N };
        let number = |number: usize| c_int::try_from(number).map_err(failed("cublasGemmStridedBatchedEx"));
        let best = blas::cublasGemmAlgo_t::CUBLAS_GEMM_DEFAULT;
        let call = if batch > 1 { "products of a batch" } else { "product" };
        self.timed(call, || {
            // SAFETY: by the caller; the factors live as long as the call.
            unsafe {
                cublas::result::gemm_strided_batched_ex(
                    self.blas,
                    turn(b),
                    turn(a),
                    number(columns)?,
                    number(rows)?,
                    number(inner)?,
                    (&raw const factor).cast(),
                    b.address as *const c_void,
                    kind,
                    number(b.row)?,
                    b.step as i64,
                    a.address as *const c_void,
                    kind,
                    number(a.row)?,
                    a.step as i64,
                    (&raw const keep).cast(),
                    c.address as *mut c_void,
                    result_kind,
                    number(c.row)?,
                    c.step as i64,
                    number(batch)?,
                    compute,
                    best,
                )
            }
            .map_err(failed("cublasGemmStridedBatchedEx"))
        })
    }

    unsafe fn convolve(&self, window: Window, pass: Pass, operands: [u64; 2], result: u64) -> Result<bool, GpuError> {
        let Some(convolutions) = &self.convolutions else { return Ok(false) };
        let Some(way) = convolutions.way(window, pass)? else { return Ok(false) };
        // cuDNN writes gradients by weights as activations are stored; there is room for them behind its own.
        let (count, own) = (window.outputs * 9 * window.input[3], way.workspace.next_multiple_of(256));
        let room = self.workspace(own + 2 * count)?;
        let is_added = pass == Pass::ByWeights;
        let is_converted = is_added && self.arithmetic == Arithmetic::Bf16;
        let to = if is_converted { room + own as u64 } else { result };
        let call = match pass {
            Pass::Forward => "convolution",
            Pass::ByInput => "convolution, by input",
            Pass::ByWeights => "convolution, by weights",
        };
        // SAFETY: by the caller; the workspace is large enough.
        self.timed(call, || unsafe { convolutions.compute(way, operands, room, to, is_added && !is_converted) })?;
        if is_converted {
            let arguments = [Argument::Address(result), Argument::Address(to), Argument::from(count)];
            // SAFETY: there are as many numbers behind the workspace and, by the caller, at the result.
            unsafe { self.launch("accumulate", crate::gpu::each(count), &arguments)? };
        }
        Ok(true)
    }
}
