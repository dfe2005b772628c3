//! A machine with the kernels as functions that allocate their results and check sizes.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::rc::Rc;

use crate::machine::{Argument, GpuError, Launch, Machine, Operand, Pass, Product, Window};
use crate::memory::{DeviceArray, Number, Pool, Real};

/// Threads of a block of most kernels.
const THREADS: usize = 256;
/// Most blocks of a kernel that loops over numbers: enough to fill any GPU several times.
const MOST_BLOCKS: usize = 8192;
/// Least number of rows that a thread sums where columns are summed.
const SUMMED_ROWS: usize = 32;
/// Most blocks along the rows where columns are summed.
const SUMMED_BLOCKS: usize = 256;
/// Rows of fewer numbers are summed several at a time, so that threads do not idle.
const WIDE: usize = 512;
/// Numbers of copied windows at once, where there is no library for convolutions: 256 MB.
const MOST_WINDOWS: usize = 64 << 20;

/// A machine in use by one thread.
#[derive(Debug)]
pub struct Gpu {
    pool: Rc<Pool>,
    /// Lists of indices that networks use in every pass.
    indices: RefCell<HashMap<Vec<i32>, DeviceArray<i32>>>,
    /// Numbers that do not change, by name and shape.
    fixed: RefCell<HashMap<FixedKey, DeviceArray<Real>>>,
    next: Cell<u64>,
    error: RefCell<Option<GpuError>>,
}

/// Name and shape of numbers that do not change.
type FixedKey = (String, Vec<usize>);

/// Matrices in an array, row-major.
#[derive(Debug, Clone, Copy)]
pub struct View {
    operand: Operand,
    /// Numbers from the first on that belong to the array.
    len: usize,
}

impl View {
    /// Returns a view whose rows and matrices follow `row` and `step` numbers after each other, from number `first` on.
    pub fn new<T: Number>(array: &DeviceArray<T>, first: usize, row: usize, step: usize) -> Self {
        let len = array.len().saturating_sub(first);
        let address = array.part(first.min(array.len()), 0).map_or(0, |part| part.address());
        Self { operand: Operand { address, row, step, is_transposed: false }, len }
    }

    /// Returns the only matrix of an array, whose rows have `row` numbers.
    pub fn rows<T: Number>(array: &DeviceArray<T>, row: usize) -> Self {
        Self::new(array, 0, row, 0)
    }

    /// Returns the transposed matrices.
    pub fn transposed(self) -> Self {
        let operand = Operand { is_transposed: !self.operand.is_transposed, ..self.operand };
        Self { operand, ..self }
    }

    /// Returns whether matrices of so many rows and columns lie within the array.
    fn holds(&self, [rows, columns]: [usize; 2], batch: usize) -> bool {
        let [rows, columns] = if self.operand.is_transposed { [columns, rows] } else { [rows, columns] };
        let last = (batch - 1) * self.operand.step + (rows - 1) * self.operand.row + columns;
        last <= self.len && columns <= self.operand.row
    }
}

/// Sizes of products, see [`Product`].
#[derive(Debug, Clone, Copy)]
pub struct Multiply {
    /// Rows and columns of the results.
    pub size: [usize; 2],
    /// Columns of the left operands.
    pub inner: usize,
    /// Number of products.
    pub batch: usize,
    /// Whether the products are added to the results.
    pub is_added: bool,
    /// Whether the results are 32-bit floats.
    pub is_float: bool,
}

impl Multiply {
    /// Returns a single product that overwrites activations.
    pub fn new(size: [usize; 2], inner: usize) -> Self {
        Self { size, inner, batch: 1, is_added: false, is_float: false }
    }

    /// Returns a single product that is added to gradients by weights.
    pub fn slope(size: [usize; 2], inner: usize) -> Self {
        Self { is_added: true, is_float: true, ..Self::new(size, inner) }
    }
}

/// Kernel with a grid and arguments.
macro_rules! launch {
    ($gpu:expr, $kernel:literal, $grid:expr, $($argument:expr),* $(,)?) => {
        $gpu.launch($kernel, $grid, &[$($crate::machine::Argument::from($argument)),*])
    };
}
pub(crate) use launch;

/// Returns the grid of a kernel that loops over numbers.
pub fn each(count: usize) -> Launch {
    let blocks = count.div_ceil(THREADS).clamp(1, MOST_BLOCKS);
    Launch { blocks: [blocks as u32, 1, 1], threads: THREADS as u32 }
}

/// Returns the grid of a kernel with a warp per row.
pub fn warps(rows: usize) -> Launch {
    Launch { blocks: [(rows * 32).div_ceil(THREADS).max(1) as u32, 1, 1], threads: THREADS as u32 }
}

/// Returns the grid of a kernel with a thread per column and a block per some rows, the number of such blocks, and the rows of each.
fn columns_of(width: usize, rows: usize) -> (Launch, usize, usize) {
    let per_block = rows.div_ceil(SUMMED_BLOCKS).max(SUMMED_ROWS);
    let blocks = rows.div_ceil(per_block).max(1);
    let grid = Launch { blocks: [width.div_ceil(THREADS) as u32, blocks as u32, 1], threads: THREADS as u32 };
    (grid, blocks, per_block)
}

impl Gpu {
    /// Takes a machine into use.
    pub fn new(machine: Rc<dyn Machine>) -> Rc<Self> {
        let (indices, fixed, error) = Default::default();
        Rc::new(Self { pool: Pool::new(machine), indices, fixed, next: Cell::new(0), error })
    }

    /// Takes the same machine into use with memory of its own.
    pub fn beside(&self) -> Rc<Self> {
        Self::new(self.pool.shared_machine())
    }

    /// Returns the memory of the machine.
    pub fn pool(&self) -> &Rc<Pool> {
        &self.pool
    }

    /// Returns the number of the next value of a computation.
    pub fn next_number(&self) -> u64 {
        self.next.replace(self.next.get() + 1)
    }

    /// Keeps the first error of a computation.
    pub fn fail(&self, error: GpuError) {
        self.error.borrow_mut().get_or_insert(error);
    }

    /// Forgets and returns the first error of a computation.
    ///
    /// # Errors
    /// That error, if there was one.
    pub fn take_error(&self) -> Result<(), GpuError> {
        self.error.borrow_mut().take().map_or(Ok(()), Err)
    }

    /// Returns an array whose numbers are not yet set.
    pub fn array<T: Number>(&self, len: usize) -> Result<DeviceArray<T>, GpuError> {
        self.pool.array(len)
    }

    /// Returns an array of zeros.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if there is no memory left.
    pub fn zeros<T: Number>(&self, len: usize) -> Result<DeviceArray<T>, GpuError> {
        let array = self.array(len)?;
        array.clear()?;
        Ok(array)
    }

    /// Returns 32-bit floats as activations are stored.
    pub fn uploaded(&self, values: &[f32]) -> Result<DeviceArray<Real>, GpuError> {
        let floats: DeviceArray<f32> = self.array(values.len())?;
        floats.upload(values)?;
        self.to_real(&floats)
    }

    /// Returns a list of indices; lists are kept.
    pub fn indices(&self, list: impl Iterator<Item = i32>) -> Result<DeviceArray<i32>, GpuError> {
        let list: Vec<i32> = list.collect();
        if let Some(array) = self.indices.borrow().get(&list) {
            return Ok(array.clone());
        }
        let array = self.array(list.len())?;
        array.upload(&list)?;
        self.indices.borrow_mut().insert(list, array.clone());
        Ok(array)
    }

    /// Returns numbers that are the same whenever name and shape are; they are made once.
    pub fn fixed(
        &self,
        name: &str,
        shape: &[usize],
        make: impl FnOnce() -> Vec<f32>,
    ) -> Result<DeviceArray<Real>, GpuError> {
        let key = (name.to_owned(), shape.to_vec());
        if let Some(array) = self.fixed.borrow().get(&key) {
            return Ok(array.clone());
        }
        let array = self.uploaded(&make())?;
        self.fixed.borrow_mut().insert(key, array.clone());
        Ok(array)
    }

    /// Starts a kernel. Private to the crate: the functions around it check that the arrays have the sizes that the kernel uses.
    pub(crate) fn launch(&self, kernel: &'static str, grid: Launch, arguments: &[Argument]) -> Result<(), GpuError> {
        // SAFETY: each caller passes the arguments that the kernel's text names, and arrays that are long enough.
        unsafe { self.pool.machine().launch(kernel, grid, arguments) }
    }

    /// Multiplies matrices of activations or weights.
    ///
    /// # Errors
    /// If a matrix does not fit its array, or the call fails.
    pub fn multiply(&self, a: View, b: View, c: View, multiply: Multiply) -> Result<(), GpuError> {
        let Multiply { size, inner, batch, is_added, is_float } = multiply;
        if size.contains(&0) || inner == 0 || batch == 0 {
            return Ok(());
        }
        let fits = a.holds([size[0], inner], batch) && b.holds([inner, size[1]], batch) && c.holds(size, batch);
        if !fits || c.operand.is_transposed {
            return Err(GpuError::Unsuitable(format!("a product {multiply:?} of {a:?}, {b:?} to {c:?}")));
        }
        let (a, b, c) = (a.operand, b.operand, c.operand);
        // SAFETY: checked above.
        unsafe { self.pool.machine().product(&Product { a, b, c, size, inner, batch, is_added, is_float }) }
    }

    /// Fails unless arrays have the lengths that a kernel expects.
    pub fn check(&self, lengths: &[(usize, usize)]) -> Result<(), GpuError> {
        match lengths.iter().find(|(len, needed)| len < needed) {
            None => Ok(()),
            Some((len, needed)) => {
                Err(GpuError::Unsuitable(format!("an array of {len} numbers where {needed} are needed")))
            }
        }
    }

    /// Converts 32-bit floats to activations.
    pub fn to_real(&self, x: &DeviceArray<f32>) -> Result<DeviceArray<Real>, GpuError> {
        let y = self.array(x.len())?;
        launch!(self, "to_real", each(x.len()), &y, x, x.len())?;
        Ok(y)
    }

    /// Converts activations to 32-bit floats.
    pub fn to_floats(&self, x: &DeviceArray<Real>) -> Result<DeviceArray<f32>, GpuError> {
        let y = self.array(x.len())?;
        launch!(self, "to_float", each(x.len()), &y, x, x.len())?;
        Ok(y)
    }

    /// Returns the sum of two arrays, written to `target` if there is one.
    pub fn add(
        &self,
        a: &DeviceArray<Real>,
        b: &DeviceArray<Real>,
        target: Option<DeviceArray<Real>>,
    ) -> Result<DeviceArray<Real>, GpuError> {
        let y = target.map_or_else(|| self.array(a.len()), Ok)?;
        self.check(&[(b.len(), a.len()), (y.len(), a.len())])?;
        launch!(self, "add", each(a.len()), &y, a, b, a.len())?;
        Ok(y)
    }

    /// Resizes a map; corners of the images coincide.
    pub fn resized(
        &self,
        x: &DeviceArray<Real>,
        [images, rows, columns, channels]: [usize; 4],
        size: [usize; 2],
    ) -> Result<DeviceArray<Real>, GpuError> {
        if size == [rows, columns] {
            return Ok(x.clone());
        }
        self.check(&[(x.len(), images * rows * columns * channels)])?;
        let y = self.array(images * size[0] * size[1] * channels)?;
        launch!(self, "resample", each(y.len()), &y, x, y.len(), rows, columns, size[0], size[1], channels, false)?;
        Ok(y)
    }

    /// Adds activations to the sum of gradients by weights.
    pub fn accumulate(&self, sum: &DeviceArray<f32>, x: &DeviceArray<Real>) -> Result<(), GpuError> {
        self.check(&[(sum.len(), x.len())])?;
        launch!(self, "accumulate", each(x.len()), sum, x, x.len())
    }

    /// Adds a bias of a number per column to rows, in place.
    pub fn add_bias(&self, x: &DeviceArray<Real>, bias: &DeviceArray<f32>) -> Result<(), GpuError> {
        launch!(self, "add_bias", each(x.len()), x, x, bias, x.len(), bias.len())
    }

    /// Returns partial sums over the rows of a matrix, and their number.
    fn column_parts(&self, x: &DeviceArray<Real>, width: usize) -> Result<(DeviceArray<f32>, usize), GpuError> {
        let rows = x.len() / width;
        let mut together = 1;
        while together * width < WIDE && rows.is_multiple_of(2 * together) {
            together *= 2;
        }
        let (wide, rows) = (together * width, rows / together);
        let (grid, blocks, per_block) = columns_of(wide, rows);
        let parts = self.array(blocks * wide)?;
        launch!(self, "column_parts", grid, &parts, x, rows, wide, per_block)?;
        Ok((parts, blocks * together))
    }

    /// Adds the sum over the rows of a matrix to gradients by weights.
    pub fn add_columns(&self, sum: &DeviceArray<f32>, x: &DeviceArray<Real>) -> Result<(), GpuError> {
        let (parts, blocks) = self.column_parts(x, sum.len())?;
        self.add_parts(sum, &parts, blocks)
    }

    /// Adds `count` parts to gradients by weights.
    pub fn add_parts(&self, sum: &DeviceArray<f32>, parts: &DeviceArray<f32>, count: usize) -> Result<(), GpuError> {
        self.check(&[(parts.len(), count * sum.len())])?;
        launch!(self, "add_parts", warps(sum.len()), sum, parts, count, sum.len(), sum.len())
    }

    /// Returns the sum over the rows of a matrix.
    pub fn sum_columns(&self, x: &DeviceArray<Real>, width: usize) -> Result<DeviceArray<Real>, GpuError> {
        let (parts, blocks) = self.column_parts(x, width)?;
        let sum = self.array(width)?;
        launch!(self, "sum_parts", each(width), &sum, &parts, blocks, width)?;
        Ok(sum)
    }

    /// Sums over rows with a kernel of two matrices `[rows, width]`, and adds the results to gradients by weights: as many arrays as the
    /// kernel makes, width by width.
    pub fn add_row_products(
        &self,
        kernel: &'static str,
        sums: &[&DeviceArray<f32>],
        before: &[Argument],
        [x, g]: [&DeviceArray<Real>; 2],
        width: usize,
    ) -> Result<(), GpuError> {
        let rows = x.len() / width;
        let (grid, blocks, per_block) = columns_of(width, rows);
        let parts: DeviceArray<f32> = self.array(blocks * sums.len() * width)?;
        let mut arguments = vec![Argument::from(&parts)];
        arguments.extend(before);
        arguments.extend([Argument::from(x), g.into(), rows.into(), width.into(), per_block.into()]);
        self.launch(kernel, grid, &arguments)?;
        for (k, sum) in sums.iter().enumerate() {
            self.check(&[(sum.len(), width)])?;
            // Parts of this sum lie `sums.len()` widths apart.
            let from = parts.part(k * width, parts.len() - k * width);
            let from = from.ok_or(GpuError::Memory(parts.len()))?;
            let arguments =
                [Argument::from(*sum), (&from).into(), blocks.into(), width.into(), (sums.len() * width).into()];
            self.launch("add_parts", warps(width), &arguments)?;
        }
        Ok(())
    }

    /// Adds the gradient by the windows `[channels, side, side]` of a depthwise convolution of a map.
    pub fn add_depthwise_slopes(
        &self,
        [images, rows, columns, channels]: [usize; 4],
        side: usize,
        [x, g]: [&DeviceArray<Real>; 2],
        sum: &DeviceArray<f32>,
    ) -> Result<(), GpuError> {
        let (grid, blocks, per_block) = columns_of(channels * side * side, images * rows);
        let parts: DeviceArray<f32> = self.array(blocks * sum.len())?;
        let image_rows = images * rows;
        launch!(self, "depthwise_parts", grid, &parts, x, g, rows, columns, channels, side, image_rows, per_block)?;
        self.add_parts(sum, &parts, blocks)
    }

    /// Computes a convolution without its bias.
    pub fn convolve(
        &self,
        window: Window,
        x: &DeviceArray<Real>,
        weight: &DeviceArray<Real>,
    ) -> Result<DeviceArray<Real>, GpuError> {
        let y = self.array(window.output().iter().product())?;
        if !self.library(window, Pass::Forward, [x, weight], y.address())? {
            self.in_windows(window, |gpu, [first, count], pixels, width| {
                let windows = gpu.windows(window, x, [first, count])?;
                let y = View::new(&y, first * pixels * window.outputs, window.outputs, 0);
                let weight = View::rows(weight, width).transposed();
                gpu.multiply(
                    View::rows(&windows, width),
                    weight,
                    y,
                    Multiply::new([count * pixels, window.outputs], width),
                )
            })?;
        }
        Ok(y)
    }

    /// Computes the gradient by the input of a convolution.
    pub fn convolve_back(
        &self,
        window: Window,
        g: &DeviceArray<Real>,
        weight: &DeviceArray<Real>,
    ) -> Result<DeviceArray<Real>, GpuError> {
        let [_, rows, columns, channels] = window.input;
        let by_x = self.array(window.input.iter().product())?;
        if !self.library(window, Pass::ByInput, [g, weight], by_x.address())? {
            let [_, out_rows, out_columns, outputs] = window.output();
            self.in_windows(window, |gpu, [first, count], pixels, width| {
                let by_windows: DeviceArray<Real> = gpu.array(count * pixels * width)?;
                let g = View::new(g, first * pixels * outputs, outputs, 0);
                let multiply = Multiply::new([count * pixels, width], outputs);
                gpu.multiply(g, View::rows(weight, width), View::rows(&by_windows, width), multiply)?;
                let len = count * rows * columns * channels;
                let to = by_x.part(first * rows * columns * channels, len).ok_or(GpuError::Memory(len))?;
                let (stride, grid) = (window.stride, each(len));
                launch!(
                    gpu,
                    "windows_back",
                    grid,
                    &to,
                    &by_windows,
                    len,
                    rows,
                    columns,
                    channels,
                    out_rows,
                    out_columns,
                    stride
                )
            })?;
        }
        Ok(by_x)
    }

    /// Adds the gradient by the weights of a convolution to those of other images.
    pub fn add_convolve_slopes(
        &self,
        window: Window,
        [x, g]: [&DeviceArray<Real>; 2],
        sum: &DeviceArray<f32>,
    ) -> Result<(), GpuError> {
        if self.library(window, Pass::ByWeights, [x, g], sum.address())? {
            return Ok(());
        }
        let outputs = window.outputs;
        self.in_windows(window, |gpu, [first, count], pixels, width| {
            let windows = gpu.windows(window, x, [first, count])?;
            let g = View::new(g, first * pixels * outputs, outputs, 0).transposed();
            let multiply = Multiply::slope([outputs, width], count * pixels);
            gpu.multiply(g, View::rows(&windows, width), View::rows(sum, width), multiply)
        })
    }

    fn library(
        &self,
        window: Window,
        pass: Pass,
        [a, b]: [&DeviceArray<Real>; 2],
        result: u64,
    ) -> Result<bool, GpuError> {
        // SAFETY: callers allocate the results by the window's sizes, and the operands were made so.
        unsafe { self.pool.machine().convolve(window, pass, [a.address(), b.address()], result) }
    }

    /// Calls `run` with some images, first and count, at a time, the pixels of a result and the numbers of a window.
    fn in_windows(
        &self,
        window: Window,
        run: impl Fn(&Self, [usize; 2], usize, usize) -> Result<(), GpuError>,
    ) -> Result<(), GpuError> {
        let [images, rows, columns, _] = window.output();
        let (pixels, width) = (rows * columns, 9 * window.input[3]);
        let some = (MOST_WINDOWS / (pixels * width)).clamp(1, images);
        (0..images).step_by(some).try_for_each(|first| run(self, [first, some.min(images - first)], pixels, width))
    }

    /// Copies the windows of some images.
    fn windows(
        &self,
        window: Window,
        x: &DeviceArray<Real>,
        [first, count]: [usize; 2],
    ) -> Result<DeviceArray<Real>, GpuError> {
        let [_, rows, columns, channels] = window.input;
        let [_, out_rows, out_columns, _] = window.output();
        let (image, len) = (rows * columns * channels, count * out_rows * out_columns * 9 * channels);
        let x = x.part(first * image, count * image).ok_or(GpuError::Memory(image))?;
        let (y, stride) = (self.array(len)?, window.stride);
        launch!(self, "windows", each(len), &y, &x, len, rows, columns, channels, out_rows, out_columns, stride)?;
        Ok(y)
    }
}
