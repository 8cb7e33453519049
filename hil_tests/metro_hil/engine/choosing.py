"""Selects the cases that `hil run` runs from a campaign and the options. Pure."""

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Final

import msgspec

from metro_hil.engine.errors import UsageError
from metro_hil.model.case import BenchKind, Case, ControllerSpec, PlantSpec, WireNames

LOCKSTEP: Final = (None, BenchKind.LOCKSTEP.value)
"""Values of `--bench` that leave cases in virtual time where they are."""
CONTROLLERS: Final = "`shipped`, `checkout:PATH` and `command:WORDS`"


def choose(
    cases: Sequence[Case],
    *,
    pattern: str | None = None,
    limit: int | None = None,
    bench: str | None = None,
    controller: str | None = None,
    plant: PlantSpec | None = None,
    wires: WireNames | None = None,
) -> tuple[Case, ...]:
    """Cases whose id or scenario matches the pattern, with new numbers and the options applied.

    The options `bench`, `controller`, `plant` and `wires` replace what the cases name.
    Raises UsageError when no case is left or an option is wrong.
    """
    chosen = [case for case in cases if pattern is None or _matches(case, pattern)]
    if not chosen:
        example = f", such as {cases[0].id}" if cases else ""
        raise UsageError(f"--filter {pattern}: matches none of the {len(cases)} case ids{example}")
    changes: dict[str, object] = {}
    if bench is not None:
        changes["bench"] = BenchKind(bench)
    if controller is not None:
        changes["controller"] = read_controller(controller)
    if plant is not None:
        changes["plant"] = plant
    if wires is not None and wires != WireNames():
        if all(case.bench is BenchKind.LOCKSTEP for case in chosen) and bench in LOCKSTEP:
            raise UsageError(
                "--bus, --train-bus, --tags, --radio, --plant and --vobc are for the benches in "
                "real time; add --bench processes or --bench hardware"
            )
        changes["wires"] = wires
    cases = [
        msgspec.structs.replace(case, index=index, **changes)
        for index, case in enumerate(chosen[:limit])
    ]
    for case in cases:
        if case.plant.nodes and case.bench is not BenchKind.LOCKSTEP:
            raise UsageError(
                f"--plant nodes: needs the bench lockstep; case {case.id} runs on "
                f"{case.bench.value}"
            )
    return tuple(cases)


def _matches(case: Case, pattern: str) -> bool:
    return fnmatchcase(case.id, pattern) or case.scenario == pattern


def read_controller(text: str) -> ControllerSpec:
    """Parse the value of `--controller`. Raises UsageError."""
    kind, _, rest = text.partition(":")
    if text == "shipped":
        return ControllerSpec()
    if kind == "checkout" and rest:
        return ControllerSpec(kind="checkout", path=rest)
    if kind == "command" and rest:
        return ControllerSpec(kind="command", command=rest)
    raise UsageError(f"--controller {text}: none of {CONTROLLERS}")


def pick_case(cases: Sequence[Case], wanted: str) -> Case:
    """Find a case by id, unique beginning of an id, or index. Raises UsageError."""
    by_id = {case.id: case for case in cases}
    if wanted in by_id:
        return by_id[wanted]
    if re.fullmatch(r"[0-9]+", wanted) and int(wanted) < len(cases):
        return cases[int(wanted)]
    found = [case for case in cases if case.id.startswith(wanted)]
    if len(found) == 1:
        return found[0]
    ids = ", ".join(case.id for case in (found or list(cases))[:5])
    what = f"{len(found)} cases begin like this" if found else "no such case"
    raise UsageError(f"{wanted}: {what}: {ids}{', …' if len(found or cases) > 5 else ''}")
