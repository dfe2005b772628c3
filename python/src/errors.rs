//! Exceptions: classes of `mambavitact.errors`, and calls that release the interpreter's lock.

use std::panic::{AssertUnwindSafe, catch_unwind};

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;

/// Class of an exception.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// The base class: a call failed.
    General,
    /// An argument is wrong; also a `ValueError`.
    Argument,
    /// A file or folder cannot be used; also an `OSError`.
    File,
    /// A bug of this package.
    Internal,
}

/// A call that failed. It becomes an exception once the interpreter's lock is held: to wait for that lock while another one is held could
/// block for ever.
#[derive(Debug)]
pub struct Failure {
    kind: Kind,
    text: String,
}

impl From<Failure> for PyErr {
    fn from(Failure { kind, text }: Failure) -> Self {
        static CLASSES: [PyOnceLock<Py<PyType>>; 4] =
            [PyOnceLock::new(), PyOnceLock::new(), PyOnceLock::new(), PyOnceLock::new()];
        let (slot, name) = match kind {
            Kind::General => (&CLASSES[0], "Error"),
            Kind::Argument => (&CLASSES[1], "ArgumentError"),
            Kind::File => (&CLASSES[2], "FileError"),
            Kind::Internal => (&CLASSES[3], "InternalError"),
        };
        Python::attach(|py| match slot.import(py, "mambavitact.errors", name) {
            Ok(class) => PyErr::from_type(class.clone(), text),
            Err(error) => error,
        })
    }
}

impl Kind {
    /// Makes a failure.
    pub fn error(self, text: impl Into<String>) -> Failure {
        Failure { kind: self, text: text.into() }
    }

    /// Makes a failure of an error with all its causes, on one line.
    pub fn of(self) -> impl Fn(anyhow::Error) -> Failure {
        move |error| self.error(mambavitact::in_words(&error))
    }
}

/// Makes a failure of the class for wrong arguments.
pub fn argument(error: impl Into<anyhow::Error>) -> Failure {
    Kind::Argument.of()(error.into())
}

/// Makes a failure of the class for files.
pub fn file(error: impl Into<anyhow::Error>) -> Failure {
    Kind::File.of()(error.into())
}

/// Makes a failure of the base class.
pub fn general(error: impl Into<anyhow::Error>) -> Failure {
    Kind::General.of()(error.into())
}

/// Calls a function without the interpreter's lock. A panic becomes an `InternalError`; a signal that came meanwhile raises its exception.
pub fn detached<T: Send>(py: Python<'_>, call: impl FnOnce() -> Result<T, Failure> + Send) -> PyResult<T> {
    let result = py.detach(|| catch_unwind(AssertUnwindSafe(call)));
    py.check_signals()?;
    let result = result.unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
        Err(Kind::Internal.error(format!("this is a bug of mambavitact, please report it: {text}")))
    });
    Ok(result?)
}

/// Raises warnings, which Python shows once each.
pub fn warn(py: Python<'_>, warnings: Vec<String>) -> PyResult<()> {
    if warnings.is_empty() {
        return Ok(());
    }
    let warn = py.import("warnings")?.getattr("warn")?;
    warnings.into_iter().try_for_each(|warning| warn.call1((warning,)).map(drop))
}

/// Checks a multiple of Redwood's depth noise.
pub fn check_camera_noise(camera_noise: f64) -> PyResult<()> {
    if (0.0..=100.0).contains(&camera_noise) {
        return Ok(());
    }
    Err(Kind::Argument.error(format!("camera_noise: expected 0 to 100, got {camera_noise}")).into())
}

/// Checks the longest duration of an episode.
pub fn check_duration(duration_s: f64) -> PyResult<()> {
    if duration_s > 0.0 && duration_s <= 3600.0 {
        return Ok(());
    }
    Err(Kind::Argument.error(format!("duration_s: expected more than 0 and at most 3600, got {duration_s}")).into())
}
