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
COLUMNS: Final = (2, 5)
"""Range of the number of columns with platforms: places along the network, each with one or two
tracks."""
THROATS: Final = (1, 2)
"""Range of the number of columns of short tracks without platforms between two such places."""
TRACKS_MAX: Final = 30
SWITCHES_MAX: Final = 15
TRIPS: Final = (2, 3)
PLATFORMS: Final = (2, 2, 3)
"""Numbers of platforms on a route to choose from, unless the network ends before."""
RIGHT_RATIO: Final = 0.7
"""Share of facing switches over which a route goes right. At first, every switch lies left."""
BY_HAND: Final = 2
"""Number of routes that only the signaller sets."""
STEEPEST_PERMILLE: Final = (30.0, 15.0, 0.0)
SPEEDS_MPS: Final = (12.0, 20.0)
"""Range of limits. A train meets faster ones rarely, because of the short tracks."""
PIECE_M: Final = 30.0
"""Least length of a limit or gradient. Shorter ones are left to the other attacks."""
TRIP_S: Final = 25.0
LEG_S: Final = 18.0
"""Time for each track of a route, s. A trip with its stops usually takes less."""
EDGE_M: Final = 40.0
"""Least length of a track beyond both ends of its platform."""
SPARE_M: Final = (0.0, 50.0)
BALISES_M: Final = 90.0
SHORT_M: Final = (60.0, 120.0)
"""Range of the length of a track without a platform."""
NONE: Final = -1
"""Column of a track without a platform."""


@dataclass(slots=True)
class _Plan:
    """The tracks of a network, and what a train finds at their ends."""

    chance: np.random.Generator
    tracks: dict[str, int] = field(default_factory=dict)
    """By name, the column of a track with a platform, or `NONE`."""
    joins: list[Table] = field(default_factory=list)
    switches: list[Table] = field(default_factory=list)
    ahead: dict[str, list[str]] = field(default_factory=dict)
    """By track end, the track ends into which it leads."""
    loop: str = ""

    def track(self, name: str, column: int) -> str:
        self.tracks[name] = column
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

    def onward(self, leg: str) -> list[str]:
        """The legs into which a leg of a route leads."""
        name, running = leg.split()
        found = self.ahead.get(f"{name}.{'end' if running == 'up' else 'start'}", [])
        return [_leg(end) for end in found]

    def pick(self, items: Sequence[Any]) -> Any:
        return items[int(self.chance.integers(0, len(items)))]


def _leg(end: str) -> str:
    """The leg of a route that enters a track at this end."""
    track, _, side = end.rpartition(".")
    return f"{track} {'up' if side == 'start' else 'down'}"


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
    by_hand = [_route(plan, plan.pick(_starts(plan))) for _ in range(BY_HAND)]
    name = f"{LINES}/net{seed}.toml"
    _write_network(folder / name, plan, [*routes, *by_hand], load_config(train))
    service = f"{LINES}/service{seed}.toml"
    trips = [_trip(plan, index, legs) for index, legs in enumerate(routes)]
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
        "fault": [_fault(plan, len(routes) + BY_HAND) for _ in range(int(chance.integers(0, 4)))],
    }


def _trip(plan: _Plan, index: int, legs: Sequence[str]) -> Table:
    """A trip that stops at every platform, or at the last one only."""
    trip: Table = {"route": f"r{index}", "layover_s": round(plan.chance.uniform(0.0, 5.0), 1)}
    if plan.chance.random() < 0.5:
        trip["stops"] = [f"S{plan.tracks[legs[-1].split()[0]]}"]
    return trip


def _plan(chance: np.random.Generator) -> _Plan:
    while True:
        plan = _columns(chance)
        if len(plan.tracks) <= TRACKS_MAX and len(plan.switches) <= SWITCHES_MAX:
            return plan


def _columns(chance: np.random.Generator) -> _Plan:
    """Columns from left to right. Every track runs up towards the right."""
    plan = _Plan(chance)
    ends = [plan.track(f"{side}0", 0) for side in plan.pick(("s", "ew"))]
    number = 0
    for _ in range(1, int(chance.integers(COLUMNS[0], COLUMNS[1] + 1))):
        for _ in range(int(chance.integers(THROATS[0], THROATS[1] + 1))):
            number += 1
            ends = _column(plan, ends, number, platforms=False)
        number += 1
        ends = _column(plan, ends, number, platforms=True)
    if len(ends) == 2 and chance.random() < 0.5:
        plan.loop = plan.track("loop", number + 1)
        plan.join(f"{ends[0]}.end", "loop.start")
        plan.join("loop.end", f"{ends[1]}.end")
    return plan


def _column(plan: _Plan, ends: Sequence[str], number: int, *, platforms: bool) -> list[str]:
    double = plan.chance.random() < 0.6
    column = number if platforms else NONE
    new = [plan.track(f"{side}{number}", column) for side in ("ew" if double else "s")]
    if len(ends) == len(new) == 2 and plan.chance.random() < 0.7:
        short = plan.track(f"x{number}", NONE)
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


def _starts(plan: _Plan) -> list[str]:
    """The first legs that a route may have."""
    return [
        f"{name} {running}"
        for name, column in plan.tracks.items()
        if column != NONE and name != plan.loop
        for running in ("up", "down")
        if plan.onward(f"{name} {running}")
    ]


def _routes(plan: _Plan) -> list[list[str]]:
    """Routes that lead to and fro, each from the track where the one before ends."""
    leg = plan.pick(_starts(plan))
    routes: list[list[str]] = []
    for _ in range(int(plan.chance.integers(TRIPS[0], TRIPS[1] + 1))):
        routes.append(_route(plan, leg))
        name, running = routes[-1][-1].split()
        same = name == plan.loop
        leg = f"{name} {running}" if same else f"{name} {'down' if running == 'up' else 'up'}"
    return routes


def _route(plan: _Plan, leg: str) -> list[str]:
    """A route over some platforms, or to the end of the network."""
    legs, platforms = [leg], 1
    most = plan.pick(PLATFORMS)
    while platforms < most and (onward := plan.onward(legs[-1])):
        legs.append(onward[-1] if plan.chance.random() < RIGHT_RATIO else onward[0])
        name = legs[-1].split()[0]
        platforms += plan.tracks[name] != NONE
        # The loop ends a route, as its stop is there; the next one leads on from it.
        if name == plan.loop:
            break
    return legs


def _write_network(
    path: Path, plan: _Plan, routes: Sequence[Sequence[str]], config: VobcConfig
) -> None:
    """Write a network whose steepest gradient fits the train."""
    numbers = iter(range(1, 100_000))
    tracks = [
        _track(plan.chance, name, column, config.train.length_m, numbers)
        for name, column in plan.tracks.items()
    ]
    used = set(plan.ahead)
    buffers = [
        f"{name}.{end}"
        for name in plan.tracks
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
    """A track with a platform, or a short one without."""
    if column == NONE:
        end_m = float(round(chance.uniform(*SHORT_M)))
        limit_mps = round(float(chance.uniform(*SPEEDS_MPS)), 3)
        return {
            "name": name,
            "start_m": 0.0,
            "end_m": end_m,
            "limits": [{"start_m": 0.0, "end_m": end_m, "limit_mps": limit_mps}],
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
            for at_m, to_m, value in pieces(chance, start_m, end_m, SPEEDS_MPS, least_m=PIECE_M)
        ],
        "grades": pieces(chance, start_m, end_m, (-1.0, 1.0), least_m=PIECE_M),
        "platforms": [
            {
                "station": station,
                "start_m": first_m,
                "end_m": last_m,
                "stop_up_m": stops_m["up"],
                "stop_down_m": stops_m["down"],
                "side": "none" if siding else "right",
                "dwell_s": 0.0 if siding else 3.0,
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
        "start_s": round(float(chance.uniform(0.0, 30.0)), 1),
        "duration_s": round(float(np.exp(chance.uniform(np.log(1.0), np.log(20.0)))), 1),
    }
    if not plan.switches:
        return {"kind": "authority_withdrawn", **window}
    if chance.random() < 0.5:
        return {"kind": "route_set", "route": f"r{chance.integers(0, routes)}", **window}
    kind = plan.pick(("switch_lost", "switch_stray", "switch_stuck"))
    return {"kind": kind, "switch": plan.pick(plan.switches)["name"], **window}
