"""Errors of storage. They have a module of their own, as mypyc compiles no heir of `OSError`."""


class RecorderError(OSError):
    """A log that cannot be opened; the text names the path."""
