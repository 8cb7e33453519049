"""Delays the import of python-can's MF4 support until a program uses it.

python-can imports all of its log formats at once. For MF4 these are asammdf and pandas, if
installed, which take ten times as long as the rest. A bus needs none of them.
"""

import importlib
import sys
from types import ModuleType
from typing import Any, Final

MF4: Final = "can.io.mf4"
CLASSES: Final = ("MF4Reader", "MF4Writer")


class _Later(ModuleType):
    """Placeholder for the module, with classes that create objects of the real ones."""

    def __init__(self) -> None:
        super().__init__(MF4)
        for name in CLASSES:
            setattr(self, name, type(name, (), {"__new__": _maker(name)}))


def put_off_mf4() -> None:
    """Delay the import of the format until its first reader or writer is created.

    Call it before python-can is imported; afterwards it has no effect.
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
