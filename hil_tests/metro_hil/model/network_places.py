"""Places of the tracks of a network on one axis, for diagrams, train graphs and the supply."""

from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import TrackPlace


class NetworkAxis:
    """Chainage of the whole network: that of its first track, continued over the others."""

    def __init__(self, network: TrackNetwork) -> None:
        self._network, self._ends_m = network, ends_m(network)

    def place_m(self, place: TrackPlace) -> float:
        track = self._network.track(place.track)
        low_m, high_m = (self._ends_m[f"{track.name}.{end}"] for end in ("start", "end"))
        ratio = (place.at_m - track.start_m) / (track.end_m - track.start_m)
        return low_m + ratio * (high_m - low_m)

    def stretch_m(self, track: str) -> tuple[float, float]:
        """Both ends of a track, the lower one first."""
        low_m, high_m = sorted(self._ends_m[f"{track}.{end}"] for end in ("start", "end"))
        return low_m, high_m


def ends_m(network: TrackNetwork) -> dict[str, float]:
    """Place of each track end in the diagram: ends that meet lie at one place, where possible."""
    meets: dict[str, list[str]] = {}
    pairs = [(join.a, join.b) for join in network.joins]
    for switch in network.switches:
        pairs += [(switch.tip, switch.left), (switch.tip, switch.right)]
    for one, other in pairs:
        meets.setdefault(one, []).append(other)
        meets.setdefault(other, []).append(one)
    placed: dict[str, float] = {}
    for first in network.tracks:
        if f"{first.name}.start" not in placed:
            _place(network, first.name, first.start_m, True, meets, placed)
    return placed


def _place(
    network: TrackNetwork,
    name: str,
    at_m: float,
    by_start: bool,
    meets: dict[str, list[str]],
    placed: dict[str, float],
    sign: float = 1.0,
) -> None:
    """Place a track by one of its ends, then all tracks that it leads to."""
    waiting = [(name, at_m, by_start, sign)]
    while waiting:
        name, at_m, by_start, sign = waiting.pop()
        if f"{name}.start" in placed:
            continue
        track = network.track(name)
        # `sign` is the direction in the diagram from the given end to the other one.
        far_m = at_m + sign * (track.end_m - track.start_m)
        near_end, far_end = ("start", "end") if by_start else ("end", "start")
        placed[f"{name}.{near_end}"], placed[f"{name}.{far_end}"] = at_m, far_m
        for end, end_m, outward in ((near_end, at_m, -sign), (far_end, far_m, sign)):
            for other in meets.get(f"{name}.{end}", ()):
                other_name, _, other_end = other.rpartition(".")
                waiting.append((other_name, end_m, other_end == "start", outward))
