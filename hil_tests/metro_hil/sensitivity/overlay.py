"""Copies of the packages for workers: an unchanged one, and one for each mutant.

A worker imports only from these copies, never from the checkout or a compiled copy.
"""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from metro_hil.engine.local_pool import ONE_THREAD
from metro_hil.model.native_copy import package_folders
from metro_hil.sensitivity.mutants import ControllerMutant, mutated_source

MUTATED: Final = "METRO_MUTATED"
"""Environment variable of a worker: `module=path` of the source that it must run."""
TRUE: Final = "true"
COMPILED: Final = "*.so"


class Overlays:
    """All copies of one session, below a folder that the caller removes."""

    def __init__(self, folder: Path) -> None:
        """Copy the packages from which this process runs, without compiled modules."""
        self._folder = folder
        self.true = folder / TRUE
        for name, source in package_folders().items():
            shutil.copytree(source, self.true / name, ignore=shutil.ignore_patterns(COMPILED))

    def true_environment(self, environment: Mapping[str, str]) -> dict[str, str]:
        """Environment of a worker that runs the unchanged controller."""
        return _importing_from(environment, self.true)

    def environment(
        self, mutant: ControllerMutant, environment: Mapping[str, str]
    ) -> dict[str, str]:
        """Copy the mutant, and return the environment of its worker. Raises SettingsError."""
        text = mutated_source(mutant, self.true)
        root = self._folder / f"mutant-{mutant.name}"
        package = root / mutant.package
        shutil.copytree(self.true / mutant.package, package, copy_function=os.link)
        path = root / mutant.file
        path.unlink()
        # Bytecode of the true file may match the changed file's size and time, so Python would run
        # it.
        for cached in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            cached.unlink()
        path.write_text(text, encoding="utf-8")
        return {
            **_importing_from(environment, root, self.true),
            MUTATED: f"{mutant.module}={path}",
        }

    def discard(self, mutant: ControllerMutant) -> None:
        """Remove the copy of a finished mutant."""
        shutil.rmtree(self._folder / f"mutant-{mutant.name}", ignore_errors=True)


def _importing_from(environment: Mapping[str, str], *folders: Path) -> dict[str, str]:
    """Environment for imports from these folders.

    The safe path keeps Python from searching the working directory first, which may be a checkout.
    Each copy belongs to one process, so it needs no locks and may keep its bytecode.
    """
    return {
        **ONE_THREAD,
        **{name: value for name, value in environment.items() if name != MUTATED},
        "PYTHONPATH": os.pathsep.join(map(str, folders)),
        "PYTHONSAFEPATH": "1",
    }
