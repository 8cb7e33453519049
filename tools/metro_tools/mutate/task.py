"""What a process is to try, and in which order; plain values that cross a pipe."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

PYTEST_ARGS: Final = ("-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--capture=sys")


@dataclass(frozen=True, slots=True)
class MutantTask:
    """Mutants of one group."""

    root: str
    modules: tuple[str, ...]
    """All that the tests are watched for."""
    tests: tuple[str, ...]
    """Files."""
    numbers: Mapping[str, tuple[int, ...]]
    """Of each module: the mutants to be tried."""
    jobs: int


@dataclass(frozen=True, slots=True)
class MutantOrder:
    """One mutant and the tests for it, in the order in which they are likely to notice it."""

    module: str
    number: int
    tests: tuple[str, ...]
    """As pytest names them."""
    limit_s: float
    """Processor time that they take without the mistake."""


@dataclass(frozen=True, slots=True)
class FreshImportTask:
    """What is tried by importing everything once more."""

    orders: tuple[MutantOrder, ...]
    foreign: tuple[str, ...]
    """Modules that no mistake is in; imported only once."""
