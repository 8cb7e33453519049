"""Topology of the trains' sessions: all through the wayside, all to each other, or some of each."""

import enum
from typing import Final


class Topology(enum.Enum):
    """The value is the word on the command line."""

    STAR = "star"
    """Every train is a client of the wayside."""
    MESH = "mesh"
    """Trains are peers, which speak to each other directly."""
    MIXED = "mixed"
    """Every second train is a peer."""


TOPOLOGIES: Final = tuple(each.value for each in Topology)
HELP: Final = (
    "star: trains are clients of the wayside; mesh: they are peers, which speak to each other "
    "directly; mixed: every second one is; default: star"
)


def is_peer(topology: Topology, train: int) -> bool:
    return topology is Topology.MESH or (topology is Topology.MIXED and train % 2 == 1)
