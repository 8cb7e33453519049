"""`vobc network`: checks, shows and draws the tracks of a network or of a line."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb.circuit import load_line, load_network, with_route
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.sites import TunnelSection
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE
from metro_hil.report.network_diagram import network_svg, zones_of
from vobc.config import load_config
from vobc.plausible import implausible

PROG: Final = "vobc network"
VERBS: Final = {
    "check": "judge the network, and each route with the train's parameters",
    "show": "list tracks, what joins them, and routes",
    "draw": "draw the tracks as a diagram in SVG",
}
DESCRIPTION: Final = (
    "Check, show or draw the tracks of a network. A line is a network of one track."
)
EPILOG: Final = "exit codes: 0 done; 2 wrong usage, or the network or a route does not fit"


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc network`."""
    top = CommandParser(prog=PROG, description=DESCRIPTION, epilog=EPILOG)
    top.add_argument("action", choices=tuple(VERBS), help="; ".join(map(": ".join, VERBS.items())))
    top.add_argument("name", metavar="NAME|FILE", help="network or line")
    top.add_argument(
        "--params", default="florence4", metavar="NAME|FILE", help="for check; default: florence4"
    )
    top.add_argument(
        "--out", metavar="FILE", help="for draw; default: the network's name with .svg"
    )
    return top


def main(argv: Sequence[str]) -> int:
    """Run one of the three actions."""
    options = parser().parse_args(argv)
    try:
        network = load_network(options.name)
        found = _misfits(network, options.name, options.params) if options.action == "check" else []
    except SettingsError as error:
        found = str(error).split("\n")
    for text in found:
        print(f"{PROG}: {text}", file=sys.stderr)
    if found:
        return EXIT_USAGE
    if options.action == "draw":
        path = Path(options.out or f"{network.name}.svg")
        write_whole(path, network_svg(network))
        print(f"wrote {path}")
        return EXIT_OK
    for line in shown(network) if options.action == "show" else _checked(network, options.params):
        print(line)
    return EXIT_OK


def _misfits(network: TrackNetwork, name: str, params: str) -> list[str]:
    config = load_config(params)
    found = []
    for route in network.routes:
        line = load_line(with_route(name, route.name)).for_train(config.train.length_m)
        found += implausible(config, line)
    return list(dict.fromkeys(found))


def _checked(network: TrackNetwork, params: str) -> Iterator[str]:
    yield f"network {network.name}: {_count(network)}"
    for route in network.routes:
        yield f"  route {route.name} fits the parameters {params}"


def _count(network: TrackNetwork) -> str:
    length_km = sum(track.end_m - track.start_m for track in network.tracks) / 1000.0
    return (
        f"tracks: {len(network.tracks)} of {length_km:.2f} km, switches: {len(network.switches)}, "
        f"routes: {len(network.routes)}"
    )


def shown(network: TrackNetwork) -> Iterator[str]:
    """The network as lines of text."""
    yield f"network {network.name}: {_count(network)}"
    for track in network.tracks:
        stations = ", ".join(edge.station for edge in track.platforms)
        at = f": {stations}" if stations else ""
        yield f"  track {track.name}, {track.start_m:g} m to {track.end_m:g} m{at}"
        for kind, zone in zones_of(track):
            name = f" {zone.name}" if zone.name else ""
            ends = f"{zone.start_m:g} m to {zone.end_m:g} m"
            if isinstance(zone, TunnelSection):
                yield f"    {kind}{name}, {ends}, air drag × {zone.drag_ratio:g}"
            else:
                yield f"    {kind}{name}, {ends}, {zone.direction.value}"
    for join in network.joins:
        yield f"  join {join.a} to {join.b}"
    for switch in network.switches:
        legs = f"{switch.left} (left), {switch.right} (right)"
        yield f"  switch {switch.name}: {switch.tip} to {legs}"
    for crossing in network.crossings:
        places = f"{crossing.a} {crossing.a_m:g} m and {crossing.b} {crossing.b_m:g} m"
        yield f"  crossing {crossing.name}: {places}"
    for route in network.routes:
        yield f"  route {route.name}: {', '.join(route.legs)}"
