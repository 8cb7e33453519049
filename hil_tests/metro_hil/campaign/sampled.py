"""Design `drawn`: samples whole cases from their seeds, with values of factors and pool faults."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from metro_hil.campaign.designs import Choice
from metro_hil.campaign.factors import Factor, read_factors
from metro_hil.campaign.problems import Findings

if TYPE_CHECKING:
    import numpy as np

DRAW_SPAWN_KEY: Final = 0xCA
"""Separates the random numbers that make a case from those that its run uses with the same seed."""
FAULTS: Final = "fault"
"""Key of a choice for the sampled faults; they follow those of the scenario."""


@dataclass(frozen=True, slots=True)
class FaultPool:
    """Faults of which each case gets some, each at most once."""

    entries: tuple["PoolEntry", ...] = ()
    least: int = 0
    most: int = 0


@dataclass(frozen=True, slots=True)
class PoolEntry:
    """One fault with its fixed and its sampled keys."""

    fixed: Mapping[str, Any]
    drawn: tuple[Factor, ...]


def read_pool(
    tables: object, window: object, *, least: int, most: int, findings: Findings
) -> FaultPool:
    """The faults of `[[sweep.fault]]`, each with the keys of `[sweep.window]` that it lacks.

    A list holds levels and `{ low, high }` is a range, as in factors; other values are fixed.
    """
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        findings.add("sweep.fault", "is not an array of tables; write [[sweep.fault]]")
        return FaultPool()
    if not isinstance(window, Mapping):
        findings.add("sweep.window", f"{window!r} is not a table")
        return FaultPool()
    entries = [
        _entry({**window, **table}, f"sweep.fault[{index}]", findings)
        for index, table in enumerate(tables)
    ]
    if not least <= most <= len(entries):
        findings.add(
            "sweep.faults_max",
            f"{most} is not within faults_min {least} and the {len(entries)} faults of the pool",
        )
    return FaultPool(tuple(entries), least, most)


def _entry(table: Mapping[str, Any], where: str, findings: Findings) -> PoolEntry:
    varied = {
        key: value
        for key, value in table.items()
        if isinstance(value, list) or (isinstance(value, Mapping) and "low" in value)
    }
    alone = Findings()
    drawn = read_factors(varied, alone)
    for key, what in alone.found:
        findings.add(key.replace("sweep.factors", where), what)
    return PoolEntry({key: item for key, item in table.items() if key not in varied}, drawn)


def draw(seed: int, factors: Sequence[Factor], pool: FaultPool) -> Choice:
    """The choice of one seed, which depends only on the arguments."""
    import numpy as np

    sequence = np.random.SeedSequence(seed, spawn_key=(DRAW_SPAWN_KEY,))
    generator = np.random.Generator(np.random.PCG64(sequence))
    choice: Choice = {factor.key: factor.at(float(generator.random())) for factor in factors}
    if pool.entries:
        count = int(generator.integers(pool.least, pool.most + 1))
        places = sorted(generator.permutation(len(pool.entries))[:count].tolist())
        choice[FAULTS] = [_fault(pool.entries[place], generator) for place in places]
    return choice


def _fault(entry: PoolEntry, generator: "np.random.Generator") -> dict[str, Any]:
    drawn = {factor.key: factor.at(float(generator.random())) for factor in entry.drawn}
    return {**entry.fixed, **drawn}


def faults_words(faults: Sequence[Mapping[str, Any]]) -> str:
    """Kinds of the faults as text, for a factor of the case."""
    return " + ".join(sorted(str(fault.get("kind", "?")) for fault in faults)) or "none"
