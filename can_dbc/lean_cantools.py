"""Delays the import of `cantools.tester` until a program uses it.

The tester imports python-can with all its log formats, including pandas. This took half of the
start time of each program, and no program of this project uses it. A program that does gets the
real module at its first use.
"""

import importlib
import sys
from types import ModuleType
from typing import Any, Final

TESTER: Final = "cantools.tester"


class _Later(ModuleType):
    """Placeholder for the tester; the first access to a name in it loads the real module."""

    def __getattr__(self, name: str) -> Any:
        # The import system reads names of its own, which do not count as use.
        if name.startswith("__"):
            raise AttributeError(f"module {TESTER!r} has no attribute {name!r}")
        return getattr(_tester(), name)


def put_off_tester() -> None:
    """Delay the import of the tester until its first use.

    Call it before cantools is imported; afterwards it has no effect.
    """
    if "cantools" not in sys.modules:
        sys.modules.setdefault(TESTER, _Later(TESTER))


def _tester() -> ModuleType:
    if isinstance(sys.modules.get(TESTER), _Later):
        del sys.modules[TESTER]
    return importlib.import_module(TESTER)
