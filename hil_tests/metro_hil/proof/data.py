"""`make mutate` of the data: wrong maps, parameters and scales, and the scenario that notices each.

Both sides of a run read the same files, so both would share a mistake in a file, and no check would
see it. Therefore only the controller gets the mistake.
"""

import argparse
import dataclasses
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from firmware_py.settings import SettingsError, build
from metro_hil.model.case import CaseResult
from metro_hil.model.case_setup import CaseParts
from metro_hil.proof.belief_runs import (
    FRAMES,
    BeliefRun,
    misread,
    notices,
    rides_of,
    run,
    with_line,
)

DATA_FILE: Final = "hil_tests/proof/data_mutants.toml"
SIDES: Final = ("map", "belief", "frame")
EXIT_OK: Final = 0
EXIT_SURVIVORS: Final = 1
EXIT_USAGE: Final = 2


class DataMutantError(Exception):
    """The list contains an invalid entry; the text names file, mutant and value."""


@dataclass(frozen=True, slots=True)
class DataMutant:
    """One wrong number."""

    name: str
    side: str
    """`map`, `belief` or `frame`; the mistake affects the controller alone."""
    place: str
    """Path of the field, such as tags.2.position_m, atp.rollback_m or Doppler.speed_mps."""
    scenarios: tuple[str, ...]
    """Entries `campaign: case`, where a prefix of the case id is enough; one of them must fail."""
    add_m: float = 0.0
    """Added to the number, whatever its unit."""
    factor_ratio: float = 1.0

    def changed(self, value: float) -> float:
        return value * self.factor_ratio + self.add_m


def read_mutants(root: Path) -> list[DataMutant]:
    """Read the mutants. Raises DataMutantError, also for a mutant without scenarios."""
    try:
        tables = tomllib.loads((root / DATA_FILE).read_text(encoding="utf-8"))["mutant"]
        mutants = [build(DataMutant, table, DATA_FILE) for table in tables]
    except (OSError, tomllib.TOMLDecodeError, KeyError) as error:
        raise DataMutantError(f"{DATA_FILE}: {error}") from None
    for mutant in mutants:
        where = f"{DATA_FILE}: {mutant.name}"
        if mutant.side not in SIDES:
            raise DataMutantError(
                f"{where}: side: {mutant.side!r} is not one of {', '.join(SIDES)}"
            )
        if not mutant.scenarios:
            raise DataMutantError(
                f"{where}: scenarios: is empty; name a scenario that has to notice it"
            )
        for name in mutant.scenarios:
            try:
                rides_of(name)
            except (KeyError, SettingsError) as error:
                raise DataMutantError(f"{where}: scenarios: {name!r}: {error}") from None
    return mutants


def with_change(value: Any, path: Sequence[str], mutant: DataMutant) -> Any:
    """Return the value with one number changed. Raises DataMutantError for an unknown field."""
    if not path:
        return mutant.changed(value)
    head, *rest = path
    try:
        if isinstance(value, tuple):
            place = int(head)
            return (*value[:place], with_change(value[place], rest, mutant), *value[place + 1 :])
        inner = with_change(getattr(value, head), rest, mutant)
    except (AttributeError, IndexError, ValueError) as error:
        raise DataMutantError(f"{DATA_FILE}: {mutant.name}: {mutant.place}: {error}") from None
    return dataclasses.replace(value, **{head: inner})


def ride_notices(mutant: DataMutant, known_good: set[str]) -> str:
    """Return the case and the monitors that notice the mutant; nothing if none does."""
    path = mutant.place.split(".")

    def believed(parts: CaseParts) -> CaseParts:
        if mutant.side == "map":
            return with_line(parts, with_change(parts.journey.line, path, mutant))
        return dataclasses.replace(parts, config=with_change(parts.config, path, mutant))

    def mistaken(ride: BeliefRun) -> CaseResult | None:
        if mutant.side != "frame":
            return run(ride, believed)
        with misread(FRAMES[path[0]], path[1], mutant.changed):
            return run(ride)

    return notices(mutant.scenarios, mistaken, known_good)


def _chosen(mutants: list[DataMutant], names: Sequence[str]) -> list[DataMutant]:
    """Return the mutants of these names, by default all.

    Raises DataMutantError for unknown names.
    """
    for name in names:
        if not any(mutant.name == name for mutant in mutants):
            raise DataMutantError(f"{DATA_FILE}: no mutant is named {name!r}")
    return [mutant for mutant in mutants if not names or mutant.name in names]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the mutants: 0 if scenarios notice all of them, 1 if not, 2 for an invalid list.

    A case that fails with the right data notices nothing.
    """
    parser = argparse.ArgumentParser(prog="data mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="default: all")
    parser.add_argument("--root", type=Path, default=Path.cwd(), help="the checkout")
    options = parser.parse_args(argv)
    missed, known_good = 0, set[str]()
    try:
        mutants = _chosen(read_mutants(options.root), options.names)
        for mutant in mutants:
            by = ride_notices(mutant, known_good)
            missed += not by
            print(f"{mutant.name:44} {by or 'NOT NOTICED'}", flush=True)
    except (DataMutantError, SettingsError) as error:
        print(f"mutate: {error}", file=sys.stderr)
        return EXIT_USAGE
    print(f"{len(mutants)} data mutants, {len(mutants) - missed} noticed")
    return EXIT_SURVIVORS if missed else EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
