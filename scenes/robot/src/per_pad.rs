//! Values of the pads of a hand.

use std::ops::{Deref, DerefMut};

use serde::{Deserialize, Serialize};

/// One value per pad of a hand, in the order of [`Hand::pads`](crate::hand::Hand::pads). It dereferences to a slice; empty for a hand without
/// pads.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PerPad<T>(pub Vec<T>);

impl<T> PerPad<T> {
    /// Calls a function with the index of each pad, in order.
    pub fn from_fn(pads: usize, f: impl FnMut(usize) -> T) -> Self {
        Self((0..pads).map(f).collect())
    }

    /// Converts each value.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> PerPad<U> {
        PerPad(self.0.iter().map(f).collect())
    }
}

impl<T> Deref for PerPad<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T> DerefMut for PerPad<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

impl<T> FromIterator<T> for PerPad<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        Self(values.into_iter().collect())
    }
}

impl<T> IntoIterator for PerPad<T> {
    type Item = T;
    type IntoIter = std::vec::IntoIter<T>;
    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

impl<'a, T> IntoIterator for &'a PerPad<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;
    fn into_iter(self) -> Self::IntoIter {
        self.0.iter()
    }
}
