"""`make mutate` of the data: wrong maps, wrong beliefs, wrong scales, and who notices each.

A wrong map or belief is given to the controller alone, which then rides: both sides read the same
files, so that a mistake in a file would be shared and seen by nobody.
A wrong line of a file is tried in a copy of the checkout, against the tests that are named for it.
"""

import argparse
import dataclasses
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from can_dbc.vobc import Supervision
from firmware_py.settings import SettingsError, build
from firmware_py.trackdb import LineMap
from metro_hil.journey import Journey, plan_journey
from metro_hil.lockstep import Lockstep, Taps, config_of, scenario_of
from metro_hil.options import parse
from plant_emulator.truth import Truth
from vobc.config import VobcConfig

DATA_FILE: Final = "hil_tests/proof/data_mutants.toml"
RIDE: Final = ("II", "III")
RIDE_S: Final = 240.0
CLAIM_AGE_S: Final = 0.1
"""A claim is as old as a cycle and the frames before it."""
STOP_TOLERANCE_M: Final = 0.3
COPIED: Final = (
    *("can_dbc", "zenoh_config", "firmware_py", "vobc", "plant_emulator", "hil_tests", "tools"),
    *("docs", "pyproject.toml", "README.md"),
)
NOT_COPIED: Final = shutil.ignore_patterns("__pycache__", "*.pyc")
EXIT_OK: Final = 0
EXIT_SURVIVORS: Final = 1
EXIT_USAGE: Final = 2


class DataMutantError(Exception):
    """The list says something that cannot be; names file, mutant and value."""


@dataclass(frozen=True, slots=True)
class DataMutant:
    """One wrong number or word."""

    name: str
    side: str
    """`map` or `belief` of the controller alone, or `file`."""
    place: str
    """Field path, such as tags.2.position_m or train.length_m; or the file."""
    add_m: float = 0.0
    """Added to the number."""
    factor_ratio: float = 1.0
    old: str = ""
    """In a file: what stands there, once."""
    new: str = ""
    tests: tuple[str, ...] = ()
    """For a file: at least one of these fails."""
    ride: tuple[str, ...] = RIDE


def read_mutants(root: Path) -> list[DataMutant]:
    """Raises DataMutantError."""
    try:
        tables = tomllib.loads((root / DATA_FILE).read_text(encoding="utf-8"))["mutant"]
        return [build(DataMutant, table, DATA_FILE) for table in tables]
    except (OSError, tomllib.TOMLDecodeError, KeyError) as error:
        raise DataMutantError(f"{DATA_FILE}: {error}") from None


def with_change(value: Any, path: Sequence[str], mutant: DataMutant) -> Any:
    """The same value with one number in it changed. Raises DataMutantError for no such field."""
    if not path:
        return value * mutant.factor_ratio + mutant.add_m
    head, *rest = path
    try:
        if isinstance(value, tuple):
            place = int(head)
            return (*value[:place], with_change(value[place], rest, mutant), *value[place + 1 :])
        return dataclasses.replace(value, **{head: with_change(getattr(value, head), rest, mutant)})
    except (AttributeError, IndexError, ValueError) as error:
        raise DataMutantError(f"{DATA_FILE}: {mutant.name}: {mutant.place}: {error}") from None


class _Watch:
    """Compares what the controller claims with what is true, at every step of the plant."""

    def __init__(self, line: LineMap, config: VobcConfig) -> None:
        self._line, self._margin_mps = line, config.atp.emergency_margin_mps
        self.bench: Lockstep | None = None
        self._moved = False
        self.seen: dict[str, None] = {}

    def __call__(self, truth: Truth, now_ns: int) -> None:
        if self.bench is None:
            return
        output = self.bench.vobc.output
        motion = output.motion
        if truth.speed_mps > self._limit_mps(truth) + self._margin_mps:
            self.seen["civil limit"] = None
        self._moved = self._moved or output.force_n > 0.0
        if self._moved and output.supervision is Supervision.EMERGENCY:
            self.seen["emergency brake"] = None
        if motion is not None and motion.localised:
            moved_m = abs(truth.speed_mps) * CLAIM_AGE_S
            if not motion.front_m.low - moved_m <= truth.front_m <= motion.front_m.high + moved_m:
                self.seen["place outside its interval"] = None
            if motion.refused_tags:
                self.seen["tag refused"] = None

    def _limit_mps(self, truth: Truth) -> float:
        return self._line.least_limit_mps(truth.rear_m, truth.front_m)


def ride_notices(mutant: DataMutant | None) -> tuple[str, ...]:
    """Who notices that the controller has a wrong map or belief; nobody should without a mutant."""
    start, end = RIDE if mutant is None else mutant.ride
    options = parse(["run", "--lockstep", "--from", start, "--to", end])
    journey, config = plan_journey(options), config_of(options)
    wrong, wrong_config = journey, config
    try:
        if mutant is not None and mutant.side == "map":
            line = with_change(journey.line, mutant.place.split("."), mutant)
            wrong = _journey_on(line, journey)
        elif mutant is not None:
            wrong_config = with_change(config, mutant.place.split("."), mutant)
    except ValueError as error:
        return (f"refused on loading: {error}",)
    watch = _Watch(journey.line, config)
    bench = Lockstep(wrong_config, scenario_of(options), wrong, taps=Taps(truth=watch))
    watch.bench = bench
    try:
        bench.run(RIDE_S)
        arrived, front_m = bench.arrived, bench.plant.world.front_m
    finally:
        bench.close()
    if not arrived:
        watch.seen["does not arrive"] = None
    elif abs(front_m - journey.end.stop_m) > STOP_TOLERANCE_M:
        watch.seen["stops beside its place"] = None
    return tuple(watch.seen)


def _journey_on(line: LineMap, journey: Journey) -> Journey:
    """The same journey by a wrong map."""
    by_name = {station.name: station for station in line.stations}
    mission = dataclasses.replace(
        journey.mission,
        start=by_name[journey.mission.start.name],
        stops=tuple(by_name[stop.name] for stop in journey.mission.stops),
    )
    return Journey(line, mission)


def file_notices(mutant: DataMutant, copy: Path) -> tuple[str, ...]:
    """The named tests that fail in a copy of the checkout with the wrong line in it."""
    path = copy / mutant.place
    text = path.read_text(encoding="utf-8")
    if text.count(mutant.old) != 1:
        raise DataMutantError(
            f"{DATA_FILE}: {mutant.name}: old: {mutant.old!r} is {text.count(mutant.old)} times"
            f" in {mutant.place}"
        )
    path.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *mutant.tests],
            cwd=copy,
            env={**os.environ, **_paths(copy)},
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        path.write_text(text, encoding="utf-8")
    if done.returncode == 0:
        return ()
    failed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("FAILED ")]
    return tuple(failed[:1]) or ("refused on loading",)


def _paths(copy: Path) -> Mapping[str, str]:
    return {"PYTHONPATH": os.pathsep.join(str(copy / part) for part in ("", "hil_tests", "tools"))}


def _tried(mutants: Sequence[DataMutant], root: Path) -> Iterator[tuple[DataMutant, str]]:
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in COPIED:
            source = root / name
            if source.is_dir():
                shutil.copytree(source, copy / name, ignore=NOT_COPIED)
            else:
                shutil.copy(source, copy / name)
        for mutant in mutants:
            found = file_notices(mutant, copy) if mutant.side == "file" else ride_notices(mutant)
            yield mutant, ", ".join(found)


def main(argv: Sequence[str] | None = None) -> int:
    """0 when each wrong number is noticed and the right ones are not, else 1; 2 for a bad list."""
    parser = argparse.ArgumentParser(prog="data mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="default: all")
    parser.add_argument("--root", type=Path, default=Path.cwd(), help="the checkout")
    options = parser.parse_args(argv)
    missed = 0
    try:
        mutants = [
            mutant
            for mutant in read_mutants(options.root)
            if not options.names or mutant.name in options.names
        ]
        false_alarms = ride_notices(None)
        if false_alarms:
            print(f"without a mutant: {', '.join(false_alarms)}", file=sys.stderr)
            return EXIT_SURVIVORS
        for mutant, by in _tried(mutants, options.root):
            missed += not by
            print(f"{mutant.name:44} {by or 'NOBODY NOTICES'}", flush=True)
    except (DataMutantError, SettingsError) as error:
        print(f"mutate: {error}", file=sys.stderr)
        return EXIT_USAGE
    print(f"{len(mutants)} data mutants, {len(mutants) - missed} noticed")
    return EXIT_SURVIVORS if missed else EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
