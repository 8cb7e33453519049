"""Finds the copy with compiled modules that `make compiled` makes, if it fits these sources.

The copy gives the same bytes, faster, so campaigns use it for their workers. A copy of other
sources would be another program; it is ignored.
"""

import filecmp
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import firmware_py
from metro_hil.model.native_copy import prepare

FOLDER: Final = ".compiled"
PACKAGES: Final[Mapping[str, str]] = {
    "can_dbc": "can_dbc",
    "zenoh_config": "zenoh_config",
    "firmware_py": "firmware_py",
    "vobc": "vobc",
    "plant_emulator": "plant_emulator",
    "metro_hil": "hil_tests/metro_hil",
}
"""Packages that a worker imports: name in the copy, place in the checkout."""
BUILT: Final = frozenset({".so", ".pyc"})


def library_for(program: str) -> Path | None:
    """Like `compiled_library`, or the copy in the user's cache, whose build this may start.

    The copy of `make compiled` goes first, because it compiles more.
    """
    return compiled_library() or prepare(program)


def compiled_library(checkout: Path | None = None) -> Path | None:
    """PYTHONPATH entry for a worker; None if no copy of `make compiled` fits these sources."""
    root = checkout or Path(firmware_py.__file__).resolve().parent.parent
    library = root / FOLDER / "lib"
    if not library.is_dir() or not any(library.glob("*/*.so")):
        return None
    same = all(_same(root / place, library / name) for name, place in PACKAGES.items())
    return library if same else None


def worker_environment(environment: Mapping[str, str], library: Path | None) -> dict[str, str]:
    """Environment of a worker that imports from the copy; unchanged if there is none."""
    if library is None:
        return dict(environment)
    return {**environment, "PYTHONPATH": str(library), "PYTHONSAFEPATH": "1"}


def _same(source: Path, copy: Path) -> bool:
    names = list(_files(source))
    if names != list(_files(copy)):
        return False
    _, different, unreadable = filecmp.cmpfiles(source, copy, names, shallow=False)
    return not different and not unreadable


def _files(folder: Path) -> Iterator[str]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix not in BUILT:
            yield str(path.relative_to(folder))
