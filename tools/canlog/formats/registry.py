"""The formats: how to recognise each, and which module reads and writes it."""

import importlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from canlog.damage import Damages, LogError
from canlog.formats.candump_line import parse
from canlog.formats.foreign import looks_like
from canlog.formats.heads import (
    is_busmaster,
    is_gvret,
    is_kvaser,
    is_microchip,
    is_pcap,
    is_python_can_csv,
    is_sqlite,
)
from canlog.frames import Frames
from canlog.options import ReadOptions
from canlog.source import GZIP, ZSTD, head_of

Read = Callable[[Path, ReadOptions, Damages], Iterator[Frames]]
Write = Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Format:
    """One format. Its module has `read`, and `write` if the format can be written."""

    name: str
    suffixes: tuple[str, ...]
    module: str
    told_by: Callable[[bytes], bool]
    """Decides from the first bytes of a file whether it has this format."""
    writes: bool = True
    """Whether canlog can write the format."""

    @property
    def read(self) -> Read:
        found: Read = self._module().read
        return found

    @property
    def write(self) -> Write:
        """Writer of the format. Raises LogError for a format that is only read."""
        if not self.writes:
            known = ", ".join(each.name for each in FORMATS if each.writes)
            raise LogError(f"{self.name} is only read; --to takes {known}")
        found: Write = self._module().write
        return found

    def _module(self) -> Any:
        return importlib.import_module(f"canlog.formats.{self.module}")


def _asc(head: bytes) -> bool:
    return head.lstrip()[:5].lower() == b"date " or b"base hex" in head or b"base dec" in head


def _trc(head: bytes) -> bool:
    return head.startswith((b";$FILEVERSION", b";$STARTTIME")) or b";   Message Number" in head


def _candump(head: bytes) -> bool:
    """Whether a line is a frame as candump writes it to files or to a terminal."""
    return any(parse(line.rstrip(b"\r")) is not None for line in head.split(b"\n"))


FORMATS: Final = (
    Format("blf", (".blf",), "blf", lambda head: head.startswith(b"LOGG")),
    Format("mf4", (".mf4", ".mdf"), "mf4", lambda head: head.startswith((b"MDF ", b"UnFinMF"))),
    Format("mcap", (".mcap",), "mcap_log", lambda head: head.startswith(b"\x89MCAP0\r\n")),
    Format("parquet", (".parquet",), "parquet", lambda head: head.startswith(b"PAR1")),
    Format("pcap", (".pcap", ".pcapng", ".cap"), "pcap", is_pcap, writes=False),
    Format("sqlite", (".db", ".sqlite", ".sqlite3"), "python_can_sqlite", is_sqlite, writes=False),
    Format("gvret", (), "gvret", is_gvret, writes=False),
    Format("python-can", (), "python_can_csv", is_python_can_csv, writes=False),
    Format("busmaster", (), "busmaster", is_busmaster, writes=False),
    Format("microchip", (), "microchip", is_microchip, writes=False),
    Format("kvaser", (), "kvaser", is_kvaser, writes=False),
    Format("trc", (".trc",), "trc", _trc),
    Format("asc", (".asc",), "asc", _asc),
    Format("candump", (".log", ".candump", ".txt"), "candump", _candump),
)
COMPRESSED: Final = (".gz", ".zst")


def named(name: str) -> Format:
    """Return the format of a name. Raises LogError."""
    for each in FORMATS:
        if each.name == name:
            return each
    raise LogError(f"{name}: no such format; there are {', '.join(f.name for f in FORMATS)}")


def by_suffix(path: Path) -> Format | None:
    """Return the format for a file name, ignoring `.gz` and `.zst`."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes and suffixes[-1] in COMPRESSED:
        suffixes.pop()
    if not suffixes:
        return None
    return next((each for each in FORMATS if suffixes[-1] in each.suffixes), None)


def format_of(path: Path, name: str | None = None) -> Format:
    """Return the format of a file: by `name` if given, else by its first bytes, else by its suffix.

    Raises:
        LogError: for a file that cannot be read or has no known format.
    """
    if name is not None:
        return named(name)
    head = head_of(path)
    told = next((each for each in FORMATS if head and each.told_by(head)), None)
    found = told if told is not None and told.name != "candump" else by_suffix(path) or told
    if found is None:
        known = ", ".join(each.name for each in FORMATS)
        seems = looks_like(head)
        raise LogError(f"{path}: of no known format; it looks like {seems}; --format takes {known}")
    return found


def is_compressed(head: bytes) -> bool:
    return head.startswith((GZIP, ZSTD))


def chained(first: Frames, rest: Iterable[Frames]) -> Iterator[Frames]:
    yield first
    yield from rest
