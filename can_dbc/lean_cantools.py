"""Keeps what only `cantools.tester` needs out of every program until somebody uses that.

The tester imports python-can, and that all it finds for its own log formats, pandas among them: it
took half of the time that each of our programs needed to start. Nothing here uses it; who does gets
it whole, a moment later.
"""

import importlib
import sys
from types import ModuleType
from typing import Any, Final

TESTER: Final = "cantools.tester"


class _Later(ModuleType):
    """Stands in for the tester, and becomes it when something in it is first asked for."""

    def __getattr__(self, name: str) -> Any:
        # The import system asks for names of its own, which mean no use.
        if name.startswith("__"):
            raise AttributeError(f"module {TESTER!r} has no attribute {name!r}")
        return getattr(_tester(), name)


def put_off_tester() -> None:
    """From now on the tester is imported when something in it is first asked for.

    To be called before cantools is imported; afterwards there is nothing left to put off.
    """
    if "cantools" not in sys.modules:
        sys.modules.setdefault(TESTER, _Later(TESTER))


def _tester() -> ModuleType:
    if isinstance(sys.modules.get(TESTER), _Later):
        del sys.modules[TESTER]
    return importlib.import_module(TESTER)
