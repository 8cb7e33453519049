"""Holds the bus and the logs in C, for programs in virtual time that ask for them.

After `use_core` new buses and logs use the module. Their Python classes are the readable reference
and give the same bytes.
"""

from importlib import resources
from typing import Any, Final

STEM: Final = "bench_core"
HEADERS: Final = ("bus.h", "frame_bits.h", "lines.h", "number.h")

_core: Any = None


def native_core() -> Any:
    """The module in use; None for Python's classes."""
    return _core


def use_core(module: Any) -> None:
    """Let new buses and logs use this module; with None they use Python's classes."""
    global _core
    _core = module


def core_sources() -> dict[str, bytes]:
    """Return the C files of the module by name."""
    folder = resources.files("firmware_py") / "native"
    return {name: (folder / name).read_bytes() for name in (f"{STEM}.c", *HEADERS)}
