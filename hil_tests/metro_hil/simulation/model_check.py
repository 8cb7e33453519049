"""Exhaustive search over the protocol's real state machines for a few nodes (`make explore`)."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.assertions import require_assertions
from metro_hil.simulation.batch import cpu_ns
from metro_hil.simulation.generate import FIRST_ARBITER, line_of_areas
from metro_hil.simulation.model_nodes import EXPOSED, EXPOSED_ALL, EXPOSED_DEAF, LineStage, begin
from metro_hil.simulation.protocol_nodes import LineParticipants, ProtocolNodes
from metro_hil.simulation.state_search import Bounds, Explorer, SearchResult
from vobc.train_to_train.vocabulary import T2tConfig

SLOT_NS: Final = 25_000_000
WARM_SLOTS: Final = 200
"""Slots without faults before the search: enough for a master, a standby and all authorities."""
NS_PER_S: Final = 1e9
SKEW_PPM: Final = 2000
"""Clock drift of the trains in opposite directions: the maximum that the timers allow."""


@dataclass(frozen=True, slots=True)
class Model:
    """Nodes, bounds and faults of one search."""

    name: str
    trains: int
    arbiters: int
    warm: bool
    """Whether the search begins from a running line; otherwise from the start of all nodes."""
    slots: int
    faults: int
    everything: bool = False
    """Whether reports and authorities are exposed to faults too, not only election messages."""
    deaf_slots: int = 0
    """Number of slots for which the master receives nothing; its switch messages are exposed,
    too."""


MODELS: Final = (
    Model("small", trains=2, arbiters=1, warm=True, slots=6, faults=1),
    Model("takeover", trains=2, arbiters=1, warm=True, slots=24, faults=1, everything=True),
    Model("start", trains=2, arbiters=1, warm=False, slots=40, faults=1),
    Model("majority", trains=2, arbiters=3, warm=True, slots=16, faults=1, everything=True),
    Model("majority-start", trains=2, arbiters=3, warm=False, slots=40, faults=1),
    Model("two-faults", trains=2, arbiters=1, warm=True, slots=10, faults=2),
    Model("deaf-for-long", trains=2, arbiters=1, warm=True, slots=24, faults=1, deaf_slots=24),
    Model("deaf-for-a-lease", trains=2, arbiters=3, warm=True, slots=20, faults=1, deaf_slots=12),
    Model(
        "deaf-for-two-answers", trains=2, arbiters=1, warm=True, slots=24, faults=1, deaf_slots=6
    ),
)
"""`small` runs with the tests, and `make explore` runs all."""


def search(model: Model) -> SearchResult:
    """Search every schedule within the bounds of the model."""
    line = line_of_areas(1, objects=False)
    arbiters = tuple(range(FIRST_ARBITER, FIRST_ARBITER + model.arbiters))
    config = T2tConfig(arbiters=arbiters)
    fronts_m = {n + 1: 300.0 + 600.0 * n for n in range(model.trains)}
    crew = ProtocolNodes(LineParticipants(line, config, tuple(fronts_m)), 1)
    exposed: tuple[type, ...] = EXPOSED_DEAF if model.deaf_slots else EXPOSED
    if model.everything:
        exposed = EXPOSED_ALL
    stage = LineStage(
        crew,
        fronts_m,
        drifts_ppm={1: SKEW_PPM, 2: -SKEW_PPM},
        exposed=exposed,
    )
    explorer = Explorer(
        Bounds(model.slots, model.faults, SLOT_NS, calm_slots=120),
        {**crew.constants(), **stage.constants()},
    )
    warm_slots = WARM_SLOTS if model.warm else 0
    start = begin(stage, -warm_slots * SLOT_NS)
    warm = explorer.warm_up(start, warm_slots)
    if model.deaf_slots and isinstance(warm.stage, LineStage):
        warm.stage.deafen_master(model.deaf_slots * SLOT_NS)
    return explorer.search(warm)


def main(argv: Sequence[str] | None = None) -> int:
    """Print one line for each model; exit code 1 if a model breaks a rule."""
    require_assertions("python -m metro_hil.simulation.model_check")
    parser = argparse.ArgumentParser(
        prog="python -m metro_hil.simulation.model_check", description=__doc__
    )
    names = [model.name for model in MODELS]
    parser.add_argument("names", nargs="*", metavar="MODEL", help=f"one of {names}; default: all")
    options = parser.parse_args(argv)
    broken = 0
    for model in MODELS:
        if options.names and model.name not in options.names:
            continue
        begun_ns = cpu_ns()
        found = search(model)
        broken += found.broken is not None
        print("\n".join(lines(model, found, (cpu_ns() - begun_ns) / NS_PER_S)), flush=True)
    return 1 if broken else 0


def lines(model: Model, found: SearchResult, cpu_s: float) -> list[str]:
    """Return the result as text."""
    start = "from a running line" if model.warm else "from the start"
    head = (
        f"{model.name}: {model.trains} trains, {model.arbiters} arbiters, {start}, {model.slots} "
        f"slots, up to {model.faults} faults: {found.states} states, {found.schedules} steps, "
        f"{found.ends} ends, {cpu_s:.1f} s"
    )
    if found.broken is None:
        return [f"{head}: nothing broken, all trains get authority again in every end"]
    return [f"{head}: {found.broken}", *(f"  slot {s.slot}: {s.what}" for s in found.story)]


if __name__ == "__main__":
    sys.exit(main())
