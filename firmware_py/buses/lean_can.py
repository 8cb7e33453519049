"""Keeps what only python-can's MF4 files need out of a process until somebody reads or writes one.

python-can imports all of its log formats with itself; for MF4 that is asammdf and pandas where they
are installed, and takes ten times as long as all the rest. A bus needs none of it.
"""

import importlib
import sys
from types import ModuleType
from typing import Any, Final

MF4: Final = "can.io.mf4"
CLASSES: Final = ("MF4Reader", "MF4Writer")


class _Later(ModuleType):
    """Stands in for the module with classes that make objects of the real ones."""

    def __init__(self) -> None:
        super().__init__(MF4)
        for name in CLASSES:
            setattr(self, name, type(name, (), {"__new__": _maker(name)}))


def put_off_mf4() -> None:
    """From now on the format is imported when the first reader or writer of it is made.

    To be called before python-can is imported; afterwards there is nothing left to put off.
    """
    if "can" not in sys.modules:
        sys.modules.setdefault(MF4, _Later())


def _maker(name: str) -> Any:
    def make(_stand_in: type, *args: Any, **options: Any) -> Any:
        return getattr(_mf4(), name)(*args, **options)

    return make


def _mf4() -> ModuleType:
    if isinstance(sys.modules.get(MF4), _Later):
        del sys.modules[MF4]
    return importlib.import_module(MF4)
