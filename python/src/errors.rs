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

impl Kind {
    /// Makes an exception.
    pub fn error(self, text: impl Into<String>) -> PyErr {
        static CLASSES: [PyOnceLock<Py<PyType>>; 4] =
            [PyOnceLock::new(), PyOnceLock::new(), PyOnceLock::new(), PyOnceLock::new()];
        let (slot, name) = match self {
            Self::General => (&CLASSES[0], "Error"),
            Self::Argument => (&CLASSES[1], "ArgumentError"),
            Self::File => (&CLASSES[2], "FileError"),
            Self::Internal => (&CLASSES[3], "InternalError"),
        };
        let text = text.into();
        Python::attach(|py| match slot.import(py, "mambavitact.errors", name) {
            Ok(class) => PyErr::from_type(class.clone(), text),
            Err(error) => error,
        })
    }

    /// Makes an exception of an error with all its causes, on one line.
    pub fn of(self) -> impl Fn(anyhow::Error) -> PyErr {
        move |error| self.error(mambavitact::in_words(&error))
    }
}

/// Makes an exception of the class for wrong arguments.
pub fn argument(error: impl Into<anyhow::Error>) -> PyErr {
    Kind::Argument.of()(error.into())
}

/// Makes an exception of the class for files.
pub fn file(error: impl Into<anyhow::Error>) -> PyErr {
    Kind::File.of()(error.into())
}

/// Makes an exception of the base class.
pub fn general(error: impl Into<anyhow::Error>) -> PyErr {
    Kind::General.of()(error.into())
}

/// Calls a function without the interpreter's lock. A panic becomes an `InternalError`; a signal that came meanwhile raises its exception.
pub fn detached<T: Send>(py: Python<'_>, call: impl FnOnce() -> PyResult<T> + Send) -> PyResult<T> {
    let result = py.detach(|| catch_unwind(AssertUnwindSafe(call)));
    py.check_signals()?;
    result.unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
        Err(Kind::Internal.error(format!("this is a bug of mambavitact, please report it: {text}")))
    })
}
