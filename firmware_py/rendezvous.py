"""Meeting point of the processes of one bench on this machine, by the name of their bus.

A bench has a folder that only its user can enter. It contains the embedded bus's socket and lock, a
link to the tag reader's serial line, and the radio's endpoint. Any of them may be left over from a
killed process, so a reader must check that a process is behind it.
"""

import os
import stat
import tempfile
from pathlib import Path
from typing import Final

from firmware_py.buses.errors import BusError
from firmware_py.buses.interfaces import BUS_NAME

PRIVATE_MODE: Final = 0o700
SOCKET_PATH_LIMIT: Final = 107
"""Longest address of a Unix socket in bytes."""


class RendezvousError(BusError):
    """The meeting point cannot be used; the text names it and says what to do."""


def bench_dir(bus_name: str) -> Path:
    """Return the folder of a bus's bench, and create it if needed.

    It is `metro-bench-<uid>/<bus>` below $XDG_RUNTIME_DIR, or below the folder for temporary files
    if that variable names no folder.

    Raises:
        RendezvousError: if the name is not valid for a bus, or if the folder cannot be created, is
            a link, or belongs to another user.
    """
    if not BUS_NAME.fullmatch(bus_name):
        raise RendezvousError(
            f"bus name {bus_name!r}: 1 to 15 letters, digits, '_', '.' or '-' are needed"
        )
    above = _base() / f"metro-bench-{os.getuid()}"
    _make_private(above)
    folder = above / bus_name
    _make_private(folder)
    return folder


def hub_socket(bus_name: str) -> Path:
    """Path of the embedded bus's socket."""
    path = bench_dir(bus_name) / "bus.sock"
    length = len(os.fsencode(path))
    if length > SOCKET_PATH_LIMIT:
        raise RendezvousError(
            f"{path}: {length} bytes are too long for a socket ({SOCKET_PATH_LIMIT} fit); "
            "set XDG_RUNTIME_DIR to a shorter folder"
        )
    return path


def hub_lock(bus_name: str) -> Path:
    """Path of the hub's lock, which the running hub holds and which contains its process id."""
    return bench_dir(bus_name) / "hub.pid"


def tags_link(bus_name: str) -> Path:
    """Path of the link to the serial line of the plant's tag reader."""
    return bench_dir(bus_name) / "tags"


def radio_note(bus_name: str) -> Path:
    """Path of the file with the radio's endpoint."""
    return bench_dir(bus_name) / "radio"


def publish_tags(bus_name: str, device: str) -> Path:
    """Let the link point at a serial device and replace an old link."""
    link = tags_link(bus_name)
    fresh = link.with_name(f"tags.{os.getpid()}")
    try:
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(device)
        fresh.replace(link)
    except OSError as error:
        raise RendezvousError(f"{link}: cannot be made: {error.strerror}") from error
    return link


def publish_radio(bus_name: str, endpoint: str) -> None:
    note = radio_note(bus_name)
    fresh = note.with_name(f"radio.{os.getpid()}")
    try:
        fresh.write_text(endpoint + "\n", encoding="utf-8")
        fresh.replace(note)
    except OSError as error:
        raise RendezvousError(f"{note}: cannot be written: {error.strerror}") from error


def read_radio(bus_name: str) -> str | None:
    """Return the endpoint published last; None if there is none."""
    try:
        return radio_note(bus_name).read_text(encoding="utf-8").strip() or None
    except (OSError, UnicodeDecodeError):
        return None


def withdraw(bus_name: str) -> None:
    """Remove the link and the endpoint that a plant published."""
    for path in (tags_link(bus_name), radio_note(bus_name)):
        path.unlink(missing_ok=True)


def _base() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        return Path(runtime)
    return Path(tempfile.gettempdir())


def _make_private(folder: Path) -> None:
    """Create a folder that only this user can enter, or verify an existing one.

    The folder is opened without following links, and the opened folder is checked. So no other user
    can replace it between check and use.
    """
    try:
        folder.mkdir(mode=PRIVATE_MODE, exist_ok=True)
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError as error:
        # For a link and for a file the system reports "not a directory".
        raise RendezvousError(
            f"{folder}: cannot be used as a private folder: {error.strerror}"
        ) from error
    try:
        found = os.fstat(opened)
        if found.st_uid != os.getuid():
            raise RendezvousError(
                f"{folder}: belongs to user {found.st_uid}, not to you ({os.getuid()}); "
                "remove it or set XDG_RUNTIME_DIR to a folder of your own"
            )
        if stat.S_IMODE(found.st_mode) != PRIVATE_MODE:
            os.fchmod(opened, PRIVATE_MODE)
    finally:
        os.close(opened)
