"""Exceptions of the package."""


class Error(Exception):
    """A call failed. The base class of all exceptions of this package."""


class ArgumentError(Error, ValueError):
    """An argument is wrong. The message names it, the expected value, and the given one."""


class FileError(Error, OSError):
    """A file or folder cannot be read or written. The message names it."""


class InternalError(Error):
    """A bug of this package. Please report it."""
