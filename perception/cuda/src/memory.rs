//! Memory of a machine, in pieces that are used again.
//!
//! A step of a training asks for the same sizes again and again. Calls run in their order, so a piece may be given out again as soon as
//! its owner drops it, even while kernels still read it.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::rc::Rc;

use crate::machine::{Argument, Arithmetic, GpuError, Machine};

/// Pieces are multiples of this size, bytes.
const GRAIN: usize = 512;
/// Larger pieces are rounded up to this share of their size, so that similar sizes share pieces.
const COARSE: usize = 8;

/// A machine with the pieces of its memory that nobody uses.
#[derive(Debug)]
pub struct Pool {
    machine: Rc<dyn Machine>,
    free: RefCell<BTreeMap<usize, Vec<u64>>>,
    used: Cell<usize>,
    most: Cell<usize>,
}

/// A piece of memory; it goes back to the pool when it is dropped.
#[derive(Debug)]
struct Piece {
    address: u64,
    bytes: usize,
    pool: Rc<Pool>,
}

impl Drop for Piece {
    fn drop(&mut self) {
        self.pool.used.set(self.pool.used.get() - self.bytes);
        self.pool.free.borrow_mut().entry(self.bytes).or_default().push(self.address);
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.release();
    }
}

impl Pool {
    /// Returns an empty pool.
    pub fn new(machine: Rc<dyn Machine>) -> Rc<Self> {
        Rc::new(Self { machine, free: RefCell::default(), used: Cell::new(0), most: Cell::new(0) })
    }

    /// Returns the machine.
    pub fn machine(&self) -> &dyn Machine {
        &*self.machine
    }

    /// Returns the machine for another pool.
    pub fn shared_machine(&self) -> Rc<dyn Machine> {
        self.machine.clone()
    }

    /// Returns the most bytes that were in use at once.
    pub fn most(&self) -> usize {
        self.most.get()
    }

    /// Gives all free pieces back to the machine.
    pub fn release(&self) {
        for address in std::mem::take(&mut *self.free.borrow_mut()).into_values().flatten() {
            // SAFETY: the address is of a piece of this machine that nobody owns any more.
            unsafe { self.machine.free(address) };
        }
    }

    fn piece(self: &Rc<Self>, bytes: usize) -> Result<Piece, GpuError> {
        let grain = (bytes / COARSE).next_power_of_two().max(GRAIN);
        let bytes = bytes.max(1).next_multiple_of(grain);
        let free = self.free.borrow_mut().get_mut(&bytes).and_then(Vec::pop);
        let address = match free {
            Some(address) => address,
            None => self.machine.allocate(bytes).or_else(|_| {
                // Pieces of other sizes may be in the way.
                self.release();
                self.machine.allocate(bytes)
            })?,
        };
        self.used.set(self.used.get() + bytes);
        self.most.set(self.most.get().max(self.used.get()));
        Ok(Piece { address, bytes, pool: self.clone() })
    }

    /// Returns an array whose numbers are not yet set.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if there is no memory left.
    pub fn array<T: Number>(self: &Rc<Self>, len: usize) -> Result<DeviceArray<T>, GpuError> {
        if u32::try_from(len).is_err() {
            // Kernels count with 32 bits.
            return Err(GpuError::Memory(len * T::bytes(self.machine.arithmetic())));
        }
        let piece = self.piece(len * T::bytes(self.machine.arithmetic()))?;
        Ok(DeviceArray { address: piece.address, len, piece: Rc::new(piece), number: PhantomData })
    }
}

/// Kind of numbers in the machine's memory.
pub trait Number: Copy + 'static {
    /// Returns the bytes of a number.
    fn bytes(arithmetic: Arithmetic) -> usize;
}

/// Number as activations are stored.
#[derive(Debug, Clone, Copy)]
pub struct Real;

impl Number for Real {
    fn bytes(arithmetic: Arithmetic) -> usize {
        if arithmetic == Arithmetic::Bf16 { 2 } else { 4 }
    }
}

impl Number for f32 {
    fn bytes(_: Arithmetic) -> usize {
        4
    }
}

impl Number for i32 {
    fn bytes(_: Arithmetic) -> usize {
        4
    }
}

impl Number for u8 {
    fn bytes(_: Arithmetic) -> usize {
        1
    }
}

/// Numbers in the machine's memory; a copy is the same memory.
#[derive(Debug, Clone)]
pub struct DeviceArray<T: Number> {
    piece: Rc<Piece>,
    address: u64,
    len: usize,
    number: PhantomData<T>,
}

impl<T: Number> DeviceArray<T> {
    /// Returns the address of the first number.
    pub fn address(&self) -> u64 {
        self.address
    }

    /// Returns the number of numbers.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns whether there are no numbers.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns whether nobody else uses this memory.
    pub fn is_unshared(&self) -> bool {
        Rc::strong_count(&self.piece) == 1
    }

    /// Returns a part of the array, or `None` if it ends before that.
    pub fn part(&self, first: usize, len: usize) -> Option<Self> {
        (first + len <= self.len).then(|| {
            let bytes = T::bytes(self.piece.pool.machine.arithmetic());
            Self { address: self.address + (first * bytes) as u64, len, ..self.clone() }
        })
    }

    fn bytes(&self) -> usize {
        self.len * T::bytes(self.piece.pool.machine.arithmetic())
    }

    /// Fills the array with zeros.
    ///
    /// # Errors
    /// If the call fails.
    pub fn clear(&self) -> Result<(), GpuError> {
        // SAFETY: the array has so many bytes.
        unsafe { self.piece.pool.machine.clear(self.address, self.bytes()) }
    }
}

/// Number whose bytes are the same on both sides.
pub trait Shared: Number + Default {
    /// Returns the bytes of numbers.
    fn as_bytes(values: &[Self]) -> &[u8];
    /// Returns the bytes of numbers, to be written.
    fn as_bytes_mut(values: &mut [Self]) -> &mut [u8];
}

macro_rules! shared {
    ($($number:ty),*) => {$(
        impl Shared for $number {
            fn as_bytes(values: &[Self]) -> &[u8] {
                // SAFETY: plain numbers have no padding, and every byte of theirs may be read.
                unsafe { std::slice::from_raw_parts(values.as_ptr().cast(), size_of_val(values)) }
            }

            fn as_bytes_mut(values: &mut [Self]) -> &mut [u8] {
                // SAFETY: as above, and all bytes are valid numbers.
                unsafe { std::slice::from_raw_parts_mut(values.as_mut_ptr().cast(), size_of_val(values)) }
            }
        }
    )*};
}

shared!(f32, i32, u8);

impl<T: Shared> DeviceArray<T> {
    /// Copies numbers to the array; as many as it has.
    ///
    /// # Errors
    /// If the copy fails, or there are not as many.
    pub fn upload(&self, values: &[T]) -> Result<(), GpuError> {
        self.check(values.len())?;
        // SAFETY: the array has as many numbers.
        unsafe { self.piece.pool.machine.upload(self.address, T::as_bytes(values)) }
    }

    /// Waits for all calls and returns the numbers.
    ///
    /// # Errors
    /// If a call failed.
    pub fn download(&self) -> Result<Vec<T>, GpuError> {
        let mut values = vec![T::default(); self.len];
        // SAFETY: the array has as many numbers.
        unsafe { self.piece.pool.machine.download(self.address, T::as_bytes_mut(&mut values)) }?;
        Ok(values)
    }

    fn check(&self, len: usize) -> Result<(), GpuError> {
        let message = || format!("{len} numbers for an array of {}", self.len);
        if len == self.len { Ok(()) } else { Err(GpuError::Unsuitable(message())) }
    }
}

impl DeviceArray<f32> {
    /// Returns the same memory as activations, where these are 32-bit floats.
    pub fn as_real(&self) -> Option<DeviceArray<Real>> {
        let is_same = self.piece.pool.machine.arithmetic() != Arithmetic::Bf16;
        let (piece, address, len) = (self.piece.clone(), self.address, self.len);
        is_same.then_some(DeviceArray { piece, address, len, number: PhantomData })
    }
}

impl<T: Number> From<&DeviceArray<T>> for Argument {
    fn from(array: &DeviceArray<T>) -> Self {
        Self::Address(array.address)
    }
}

impl<T: Number> From<Option<&DeviceArray<T>>> for Argument {
    fn from(array: Option<&DeviceArray<T>>) -> Self {
        Self::Address(array.map_or(0, |array| array.address))
    }
}

impl From<usize> for Argument {
    fn from(count: usize) -> Self {
        // No array is longer, so no count within one is greater.
        Self::Count(u32::try_from(count).unwrap_or(u32::MAX))
    }
}

impl From<bool> for Argument {
    fn from(switch: bool) -> Self {
        Self::Integer(i32::from(switch))
    }
}

impl From<f32> for Argument {
    fn from(number: f32) -> Self {
        Self::Number(number)
    }
}
