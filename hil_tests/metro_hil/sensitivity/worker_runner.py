"""Runner of a worker of `hil sensitivity`: runs one case on the requested source."""

import os
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec
from pathlib import Path

from metro_hil.model.case import Case, CaseResult
from metro_hil.model.case_setup import NO_FILES, Files
from metro_hil.model.run_folder import RunFolder
from metro_hil.run.case import run_alone
from metro_hil.sensitivity.overlay import MUTATED


class WrongSourceError(Exception):
    """The worker does not run the mutated source."""


def run_case(case: Case, *, files: Files = NO_FILES, folder: RunFolder | None = None) -> CaseResult:
    """Like `metro_hil.run.dispatch.run_case` in virtual time. Raises WrongSourceError."""
    demand_mutated_source()
    return run_alone(case, files=files, folder=folder)


def demand_mutated_source() -> None:
    """Raises WrongSourceError unless the mutated module comes from its changed file."""
    asked = os.environ.get(MUTATED)
    if asked is None:
        return
    name, _, path = asked.partition("=")
    module = sys.modules.get(name)
    spec = find_spec(name) if module is None else module.__spec__
    origin = None if spec is None else spec.origin
    if spec is None or origin is None or Path(origin).resolve() != Path(path).resolve():
        raise WrongSourceError(f"{name} was imported from {origin}, not from {path}")
    if not isinstance(spec.loader, SourceFileLoader):
        raise WrongSourceError(f"{name} is no Python source: {origin}")
