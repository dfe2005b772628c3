//! Convolutions by cuDNN.

use std::cell::RefCell;
use std::collections::HashMap;
use std::ffi::{c_int, c_void};
use std::fmt;

use cudarc::cudnn::{result as cudnn, sys as dnn};
use cudarc::driver::sys::CUstream;

use crate::machine::{Arithmetic, GpuError, Pass, Window};

/// Most bytes of memory that a convolution may need beside its operands; ways of computing it that need more are passed over.
const MOST_WORKSPACE: usize = 2 << 30;
/// Ways of computing a convolution that cuDNN may list.
const MOST_WAYS: usize = 16;

/// Turns the error of a library into ours.
pub(super) fn failed<E: fmt::Debug>(call: &'static str) -> impl Fn(E) -> GpuError {
    move |error| GpuError::Call { call, message: format!("{error:?}") }
}

/// cuDNN with the ways of computing convolutions that it was asked for.
pub(super) struct Convolutions {
    handle: dnn::cudnnHandle_t,
    arithmetic: Arithmetic,
    ways: RefCell<HashMap<(Window, Pass), Option<Way>>>,
}

/// A way to compute a part of a convolution.
#[derive(Clone, Copy)]
pub(super) struct Way {
    maps: [dnn::cudnnTensorDescriptor_t; 2],
    weights: dnn::cudnnFilterDescriptor_t,
    convolution: dnn::cudnnConvolutionDescriptor_t,
    algorithm: Algorithm,
    /// Bytes of memory that it needs beside its operands.
    pub(super) workspace: usize,
}

#[derive(Clone, Copy)]
enum Algorithm {
    Forward(dnn::cudnnConvolutionFwdAlgo_t),
    ByInput(dnn::cudnnConvolutionBwdDataAlgo_t),
    ByWeights(dnn::cudnnConvolutionBwdFilterAlgo_t),
}

/// Returns the first suitable of the ways that a function of cuDNN lists, best first, and its memory.
macro_rules! first_way {
    ($list:ty, $ask:path, $handle:expr, $($descriptor:expr),*) => {{
        // SAFETY: plain numbers may start as zeros.
        let mut list: [$list; MOST_WAYS] = unsafe { std::mem::zeroed() };
        let mut count = 0;
        // SAFETY: the descriptors were made for this convolution, and there is room for as many results as are asked for.
        let asked = unsafe {
            $ask($handle, $($descriptor),*, MOST_WAYS as c_int, &raw mut count, list.as_mut_ptr())
        };
        let suits = |way: &&$list| {
            // Deterministic ways alone: a training gives the same weights each time.
            way.status == dnn::cudnnStatus_t::CUDNN_STATUS_SUCCESS
                && way.memory <= MOST_WORKSPACE
                && way.determinism == dnn::cudnnDeterminism_t::CUDNN_DETERMINISTIC
        };
        let found = list.iter().take(count as usize).find(suits).map(|way| (way.algo, way.memory));
        found.filter(|_| asked.is_ok())
    }};
}

impl Convolutions {
    /// Opens cuDNN, if it is installed.
    pub(super) fn open(stream: CUstream, arithmetic: Arithmetic) -> Result<Option<Self>, GpuError> {
        // SAFETY: loading the library runs nothing but its initialisers.
        if !unsafe { dnn::is_culib_present() } {
            tracing::warn!(
                "cuDNN (libcudnn) cannot be loaded; convolutions will take several times as long without it"
            );
            return Ok(None);
        }
        let handle = cudnn::create_handle().map_err(failed("cudnnCreate"))?;
        // SAFETY: handle and stream are valid.
        unsafe { cudnn::set_stream(handle, stream.cast()) }.map_err(failed("cudnnSetStream"))?;
        Ok(Some(Self { handle, arithmetic, ways: RefCell::default() }))
    }

    /// Returns how to compute a part of a convolution; `None` if cuDNN cannot.
    pub(super) fn way(&self, window: Window, pass: Pass) -> Result<Option<Way>, GpuError> {
        if let Some(way) = self.ways.borrow().get(&(window, pass)) {
            return Ok(*way);
        }
        let way = self.ask(window, pass)?;
        if way.is_none() {
            tracing::debug!("cuDNN has no way for {pass:?} of {window:?}");
        }
        self.ways.borrow_mut().insert((window, pass), way);
        Ok(way)
    }

    fn ask(&self, window: Window, pass: Pass) -> Result<Option<Way>, GpuError> {
        let layout = dnn::cudnnTensorFormat_t::CUDNN_TENSOR_NHWC;
        let (kind, math) = match self.arithmetic {
            Arithmetic::Exact => (dnn::cudnnDataType_t::CUDNN_DATA_FLOAT, dnn::cudnnMathType_t::CUDNN_FMA_MATH),
            Arithmetic::Tf32 => (dnn::cudnnDataType_t::CUDNN_DATA_FLOAT, dnn::cudnnMathType_t::CUDNN_TENSOR_OP_MATH),
            Arithmetic::Bf16 => (dnn::cudnnDataType_t::CUDNN_DATA_BFLOAT16, dnn::cudnnMathType_t::CUDNN_TENSOR_OP_MATH),
        };
        let map = |[images, rows, columns, channels]: [usize; 4]| {
            let map = cudnn::create_tensor_descriptor().map_err(failed("cudnnCreateTensorDescriptor"))?;
            let sides = [images, channels, rows, columns].map(|side| side as c_int);
            // SAFETY: the descriptor was just made.
            unsafe { cudnn::set_tensor4d_descriptor(map, layout, kind, sides) }
                .map_err(failed("cudnnSetTensor4dDescriptor"))?;
            Ok::<_, GpuError>(map)
        };
        let (input, output) = (map(window.input)?, map(window.output())?);
        let weights = cudnn::create_filter_descriptor().map_err(failed("cudnnCreateFilterDescriptor"))?;
        let convolution = cudnn::create_convolution_descriptor().map_err(failed("cudnnCreateConvolutionDescriptor"))?;
        let (mode, stride) = (dnn::cudnnConvolutionMode_t::CUDNN_CROSS_CORRELATION, window.stride as c_int);
        let float = dnn::cudnnDataType_t::CUDNN_DATA_FLOAT;
        let shape = [window.outputs, window.input[3], 3, 3].map(|side| side as c_int);
        // SAFETY: the descriptors were just made.
        unsafe {
            cudnn::set_filter4d_descriptor(weights, kind, layout, shape)
                .map_err(failed("cudnnSetFilter4dDescriptor"))?;
            cudnn::set_convolution2d_descriptor(convolution, 1, 1, stride, stride, 1, 1, mode, float)
                .map_err(failed("cudnnSetConvolution2dDescriptor"))?;
            cudnn::set_convolution_math_type(convolution, math).map_err(failed("cudnnSetConvolutionMathType"))?;
        }
        let found = match pass {
            Pass::Forward => first_way!(
                dnn::cudnnConvolutionFwdAlgoPerf_t,
                cudnn::get_convolution_forward_algorithm,
                self.handle,
                input,
                weights,
                convolution,
                output
            )
            .map(|(algorithm, memory)| (Algorithm::Forward(algorithm), memory)),
            Pass::ByInput => first_way!(
                dnn::cudnnConvolutionBwdDataAlgoPerf_t,
                cudnn::get_convolution_backward_data_algorithm,
                self.handle,
                weights,
                output,
                convolution,
                input
            )
            .map(|(algorithm, memory)| (Algorithm::ByInput(algorithm), memory)),
            Pass::ByWeights => first_way!(
                dnn::cudnnConvolutionBwdFilterAlgoPerf_t,
                cudnn::get_convolution_backward_filter_algorithm,
                self.handle,
                input,
                output,
                convolution,
                weights
            )
            .map(|(algorithm, memory)| (Algorithm::ByWeights(algorithm), memory)),
        };
        let maps = [input, output];
        Ok(found.map(|(algorithm, workspace)| Way { maps, weights, convolution, algorithm, workspace }))
    }

    /// Starts a part of a convolution; with `is_added`, the result is added to what is there.
    ///
    /// # Safety
    /// The operands, the result and the workspace have the memory that the way asks for.
    pub(super) unsafe fn compute(
        &self,
        way: Way,
        operands: [u64; 2],
        workspace: u64,
        result: u64,
        is_added: bool,
    ) -> Result<(), GpuError> {
        let Way { maps: [input, output], weights, convolution, algorithm, workspace: bytes } = way;
        let [first, second] = operands.map(|address| address as *const c_void);
        let (result, room) = (result as *mut c_void, workspace as *mut c_void);
        let (factor, keep) = (1.0_f32, if is_added { 1.0_f32 } else { 0.0 });
        let (one, keep): (*const c_void, *const c_void) = ((&raw const factor).cast(), (&raw const keep).cast());
        let handle = self.handle;
        // SAFETY: by the caller; the descriptors stand for the sizes of the operands, and the factors outlive the call.
        unsafe {
            match algorithm {
                Algorithm::Forward(way) => cudnn::convolution_forward(
                    handle,
                    one,
                    input,
                    first,
                    weights,
                    second,
                    convolution,
                    way,
                    room,
                    bytes,
                    keep,
                    output,
                    result,
                )
                .map_err(failed("cudnnConvolutionForward")),
                Algorithm::ByInput(way) => cudnn::convolution_backward_data(
                    handle,
                    one,
                    weights,
                    second,
                    output,
                    first,
                    convolution,
                    way,
                    room,
                    bytes,
                    keep,
                    input,
                    result,
                )
                .map_err(failed("cudnnConvolutionBackwardData")),
                Algorithm::ByWeights(way) => cudnn::convolution_backward_filter(
                    handle,
                    one,
                    input,
                    first,
                    output,
                    second,
                    convolution,
                    way,
                    room,
                    bytes,
                    keep,
                    weights,
                    result,
                )
                .map_err(failed("cudnnConvolutionBackwardFilter")),
            }
        }
    }
}

impl Drop for Convolutions {
    fn drop(&mut self) {
        // SAFETY: handle and descriptors are ours. An error would leave something behind, no more.
        unsafe {
            for Way { maps, weights, convolution, .. } in self.ways.take().into_values().flatten() {
                let _ = cudnn::destroy_tensor_descriptor(maps[0]);
                let _ = cudnn::destroy_tensor_descriptor(maps[1]);
                let _ = cudnn::destroy_filter_descriptor(weights);
                let _ = cudnn::destroy_convolution_descriptor(convolution);
            }
            let _ = cudnn::destroy_handle(self.handle);
        }
    }
}
