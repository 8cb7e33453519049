"""Reads networks, and makes the paths of their routes."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from firmware_py.settings import SettingsError, build, nearest
from firmware_py.trackdb.network import Running, TrackNetwork
from firmware_py.trackdb.paths import Path, make_path

TRACKS: Final = "tracks"
"""Key that a network file has and a line file has not."""


def is_network(table: Mapping[str, Any]) -> bool:
    """Whether the table of a file is that of a network."""
    return TRACKS in table


def read_network(table: Mapping[str, Any], source: str) -> TrackNetwork:
    """The network of a file; every route is tried. Raises SettingsError."""
    network = build(TrackNetwork, table, source)
    for route in network.routes:
        route_path(network, route.name, source)
    return network


def route_path(network: TrackNetwork, name: str | None, source: str) -> Path:
    """The path of a route. Raises SettingsError."""
    names = [route.name for route in network.routes]
    if not names:
        raise SettingsError(f"{source}: routes: there is none; add [[routes]] to run a train")
    if name is None:
        raise SettingsError(
            f"{source}: is a network; name one of its routes, such as {source}:{names[0]}; it has "
            f"{', '.join(names)}"
        )
    if name not in names:
        raise SettingsError(f"{source}: route {name!r}: {nearest(name, names, 'route')}")
    legs = network.routes[names.index(name)].legs
    try:
        return make_path(network, f"{network.name}-{name}", _way(legs))
    except ValueError as error:
        raise SettingsError(f"{source}: routes[{names.index(name)}]: {name}: {error}") from error


def _way(legs: Sequence[str]) -> list[tuple[str, Running]]:
    way = []
    for leg in legs:
        track, _, direction = leg.partition(" ")
        try:
            way.append((track, Running(direction)))
        except ValueError:
            raise ValueError(
                f"legs: {leg!r}: write the track and up or down, such as '{track or 'main'} up'"
            ) from None
    return way
