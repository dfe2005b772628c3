//! Settings whose defaults and ranges stand beside their fields.
//!
//! The macro [`settings!`] declares a struct and generates its `Default`, its serde implementations, a `validate()` that names the first
//! setting out of range, and a list of all settings with documentation, default and range. All crates report such a setting as a
//! [`SettingError`]. This crate reads and writes no files; it knows names and numbers only.
//!
//! ```
//! use mvt_settings::{SettingGroup as _, settings};
//!
//! settings! {
//!     /// Weights of the solver.
//!     pub struct SolverConfig {
//!         /// Steps per frame.
//!         pub steps: usize = 12, 1..=1000;
//!         /// Vertices per axis of each level.
//!         pub levels: Vec<u32> = vec![8, 20, 48], List { length: 1..=8, each: 2..=1024 };
//!     }
//! }
//!
//! settings! {
//!     /// All settings of a run.
//!     pub struct ExampleConfig {
//!         /// Whether progress is shown.
//!         pub progress: bool = true;
//!         /// The solver.
//!         pub solver: SolverConfig, Nested;
//!     }
//! }
//!
//! let mut config = ExampleConfig::default();
//! assert!(config.validate().is_ok());
//! config.solver.steps = 0;
//! let error = config.validate().unwrap_err();
//! assert_eq!(error.to_string(), "solver.steps must be from 1 to 1000 (it is 0)");
//!
//! let keys: Vec<String> = ExampleConfig::listing().into_iter().map(|setting| setting.key).collect();
//! assert_eq!(keys, ["progress", "solver.steps", "solver.levels"]);
//! ```

mod limit;

pub use limit::{Limit, List, Multiple, Nested, SettingNumber, Unlimited, WithoutLimit};

/// A setting that is out of range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key} must be {range} (it is {value})")]
#[non_exhaustive]
pub struct SettingError {
    /// The setting, with dots between levels.
    pub key: String,
    /// Its value.
    pub value: String,
    /// Its range in words: "from 1 to 20".
    pub range: String,
}

impl SettingError {
    /// Reports a setting by its name in its own struct.
    pub fn new(key: impl Into<String>, value: impl Into<String>, range: impl Into<String>) -> Self {
        Self { key: key.into(), value: value.into(), range: range.into() }
    }

    /// Puts the name of the field that holds the struct before the key.
    #[must_use]
    pub fn within(self, field: &str) -> Self {
        Self { key: format!("{field}.{}", self.key), ..self }
    }
}

/// One entry of the list of all settings.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SettingInfo {
    /// The setting, with dots between levels.
    pub key: String,
    /// Its documentation, in the lines of the source.
    pub doc: String,
    /// Its default as text.
    pub default: String,
    /// Its range in words, empty if it has none.
    pub range: String,
    /// Least and greatest value of a number or of each entry of a list.
    pub bounds: Option<[f64; 2]>,
}

/// A struct that [`settings!`] declares.
pub trait SettingGroup {
    /// Checks all settings.
    ///
    /// # Errors
    /// [`SettingError`] names the first setting that is out of range.
    fn validate(&self) -> Result<(), SettingError>;

    /// Lists all settings in their order, those of nested structs included.
    fn listing() -> Vec<SettingInfo>;
}

/// Declares a struct of settings.
///
/// Each field reads `pub name: Type = default, limit;`. Without `= default` the type's own default counts. The limit is any [`Limit`]:
/// a range such as `1..=20` or `0.0..=1.0` (also for each entry of an array), [`List`] for a vector, [`Multiple`], or [`Nested`] for
/// another struct of settings. A field without a limit must be [`Unlimited`], so that a number without a range does not compile. After
/// the struct, `rule = function;` names a `fn(&Self) -> Result<(), SettingError>` that compares fields with each other.
///
/// The struct derives `Debug`, `Clone`, `PartialEq`, `Serialize` and `Deserialize`; unknown keys are refused, missing ones get their
/// defaults. The calling crate depends on serde with its derive macros.
///
/// ```compile_fail,E0277
/// mvt_settings::settings! {
///     /// A group.
///     pub struct CountConfig {
///         /// A number without a range.
///         pub count: usize = 3;
///     }
/// }
/// ```
#[macro_export]
macro_rules! settings {
    (
        $(#[$($outer:tt)*])*
        pub struct $name:ident {
            $(
                $(#[$($attribute:tt)*])*
                pub $field:ident : $type:ty $(= $default:expr)? $(, $limit:expr)? ;
            )*
        }
        $(rule = $rule:path;)?
    ) => {
        $(#[$($outer)*])*
        #[derive(Debug, Clone, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $( $(#[$($attribute)*])* pub $field: $type, )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $crate::__default!($($default)?), )* }
            }
        }

        impl $name {
            /// Checks all settings.
            ///
            /// # Errors
            /// [`SettingError`]($crate::SettingError) names the first setting that is out of range.
            pub fn validate(&self) -> Result<(), $crate::SettingError> {
                $crate::SettingGroup::validate(self)
            }
        }

        impl $crate::SettingGroup for $name {
            fn validate(&self) -> Result<(), $crate::SettingError> {
                #[allow(unused_imports)]
                use $crate::{List, Multiple, Nested};
                $( $crate::Limit::<$type>::check(&$crate::__limit!($($limit)?), stringify!($field), &self.$field)?; )*
                $( $rule(self)?; )?
                Ok(())
            }

            fn listing() -> Vec<$crate::SettingInfo> {
                #[allow(unused_imports)]
                use $crate::{List, Multiple, Nested};
                let defaults = Self::default();
                let groups = [ $( $crate::Limit::<$type>::list(
                    &$crate::__limit!($($limit)?),
                    stringify!($field),
                    concat!($( $crate::__doc!($($attribute)*) ),*),
                    &defaults.$field,
                ), )* ];
                groups.concat()
            }
        }
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __default {
    () => {
        Default::default()
    };
    ($default:expr) => {
        $default
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __limit {
    () => {
        $crate::WithoutLimit
    };
    ($limit:expr) => {
        $limit
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __doc {
    (doc = $line:literal) => {
        concat!($line, "\n")
    };
    ($($other:tt)*) => {
        ""
    };
}

#[cfg(test)]
mod tests;
