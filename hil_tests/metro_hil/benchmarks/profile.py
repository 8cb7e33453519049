"""Measures where the processor time of a lockstep run goes, by part of the program."""

import cProfile
import pstats
import tempfile
from collections import Counter
from pathlib import Path

from metro_hil.model.mission import plan_journey
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.run_options import parse

ROOMS = (
    ("can_dbc", "codec: encode and decode"),
    ("firmware_py/buses", "bus: arbitration and frame times"),
    ("firmware_py/storage/recorder", "recorder"),
    ("firmware_py/clock/executive", "executive"),
    ("firmware_py/trackdb", "track database"),
    ("firmware_py", "tag line, radio and the rest of the board"),
    ("zenoh_config", "radio messages"),
    ("vobc/ato", "controller: operation"),
    ("vobc/atp", "controller: protection"),
    ("vobc/odometry", "controller: odometry"),
    ("vobc", "controller: wire, log and the rest"),
    ("plant_emulator/wire", "plant: wire"),
    ("plant_emulator", "plant: train and world"),
)
REST = "Python's own library"


def where_the_time_goes() -> list[tuple[str, float]]:
    """Return each part of the program with its share of the time, the largest first.

    A call of a built-in counts for the part that calls it. The profiler's own cost falls on small
    functions, so the shares are a guide and not exact.
    """
    from metro_hil.run.lockstep import run_lockstep

    options = parse(["run", "--lockstep"])
    profiler = cProfile.Profile(builtins=False)
    with tempfile.TemporaryDirectory() as scratch:
        folder = RunFolder(Path(scratch))
        profiler.runcall(run_lockstep, options, plan_journey(options), folder)
    return shares(pstats.Stats(profiler))


def shares(stats: pstats.Stats) -> list[tuple[str, float]]:
    """Add up the own time of all functions by part."""
    spent: Counter[str] = Counter()
    for (file, _, _), row in stats.stats.items():  # type: ignore[attr-defined]
        spent[_room(file)] += row[2]
    total = sum(spent.values())
    return [(room, time / total) for room, time in spent.most_common()]


def _room(file: str) -> str:
    path = file.replace("\\", "/")
    for part, name in ROOMS:
        if f"/{part}/" in path or f"/{part}." in path:
            return name
    if "generated" in path or path.startswith("<"):
        return "codec: encode and decode"
    return REST
