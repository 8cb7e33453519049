"""Errors of storage.

They have a module of their own because mypyc cannot compile a subclass of `OSError`.
"""


class RecorderError(OSError):
    """A log cannot be opened; the text names the path."""
