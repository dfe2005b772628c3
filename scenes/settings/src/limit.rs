//! Limits of one setting.

use std::fmt::Debug;
use std::ops::RangeInclusive;

use crate::{SettingError, SettingGroup, SettingInfo};

/// The values that a setting of type `T` may have.
pub trait Limit<T> {
    /// Checks a value.
    ///
    /// # Errors
    /// [`SettingError`] with this key, the value and the range.
    fn check(&self, key: &str, value: &T) -> Result<(), SettingError>;

    /// Lists the setting; a nested struct lists several.
    fn list(&self, key: &str, doc: &str, default: &T) -> Vec<SettingInfo>;
}

/// A number that can be limited by a range.
pub trait SettingNumber: Copy + PartialOrd {
    /// The number as short text.
    fn text(self) -> String;
    /// The nearest f64.
    fn to_f64(self) -> f64;
}

macro_rules! number {
    ($($kind:ty)*) => {
        $(impl SettingNumber for $kind {
            fn text(self) -> String {
                // Debug writes long numbers with an exponent.
                let text = format!("{self:?}");
                text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
            }

            fn to_f64(self) -> f64 {
                self as f64
            }
        })*
    };
}

number!(u32 u64 usize f32 f64);

fn from_to<T: SettingNumber>(range: &RangeInclusive<T>) -> String {
    format!("from {} to {}", range.start().text(), range.end().text())
}

fn bounds<T: SettingNumber>(range: &RangeInclusive<T>) -> Option<[f64; 2]> {
    Some([range.start().to_f64(), range.end().to_f64()])
}

fn entries<T: SettingNumber>(values: &[T]) -> String {
    let texts: Vec<String> = values.iter().map(|value| value.text()).collect();
    format!("[{}]", texts.join(", "))
}

/// Checks `is_right` and names the setting otherwise.
fn refuse_unless(is_right: bool, key: &str, value: String, range: String) -> Result<(), SettingError> {
    if is_right { Ok(()) } else { Err(SettingError::new(key, value, range)) }
}

fn listed(key: &str, doc: &str, default: String, range: String, bounds: Option<[f64; 2]>) -> Vec<SettingInfo> {
    let doc = doc.lines().map(str::trim).collect::<Vec<_>>().join("\n");
    vec![SettingInfo { key: key.to_owned(), doc, default, range, bounds }]
}

/// NaN lies in no range.
impl<T: SettingNumber> Limit<T> for RangeInclusive<T> {
    fn check(&self, key: &str, value: &T) -> Result<(), SettingError> {
        refuse_unless(self.contains(value), key, value.text(), from_to(self))
    }

    fn list(&self, key: &str, doc: &str, default: &T) -> Vec<SettingInfo> {
        listed(key, doc, default.text(), from_to(self), bounds(self))
    }
}

/// The range holds for each entry.
impl<T: SettingNumber, const N: usize> Limit<[T; N]> for RangeInclusive<T> {
    fn check(&self, key: &str, value: &[T; N]) -> Result<(), SettingError> {
        let range = format!("{N} numbers, each {}", from_to(self));
        refuse_unless(value.iter().all(|entry| self.contains(entry)), key, entries(value), range)
    }

    fn list(&self, key: &str, doc: &str, default: &[T; N]) -> Vec<SettingInfo> {
        listed(key, doc, entries(default), format!("{N} numbers, each {}", from_to(self)), bounds(self))
    }
}

/// Limit of a vector of numbers.
#[derive(Debug, Clone)]
pub struct List<T> {
    /// Range of the number of entries.
    pub length: RangeInclusive<usize>,
    /// Range of each entry.
    pub each: RangeInclusive<T>,
}

impl<T: SettingNumber> List<T> {
    fn range(&self) -> String {
        format!("{} to {} numbers, each {}", self.length.start(), self.length.end(), from_to(&self.each))
    }
}

impl<T: SettingNumber> Limit<Vec<T>> for List<T> {
    fn check(&self, key: &str, value: &Vec<T>) -> Result<(), SettingError> {
        let is_right = self.length.contains(&value.len()) && value.iter().all(|entry| self.each.contains(entry));
        refuse_unless(is_right, key, entries(value), self.range())
    }

    fn list(&self, key: &str, doc: &str, default: &Vec<T>) -> Vec<SettingInfo> {
        listed(key, doc, entries(default), self.range(), bounds(&self.each))
    }
}

/// Limit of a whole number that is a multiple of another.
#[derive(Debug, Clone)]
pub struct Multiple {
    /// The divisor.
    pub of: usize,
    /// Range of the number.
    pub within: RangeInclusive<usize>,
}

impl Multiple {
    fn range(&self) -> String {
        format!("a multiple of {} {}", self.of, from_to(&self.within))
    }
}

impl Limit<usize> for Multiple {
    fn check(&self, key: &str, value: &usize) -> Result<(), SettingError> {
        let is_right = self.within.contains(value) && value.is_multiple_of(self.of);
        refuse_unless(is_right, key, value.text(), self.range())
    }

    fn list(&self, key: &str, doc: &str, default: &usize) -> Vec<SettingInfo> {
        listed(key, doc, default.text(), self.range(), bounds(&self.within))
    }
}

/// Limit of a field that is itself a struct of settings: all of its settings are in range.
#[derive(Debug, Clone, Copy)]
pub struct Nested;

impl<T: SettingGroup> Limit<T> for Nested {
    fn check(&self, key: &str, value: &T) -> Result<(), SettingError> {
        value.validate().map_err(|error| error.within(key))
    }

    fn list(&self, key: &str, _doc: &str, _default: &T) -> Vec<SettingInfo> {
        let mut settings = T::listing();
        for setting in &mut settings {
            setting.key = format!("{key}.{}", setting.key);
        }
        settings
    }
}

/// A type all of whose values are valid settings, such as a switch or a choice. Numbers are not.
pub trait Unlimited: Debug {}

impl Unlimited for bool {}
impl Unlimited for String {}

/// Limit of a field without one.
#[derive(Debug, Clone, Copy)]
pub struct WithoutLimit;

impl<T: Unlimited> Limit<T> for WithoutLimit {
    fn check(&self, _key: &str, _value: &T) -> Result<(), SettingError> {
        Ok(())
    }

    fn list(&self, key: &str, doc: &str, default: &T) -> Vec<SettingInfo> {
        listed(key, doc, format!("{default:?}"), String::new(), None)
    }
}
