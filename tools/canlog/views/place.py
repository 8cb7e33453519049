"""Position of the train over time, and the curves of the speed-distance picture."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.damage import LogError
from canlog.frames import Ints
from canlog.reader import Log
from canlog.views.traces import Floats, SignalTrace, trace_names, trace_of

ON_BUS: Final = "VOBC_POSITION.front_m"
TRUE_PLACE: Final = "truth.front_m"
OWN_PLACE: Final = "cycles.front_m"
AHEAD: Final = (
    ("cycles.distance_to_authority_m", "cycles.front_high_m"),
    ("VOBC_TARGET.distance_to_authority_m", ON_BUS),
)
"""Distance to the end of authority, and the position that it counts from."""
FAR_M: Final = 5000.0
"""Distance from which an authority is treated as unlimited."""
CURVES: Final = (
    ("emergency", ("cycles.emergency_mps", "VOBC_MOTION.emergency_mps")),
    ("ceiling", ("cycles.permitted_mps", "VOBC_MOTION.ceiling_mps")),
    ("target", ("cycles.target_mps",)),
    ("estimate", ("cycles.speed_mps", "VOBC_MOTION.speed_mps")),
    ("truth", ("truth.speed_mps",)),
)
"""Role of each curve, and its possible traces; the first available one is taken."""
RUN_CONFIG: Final = "run.toml"
PACKAGE: Final = "metro-vobc-bench"


Pieces = tuple[tuple[float, float, float], ...]
"""Each piece: from, to, and the value between them."""


@dataclass(frozen=True, slots=True, eq=False)
class DistanceCurve:
    """One line of the picture, in order of time."""

    role: str
    name: str
    """Name of the trace."""
    at_ns: Ints
    place_m: Floats
    speed_mps: Floats


@dataclass(frozen=True, slots=True)
class LineFacts:
    """Line and train of a run."""

    limits: Pieces = ()
    """From, to (m), and the line speed between them (m/s)."""
    stations: tuple[tuple[str, float], ...] = ()
    """Name and stopping point (m)."""
    gradients: Pieces = ()
    """From, to (m), and gradient (permille, rising positive)."""
    tags: tuple[tuple[int, float], ...] = ()
    """Number and position (m) of each tag."""
    train_m: float = 0.0
    """Length of the train; 0 if it is unknown."""

    def head(self) -> dict[str, Any]:
        """Return it as the page reads it."""
        return {
            "limits": self.limits,
            "stations": self.stations,
            "gradients": self.gradients,
            "tags": self.tags,
            "train": self.train_m,
        }


@dataclass(frozen=True, slots=True, eq=False)
class JourneyPicture:
    """The picture of speed over distance."""

    curves: tuple[DistanceCurve, ...]
    authority: SignalTrace | None
    """Chainage of the end of authority over time."""
    line: LineFacts


def place_of(log: Log, name: str | None = None) -> SignalTrace:
    """Return the most accurate position over time, or the trace of that name. Raises LogError."""
    if name is not None:
        return trace_of(log, name)
    known = set(trace_names(log))
    for each in (TRUE_PLACE, OWN_PLACE, ON_BUS):
        if each in known:
            return trace_of(log, each)
    raise LogError(f"{log.path}: has no distance; --distance names the signal that has it")


def at_instants(place: SignalTrace, at_ns: Ints, *, hold: bool = False) -> Floats:
    """(n,): the position at each instant, interpolated linearly.

    Args:
        hold: outside of the samples the nearest one holds; otherwise the result is NaN there.
    """
    if not len(place):
        return np.full(len(at_ns), np.nan)
    zero_ns = int(place.at_ns[0])
    known_s = (place.at_ns - zero_ns).astype(np.float64)
    ends = (None, None) if hold else (np.nan, np.nan)
    return np.interp((at_ns - zero_ns).astype(np.float64), known_s, place.values, *ends)


def journey_of(log: Log) -> JourneyPicture | None:
    """Return the speed-distance picture; None for a log without position and speed."""
    known = set(trace_names(log))
    curves = tuple(_curves(log, known))
    if not curves:
        return None
    line = LineFacts() if log.run is None else line_of(log.run.folder)
    return JourneyPicture(curves, _authority(log, known), line)


def _curves(log: Log, known: set[str]) -> Iterator[DistanceCurve]:
    for role, candidates in CURVES:
        name = next((each for each in candidates if each in known), None)
        if name is None:
            continue
        own = f"{name.partition('.')[0]}.front_m"
        place_name = own if own in known else ON_BUS
        if place_name not in known:
            continue
        trace, place = trace_of(log, name), trace_of(log, place_name)
        place_m = at_instants(place, trace.at_ns) if len(place) else np.empty(0)
        there = ~np.isnan(place_m)
        if there.any():
            yield DistanceCurve(role, name, trace.at_ns[there], place_m[there], trace.values[there])


def _authority(log: Log, known: set[str]) -> SignalTrace | None:
    for ahead_name, from_name in AHEAD:
        if ahead_name not in known or from_name not in known:
            continue
        ahead, front = trace_of(log, ahead_name), trace_of(log, from_name)
        if not len(ahead) or not len(front):
            continue
        end_m = at_instants(front, ahead.at_ns) + ahead.values
        there = ~np.isnan(end_m) & (ahead.values < FAR_M)
        if there.any():
            return SignalTrace("authority", "m", ahead.at_ns[there], end_m[there])
    return None


def doubts_of(folder: Path) -> list[str]:
    """Return why a page may show a run differently from what it was; none if all is well."""
    path = folder / RUN_CONFIG
    try:
        told = tomllib.loads(path.read_text(encoding="utf-8"))
        wrote, reads = str(told["versions"][PACKAGE]), metadata.version(PACKAGE)
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        return [f"{path.name} cannot be read, so line and train are unknown: {error}"]
    except (KeyError, TypeError, metadata.PackageNotFoundError):
        return [f"{path.name} does not say which version wrote this run."]
    if wrote == reads:
        return []
    return [
        f"Version {wrote} wrote this run, and this is version {reads}: messages that changed since"
        " then are not decoded as they were sent."
    ]


def line_of(folder: Path) -> LineFacts:
    """Return what the run.toml of a run says of line and train; nothing if it cannot be read."""
    try:
        told = tomllib.loads((folder / RUN_CONFIG).read_text(encoding="utf-8"))
        line = told["line"]
        return LineFacts(
            limits=tuple(
                (s["start_m"], s["end_m"], s["limit_mps"]) for s in line["speed_sections"]
            ),
            stations=tuple(
                (t["station"], t["position_m"]) for t in line["tags"] if t["kind"] == "stop"
            ),
            gradients=tuple(
                (s["start_m"], s["end_m"], s["gradient_permille"])
                for s in line.get("gradients", ())
            ),
            tags=tuple((t["tag_id"], t["position_m"]) for t in line["tags"]),
            train_m=float(sum(car["length_m"] for car in told.get("train", {}).get("cars", ()))),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return LineFacts()
