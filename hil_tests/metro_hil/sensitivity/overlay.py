"""Copies of the packages for workers: one as it is, and one with the changed file of each mutant.

A worker imports from these copies only, never from the checkout and never from a compiled copy.
"""

import importlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from metro_hil.engine.local_pool import ONE_THREAD
from metro_hil.model.compiled_copy import PACKAGES
from metro_hil.sensitivity.mutants import ControllerMutant, mutated_source

MUTATED: Final = "METRO_MUTATED"
"""Environment variable of a worker: `module=path` of the source that it has to run."""
TRUE: Final = "true"
COMPILED: Final = "*.so"


class Overlays:
    """All copies of one session, below one folder that the caller removes."""

    def __init__(self, folder: Path) -> None:
        """Copies the packages that this process itself runs from, without compiled modules."""
        self._folder = folder
        self.true = folder / TRUE
        for name in PACKAGES:
            module = importlib.import_module(name)
            assert module.__file__ is not None
            source = Path(module.__file__).parent
            shutil.copytree(source, self.true / name, ignore=shutil.ignore_patterns(COMPILED))

    def true_environment(self, environment: Mapping[str, str]) -> dict[str, str]:
        """Of a worker that runs the controller as it is."""
        return _importing_from(environment, self.true)

    def environment(
        self, mutant: ControllerMutant, environment: Mapping[str, str]
    ) -> dict[str, str]:
        """Of a worker that runs the mutant; makes its copy. Raises SettingsError as it applies."""
        text = mutated_source(mutant, self.true)
        root = self._folder / f"mutant-{mutant.name}"
        package = root / mutant.package
        shutil.copytree(self.true / mutant.package, package, copy_function=os.link)
        path = root / mutant.file
        path.unlink()
        # The bytecode of the true file may have the size and the second of the changed one.
        for cached in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            cached.unlink()
        path.write_text(text, encoding="utf-8")
        return {
            **_importing_from(environment, root, self.true),
            MUTATED: f"{mutant.module}={path}",
        }

    def discard(self, mutant: ControllerMutant) -> None:
        """Remove the copy of a mutant that is done."""
        shutil.rmtree(self._folder / f"mutant-{mutant.name}", ignore_errors=True)


def _importing_from(environment: Mapping[str, str], *folders: Path) -> dict[str, str]:
    """Safe path: else Python would look into the working directory first, which may be a checkout.

    The copies belong to one process each, so they need no locks and their bytecode may be kept.
    """
    return {
        **ONE_THREAD,
        **{name: value for name, value in environment.items() if name != MUTATED},
        "PYTHONPATH": os.pathsep.join(map(str, folders)),
        "PYTHONSAFEPATH": "1",
    }
