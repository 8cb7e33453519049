"""Work of a process and its order, as plain values that can be sent through a pipe."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

PYTEST_ARGS: Final = ("-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--capture=sys")


@dataclass(frozen=True, slots=True)
class MutantTask:
    """Mutants of one group."""

    root: str
    modules: tuple[str, ...]
    """All modules whose functions are watched while the tests run."""
    tests: tuple[str, ...]
    """Test files."""
    numbers: Mapping[str, tuple[int, ...]]
    """Numbers of the mutants to try, by module."""
    jobs: int


@dataclass(frozen=True, slots=True)
class MutantOrder:
    """One mutant and its tests, ordered by how likely they detect it."""

    module: str
    number: int
    tests: tuple[str, ...]
    """Names of the tests in pytest."""
    limit_s: float
    """Processor time of the tests without the mutation."""


@dataclass(frozen=True, slots=True)
class FreshImportTask:
    """Mutants that need a fresh import of everything."""

    orders: tuple[MutantOrder, ...]
    foreign: tuple[str, ...]
    """Modules outside of the project, without mutations; imported only once."""
