"""Networks by chance with routes and a service, and faults of their switches by chance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w

from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import load_line
from metro_hil.attack.runs import (
    LIMITS_MPS,
    LINES,
    ROLLBACK_M,
    STOP_TAGS,
    TRAINS,
    VACUOUS,
    Table,
    pieces,
)
from vobc.config import VobcConfig, load_config
from vobc.plausible import implausible

FILE: Final = "networks.toml"
COLUMNS: Final = (2, 7)
"""Range of the number of columns: places along the network, each with one or two tracks."""
TRIPS: Final = (2, 4)
STEEPEST_PERMILLE: Final = (30.0, 15.0, 0.0)
TRIP_S: Final = 60.0
LEG_S: Final = 75.0
"""Time for each track of a route, s. A trip with its stops usually takes less."""
EDGE_M: Final = 60.0
"""Least length of a track beyond both ends of its platform."""
SPARE_M: Final = (0.0, 250.0)
BALISES_M: Final = 90.0
CROSSOVER_M: Final = 60.0


@dataclass(slots=True)
class _Plan:
    """The tracks of a network, and what a train finds at their ends."""

    chance: np.random.Generator
    tracks: list[tuple[str, int]] = field(default_factory=list)
    """Names with their columns; a crossover has none, -1."""
    joins: list[Table] = field(default_factory=list)
    switches: list[Table] = field(default_factory=list)
    ahead: dict[str, list[str]] = field(default_factory=dict)
    """By track end, the track ends into which it leads."""
    loop: str = ""

    def track(self, name: str, column: int) -> str:
        self.tracks.append((name, column))
        return name

    def join(self, one: str, other: str) -> None:
        self.joins.append({"a": one, "b": other})
        self._lead(one, other)

    def switch(self, tip: str, left: str, right: str) -> None:
        name = f"W{len(self.switches) + 1}"
        self.switches.append({"name": name, "tip": tip, "left": left, "right": right})
        self._lead(tip, left)
        self._lead(tip, right)

    def _lead(self, one: str, other: str) -> None:
        self.ahead.setdefault(one, []).append(other)
        self.ahead.setdefault(other, []).append(one)

    def pick(self, items: Sequence[Any]) -> Any:
        return items[int(self.chance.integers(0, len(items)))]


def write_networks(folder: Path, seed: int, count: int) -> Path:
    """Write so many networks with their services, and a campaign file. Raises OSError.

    Network K of a seed S is the first one of the seed S + K.
    """
    (folder / LINES).mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    document = {
        "title": "Services over networks by chance, with faults of switches",
        "vacuous": {"allowed": ["faults", "requirements"], "reason": VACUOUS},
        "scenario": [_scenario(folder, each) for each in range(seed, seed + count)],
    }
    write_whole(path, tomli_w.dumps(document))
    return path


def _scenario(folder: Path, seed: int) -> Table:
    chance = np.random.default_rng([seed, 51])
    train = TRAINS[int(chance.integers(0, len(TRAINS)))]
    plan = _plan(chance)
    routes = _routes(plan)
    name = f"{LINES}/net{seed}.toml"
    _write_network(folder / name, plan, routes, load_config(train))
    service = f"{LINES}/service{seed}.toml"
    trips = [
        {"route": f"r{index}", "layover_s": round(float(chance.uniform(0.0, 20.0)), 1)}
        for index in range(len(routes))
    ]
    write_whole(folder / service, tomli_w.dumps({"line": f"net{seed}.toml", "trips": trips}))
    return {
        "name": f"network-{seed}",
        "seed_base": seed,
        "train": {
            "service": service,
            "consist": train,
            "params": train,
            "load_ratio": round(float(chance.uniform(0.0, 1.0)), 3),
            "duration_s": sum(TRIP_S + LEG_S * len(legs) for legs in routes),
        },
        "fault": [_fault(plan, len(routes)) for _ in range(int(chance.integers(0, 3)))],
    }


def _plan(chance: np.random.Generator) -> _Plan:
    """Columns from left to right. Every track runs up towards the right."""
    plan = _Plan(chance)
    count = int(chance.integers(COLUMNS[0], COLUMNS[1] + 1))
    ends = [plan.track(f"{side}0", 0) for side in plan.pick(("s", "ew"))]
    for column in range(1, count):
        ends = _column(plan, ends, column)
    if len(ends) == 2 and chance.random() < 0.5:
        plan.loop = plan.track("loop", count)
        plan.join(f"{ends[0]}.end", "loop.start")
        plan.join("loop.end", f"{ends[1]}.end")
    return plan


def _column(plan: _Plan, ends: Sequence[str], column: int) -> list[str]:
    double = plan.chance.random() < 0.6
    new = [plan.track(f"{side}{column}", column) for side in ("ew" if double else "s")]
    if len(ends) == len(new) == 2 and plan.chance.random() < 0.5:
        short = plan.track(f"x{column}", -1)
        (one, other), (one_on, other_on) = ends, new
        plan.switch(f"{one}.end", f"{one_on}.start", f"{short}.start")
        plan.switch(f"{other_on}.start", f"{other}.end", f"{short}.end")
    elif len(ends) == len(new):
        for end, start in zip(ends, new, strict=True):
            plan.join(f"{end}.end", f"{start}.start")
    elif double:
        plan.switch(f"{ends[0]}.end", f"{new[1]}.start", f"{new[0]}.start")
    else:
        plan.switch(f"{new[0]}.start", f"{ends[0]}.end", f"{ends[1]}.end")
    return new


def _routes(plan: _Plan) -> list[list[str]]:
    """Routes that lead to and fro, each from the track where the one before ends."""
    first = plan.pick([name for name, column in plan.tracks if column == 0])
    leg = f"{first} up"
    routes = []
    for _ in range(int(plan.chance.integers(TRIPS[0], TRIPS[1] + 1))):
        legs = [leg]
        # The loop ends a route, as its stop is there; the next one leads on from it.
        while len(legs) == 1 or legs[-1].split()[0] != plan.loop:
            name, running = legs[-1].split()
            onward = plan.ahead.get(f"{name}.{'end' if running == 'up' else 'start'}", [])
            if not onward:
                break
            track, _, end = str(plan.pick(onward)).rpartition(".")
            legs.append(f"{track} {'up' if end == 'start' else 'down'}")
        routes.append(legs)
        name, running = legs[-1].split()
        same = name == plan.loop
        leg = f"{name} {running}" if same else f"{name} {'down' if running == 'up' else 'up'}"
    return routes


def _write_network(
    path: Path, plan: _Plan, routes: Sequence[Sequence[str]], config: VobcConfig
) -> None:
    """Write a network whose steepest gradient fits the train."""
    numbers = iter(range(1, 100_000))
    tracks = [
        _track(plan.chance, name, column, config.train.length_m, numbers)
        for name, column in plan.tracks
    ]
    used = set(plan.ahead)
    buffers = [
        f"{name}.{end}"
        for name, _ in plan.tracks
        for end in ("start", "end")
        if f"{name}.{end}" not in used
    ]
    for steepest_permille in STEEPEST_PERMILLE:
        document = {
            "name": path.stem,
            "description": "By chance, for an attack",
            "rollback_m": ROLLBACK_M,
            "buffer_stops": buffers,
            "joins": plan.joins,
            "switches": plan.switches,
            "routes": [{"name": f"r{i}", "legs": list(legs)} for i, legs in enumerate(routes)],
            "tracks": [_with_gradients(track, steepest_permille) for track in tracks],
        }
        write_whole(path, tomli_w.dumps(document))
        lines = [load_line(f"{path}:r{index}") for index in range(len(routes))]
        if not any(implausible(config, line) for line in lines):
            return
    raise AssertionError(f"{path}: a level network does not fit the train")


def _track(
    chance: np.random.Generator, name: str, column: int, length_m: float, numbers: Any
) -> Table:
    """A track with a platform, or a short crossover without one."""
    if column < 0:
        return {
            "name": name,
            "start_m": 0.0,
            "end_m": CROSSOVER_M,
            "limits": [{"start_m": 0.0, "end_m": CROSSOVER_M, "limit_mps": LIMITS_MPS[0]}],
            "grades": [],
        }
    start_m = float(round(chance.uniform(-400.0, 1000.0)))
    first_m = start_m + EDGE_M
    last_m = first_m + round(length_m + 15.0)
    end_m = last_m + EDGE_M + float(round(chance.uniform(*SPARE_M)))
    station = f"S{column}"
    siding = name == "loop" or chance.random() < 0.2
    stops_m = {"up": last_m - 5.0, "down": first_m + 5.0}
    return {
        "name": name,
        "start_m": start_m,
        "end_m": end_m,
        "limits": [
            {"start_m": at_m, "end_m": to_m, "limit_mps": value}
            for at_m, to_m, value in pieces(chance, start_m, end_m, LIMITS_MPS)
        ],
        "grades": pieces(chance, start_m, end_m, (-1.0, 1.0)),
        "platforms": [
            {
                "station": station,
                "start_m": first_m,
                "end_m": last_m,
                "stop_up_m": stops_m["up"],
                "stop_down_m": stops_m["down"],
                "side": "none" if siding else "right",
                "dwell_s": 0.0 if siding else 5.0,
            }
        ],
        "tags": _tags(start_m, end_m, stops_m, station, numbers),
    }


def _tags(
    start_m: float, end_m: float, stops_m: Mapping[str, float], station: str, numbers: Any
) -> list[Table]:
    """Balises and the stop tags of both directions, a metre apart at least."""
    found: dict[float, Table] = {}
    for direction, stop_m in stops_m.items():
        for kind, before_m in STOP_TAGS:
            at_m = round(stop_m - before_m if direction == "up" else stop_m + before_m, 1)
            if start_m < at_m < end_m and _is_free(found, at_m):
                found[at_m] = {"kind": kind, "station": station, "direction": direction}
    count = max(2, round((end_m - start_m) / BALISES_M))
    for index in range(count):
        at_m = round(start_m + (end_m - start_m) * (index + 0.5) / count, 1)
        if _is_free(found, at_m):
            found[at_m] = {}
    return [{"tag_id": next(numbers), "position_m": at_m, **found[at_m]} for at_m in sorted(found)]


def _is_free(found: Mapping[float, Table], at_m: float) -> bool:
    return all(abs(each - at_m) >= 1.0 for each in found)


def _with_gradients(track: Table, steepest_permille: float) -> Table:
    shown = {key: value for key, value in track.items() if key != "grades"}
    shown["gradients"] = [
        {
            "start_m": at_m,
            "end_m": to_m,
            "gradient_permille": round(steepest_permille * value, 2),
        }
        for at_m, to_m, value in track["grades"]
    ]
    return shown


def _fault(plan: _Plan, routes: int) -> Table:
    """A fault of a switch at a place or a time, or a route that is set by hand."""
    chance = plan.chance
    window: Table = {
        "start_s": round(float(chance.uniform(0.0, 60.0)), 1),
        "duration_s": round(float(np.exp(chance.uniform(np.log(1.0), np.log(60.0)))), 1),
    }
    if not plan.switches:
        return {"kind": "authority_withdrawn", **window}
    if chance.random() < 0.3:
        return {"kind": "route_set", "route": f"r{chance.integers(0, routes)}", **window}
    kind = plan.pick(("switch_lost", "switch_stray", "switch_stuck"))
    return {"kind": kind, "switch": plan.pick(plan.switches)["name"], **window}
