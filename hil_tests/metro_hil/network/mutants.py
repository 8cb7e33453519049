"""Every guard of the protocol taken away in turn: a scenario or a few seeds have to notice.

`NOTICED` says by what each is found; `ARGUED` why one cannot be missed by anything that is judged.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, Final

from metro_hil.network.checker import ViolationError
from metro_hil.network.crew import Guards
from metro_hil.network.directed import SCENARIOS, Scenario
from metro_hil.network.lures import LURES
from metro_hil.network.scene import Scene, UnexpectedError
from vobc.t2t.guards import Latency, Terms

PARTS: Final = ("member", "lease", "master")
ALL_SCENARIOS: Final = {each.name: each for each in (*SCENARIOS, *LURES)}


def effective_authority_m(seen: Latency) -> float:
    """What the train is told to keep to, and not what it may still need to stop."""
    return seen.front_max_m if seen.held_end_m is None else seen.held_end_m


def term_without_tried(terms: Terms) -> int:
    return max(terms.seen, terms.refused) + 1


FORMULAS: Final[Mapping[str, Callable[[Any], Any]]] = {
    "latent_authority_m": effective_authority_m,
    "unused_term": term_without_tried,
}
"""What stands in the place of those that are no yes or no."""


def _holds(*_: Any) -> bool:
    return True


def mutants() -> Iterator[tuple[str, Guards]]:
    """Name and guards of each."""
    safe = Guards()
    for part in PARTS:
        guards: Any = getattr(safe.train, part)
        for each in fields(guards):
            changed = replace(guards, **{each.name: FORMULAS.get(each.name, _holds)})
            train: Any = replace(safe.train, **{part: changed})
            yield f"{part}.{each.name}", replace(safe, train=train)
    for each in fields(safe.arbiter):
        value: Any = False if each.name == "waits_after_start" else _holds
        yield (
            f"arbiter.{each.name}",
            replace(safe, arbiter=replace(safe.arbiter, **{each.name: value})),
        )
    for each in fields(safe.thing):
        some: Any = {each.name: _holds}
        yield f"object.{each.name}", replace(safe, thing=replace(safe.thing, **some))
    for who in ("train", "arbiter", "object"):
        yield f"memory of {who}", replace(safe, forget=frozenset({who}))


def noticed_by(scenario: Scenario, guards: Guards) -> str:
    """What a scenario says of these guards; empty: nothing strikes it."""
    try:
        scenario.play(lambda plot: Scene(replace(plot, guards=guards)))
    except (ViolationError, UnexpectedError) as error:
        return str(error)
    return ""
