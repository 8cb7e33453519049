"""Removes each guard of the protocol in turn; a scenario or some seeds must fail without it.

`NOTICED` names the scenario that fails; `ARGUED` says why no check can fail without the guard.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, Final

from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.generate import unbounded_m
from metro_hil.simulation.protocol_nodes import Guards
from metro_hil.simulation.scenarios.acceptance import SCENARIOS, DirectedScenario
from metro_hil.simulation.scenarios.borders import BORDER_LURES
from metro_hil.simulation.scenarios.deaf_masters import DEAF_LURES
from metro_hil.simulation.scenarios.guards import LURES
from metro_hil.simulation.scenarios.insiders import INSIDER_LURES
from metro_hil.simulation.scenarios.moved_trains import MOVED_LURES
from metro_hil.simulation.scenarios.shadow_trains import HIDDEN_LURES
from metro_hil.simulation.scenarios.terms import TERM_LURES
from metro_hil.simulation.scripted_line import ScriptedLine, UnexpectedError
from vobc.train_to_train.guards import Granted, Latency, Terms

PARTS: Final = ("member", "lease", "master")
ALL_SCENARIOS: Final = {
    each.name: each
    for each in (
        *(*SCENARIOS, *LURES, *TERM_LURES, *DEAF_LURES, *HIDDEN_LURES),
        *(*MOVED_LURES, *BORDER_LURES, *INSIDER_LURES),
    )
}


def effective_authority_m(seen: Latency) -> float:
    """Return the end of the train's authority, without the distance that it still needs to stop."""
    return seen.front_max_m if seen.held_end_m is None else seen.held_end_m


def term_without_tried(terms: Terms) -> int:
    return max(terms.seen, terms.refused) + 1


def whole_lease_ns(granted: Granted) -> int:
    return granted.sent_ns + granted.whole_ns


FORMULAS: Final[Mapping[str, Callable[[Any], Any]]] = {
    "latent_authority_m": effective_authority_m,
    "behind_train_ahead_m": unbounded_m,
    "unused_term": term_without_tried,
    "granted_until_ns": whole_lease_ns,
}
"""Replacements for guards that do not return true or false."""


def _holds(*_: Any) -> bool:
    return True


def mutants() -> Iterator[tuple[str, Guards]]:
    """Yield the name and the changed guards of each mutant.

    The trains' own look ahead is removed from all of them, because it hides what the others do.
    """
    member = replace(Guards().train.member, behind_train_ahead_m=unbounded_m)
    safe = replace(Guards(), train=replace(Guards().train, member=member))
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


def noticed_by(scenario: DirectedScenario, guards: Guards) -> str:
    """Return the error with which the scenario fails under these guards; empty if it passes."""
    try:
        scenario.play(lambda plot: ScriptedLine(replace(plot, guards=guards)))
    except (ViolationError, UnexpectedError) as error:
        return str(error)
    return ""


NOTICED: Final[Mapping[str, str]] = {
    "member.for_this_incarnation": "unacceptable",
    "member.young_enough": "unacceptable",
    "member.newer_than_held": "unacceptable",
    "member.term_not_old": "late-authority-takeover",
    "member.owner_of_term": "unacceptable",
    "member.term_in_reach": "last-term",
    "member.term_proven": "false-term",
    "member.behind_train_ahead_m": "false-master",
    "member.latent_authority_m": "shortened-at-speed",
    "lease.granted_by_majority": "two-candidates",
    "lease.lease_runs": "shortened-lease",
    "lease.granted_until_ns": "shortened-lease",
    "master.has_promised": "unpromised",
    "master.roster_kept": "uncommitted",
    "master.report_recent": "towed-away",
    "master.track_known": "closed-unknown",
    "master.placed_apart": "master-killed",
    "master.object_confirmed": "stale-status",
    "master.cannot_reach": "late-release",
    "master.sieved": "hidden-train",
    "master.vanished": "removed-in-error",
    "arbiter.term_in_reach": "last-term",
    "arbiter.lease_is_free": "arbiter-restarts",
    "arbiter.waits_after_start": "arbiter-restarts",
    "object.newer_claim": "late-release",
    "object.free_to_lock": "late-claim",
    "memory of arbiter": "term-again",
    "memory of object": "object-restarts",
}
"""The scenario that fails without the guard, by guard."""

ARGUED: Final[Mapping[str, str]] = {
    "master.comes_in_line": (
        "A train received only after the one behind it was admitted is kept clear of it, and "
        "gets its place once the authority of that one has been shortened (out-of-line)."
    ),
    "lease.unused_term": (
        "A candidate goes on under one term until an arbiter answers, and the answer names a term. "
        "Only the same train repeats it, before it has ever commanded under it, and an arbiter "
        "takes the requests of a train in their order (reused-term)."
    ),
    "lease.answers_this_attempt": (
        "Votes are counted by nonce all the same, so that no two attempts make a majority "
        "together; what one late grant lets a train believe of its lease, no arbiter "
        "confirms by keeping its roster, and without that nothing is issued."
    ),
    "memory of train": (
        "A restarted train gets no authority before its roster entry is committed by a "
        "majority of arbiters, which store nothing under a lower term than they acknowledged."
    ),
    "master.report_alive": (
        "An authority echoes the report that it answers. One that answers an old report "
        "is too old when it comes (member.young_enough)."
    ),
    "master.cleared_after": (
        "A track status is no older than an authority may be, and a non-communicating train is "
        "one that was not received for half of that. In the other half no train runs its own "
        "length, which is what the sections behind it would have to miss."
    ),
    "arbiter.term_is_new": (
        "A train asks for a term above all that it received, tried or was refused. If it knows "
        "none, the other trains still obey only a newer term or the owner of a known one."
    ),
    "arbiter.by_holder": (
        "A renewal or a release under a term names its holder; another train would have "
        "to ask under a term that it was never granted."
    ),
    "object.term_not_old": ("object.newer_claim orders claims by term first."),
    "object.owner_of_term": (
        "Terms have one owner each (arbiter.term_is_new); the envelope's code keeps out "
        "senders that pretend to be the owner."
    ),
    "object.no_train_in_it": (
        "This is the interlocking's own last check. Masters release only what no train of the "
        "roster can reach (master.cannot_reach), and no train is within what no train can "
        "reach."
    ),
}
"""Why no check can fail without the guard, by guard: another guard stands behind it."""
