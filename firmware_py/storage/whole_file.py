"""Atomic files: a reader finds the old content or the new one, never a part of it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

PART: Final = ".part."
"""Prefix of the file during writing. The suffix stays, because some writers depend on it."""


@contextmanager
def whole_file(path: Path | str) -> Iterator[Path]:
    """Yield a path beside `path`, and rename the file written there to `path` at the end.

    After an exception, Ctrl-C, a full disk, `kill -9` or a power cut the old content remains: the
    new content is on the disk before the name points to it. A device or a pipe is written directly.

    Raises:
        OSError: names `path`.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        with named(path):
            yield path
        return
    target = Path(os.path.realpath(path))
    part = target.with_name(f"{PART}{target.name}")
    try:
        with named(path):
            yield part
            _sync(part)
            part.replace(target)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def write_whole(path: Path | str, content: str | bytes) -> None:
    """Write a file atomically; text is UTF-8. Raises OSError that names `path`."""
    data = content.encode() if isinstance(content, str) else content
    with whole_file(path) as part:
        part.write_bytes(data)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Make every OSError name the file that the user knows; some libraries name none."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:
            error.strerror = os.strerror(error.errno)
        error.filename, error.filename2 = str(path), None
        raise


def _sync(path: Path) -> None:
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
