"""Writes docs/design/train_to_train.md: the text of the protocol with tables generated from the
code.
"""

import dataclasses
import inspect
import sys
from collections.abc import Iterator, Sequence
from importlib import resources
from typing import Any, Final

from metro_tools.generated_doc import markdown_table, write_or_check
from metro_tools.table_doc import machine, said, words
from plant_emulator.wayside.arbiter import ArbiterGuards
from plant_emulator.wayside.line_object import ObjectGuards
from vobc.train_to_train import planned_switch
from vobc.train_to_train.guards import LeaseGuards, MasterGuards, MemberGuards
from vobc.train_to_train.paper_literal import RULES
from vobc.train_to_train.roles import ROLES, STATES
from vobc.train_to_train.vocabulary import Role
from zenoh_config.t2t_codec import TYPE_NUMBERS, body_fields
from zenoh_config.t2t_keys import CHUNKS
from zenoh_config.t2t_types import T2T_TYPES
from zenoh_config.timers import TIMER_SETS

DEFAULT_PATH: Final = "docs/design/train_to_train.md"

TEMPLATE: Final = "train_to_train.md"
"""The text beside this module, with a placeholder for each table."""


def document() -> str:
    """Return the text with the tables filled in."""
    text = (resources.files("metro_tools") / TEMPLATE).read_text(encoding="utf-8")
    tables = {
        "messages": markdown_table(("type", "message", "key", "body"), _messages()),
        "roles": "\n".join(machine(ROLES, Role.OUTSIDE)),
        "states": markdown_table(("when", "state"), [(words(g), s.name) for g, s in STATES]),
        "switch": "\n".join(machine(planned_switch.TRANSITIONS, planned_switch.SwitchState.IDLE)),
        "guards": markdown_table(("of", "guard", "holds when"), _guards()),
        "literal": markdown_table(("rules", "guards taken away"), _literal()),
        "timers": markdown_table(("time", *TIMER_SETS), _timers()),
    }
    for name, table in tables.items():
        assert text.count(f"{{{name}}}\n") == 1, name
        text = text.replace(f"{{{name}}}\n", table)
    return text


def _messages() -> Iterator[Sequence[str]]:
    for kind in T2T_TYPES:
        fields = ", ".join(body_fields(kind))
        meaning = " ".join((inspect.getdoc(kind) or "").split())
        yield str(TYPE_NUMBERS[kind]), f"{kind.__name__}: {meaning}", CHUNKS[kind], fields


def _guards() -> Iterator[Sequence[str]]:
    for of, guards in (
        ("member", MemberGuards()),
        ("candidate, lease", LeaseGuards()),
        ("master", MasterGuards()),
        ("arbiter", ArbiterGuards()),
        ("object", ObjectGuards()),
    ):
        for each in dataclasses.fields(guards):
            guard: Any = getattr(guards, each.name)
            meaning = said(guard) if inspect.isfunction(guard) else ""
            yield of, each.name.replace("_", " "), meaning or "as its name says"


def _literal() -> Iterator[Sequence[str]]:
    safe = RULES["safe"]
    for name, rules in RULES.items():
        gone = [
            guard.name.replace("_", " ")
            for part in ("member", "lease", "master")
            for guard in dataclasses.fields(getattr(rules, part))
            if getattr(getattr(rules, part), guard.name)
            is not getattr(getattr(safe, part), guard.name)
        ]
        yield name, ", ".join(gone) or "–"


def _timers() -> Iterator[Sequence[str]]:
    for each in dataclasses.fields(next(iter(TIMER_SETS.values()))):
        yield each.name, *[str(getattr(timers, each.name)) for timers in TIMER_SETS.values()]


def main(argv: Sequence[str] | None = None) -> int:
    """Write the document, or with --check only report whether it is current."""
    return write_or_check(
        argv,
        module="metro_tools.t2t_doc",
        description=__doc__,
        default_path=DEFAULT_PATH,
        document=document,
    )


if __name__ == "__main__":
    sys.exit(main())
