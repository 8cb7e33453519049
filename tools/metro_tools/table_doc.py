"""Writes docs/reference/supervision.md from the tables that protection and operation decide by."""

import enum
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from can_dbc.vobc import AtoPhase, Inhibit, Missing, OperatingMode, Supervision
from metro_tools.generated_doc import markdown_table, write_or_check
from vobc.ato import mode as ato_phases
from vobc.atp import alarms, departure, doors, emergencies, jog, modes, supervision
from vobc.atp.alarms import AlarmResponse
from vobc.atp.emergencies import EmergencyRule, Reset

DEFAULT_PATH: Final = "docs/reference/supervision.md"

Table = Mapping[Any, Sequence[tuple[Callable[[Any], bool], Any]]]

HEADER: Final = """\
# Supervision

Drawn by `python -m metro_tools.table_doc` from the tables in `vobc/atp/` and `vobc/ato/` that the
controller decides by: what stands here is what runs. A table is read from the top; the first guard
that holds decides, and when none holds the state stays. A guard's name is that of the function that
holds it.

Each cycle goes through them once: stations and alarms, operating mode, emergencies, supervision,
and after protection the phase of the operation. What is no number makes a guard decide for the
brake.
"""

MODES: Final = """\
## Operating modes

Which kind of movement is supervised (`vobc/atp/modes.py`). Modes change at rest, but for one way
up: full supervision takes over from driving on sight once place and a fresh authority are there and
the speed is well below what is then permitted. No full supervision begins on an authority that is
old enough to ask for the service brake.
"""

NEEDED: Final = """\
Without these a movement neither begins nor, once the train stands, goes on:
"""

UNHEEDED: Final = """\
These keep a train from departing, but not from moving in the mode:
"""

SUPERVISION: Final = """\
## Supervision

What protection does about the movement (`vobc/atp/supervision.py`). NO_AUTHORITY and EMERGENCY
apply the emergency brake, SERVICE the full service brake; traction is cut in all three.
"""

EMERGENCIES: Final = """\
## Emergencies

Why the emergency brake comes and who may release it (`vobc/atp/emergencies.py`). Every cause that
comes is kept until its own release: the train stands, somebody who may has reset it in that very
cycle, and, of a cause that is always looked for, it is gone. The brake is released when no cause is
left. A reset at the desk is a key newly pressed, one by the centre a step up of its count.
"""

ALARMS: Final = """\
## Alarms and lost door locks

By where the train is and whether it is leaving a platform (`vobc/atp/alarms.py`).
"""

TERMS: Final = """\
## Doors and departure

Every term has to be true by itself (`vobc/atp/doors.py`, `vobc/atp/departure.py`); what is said of
one that is not stands beside it.
"""

JOG: Final = """\
## Missed stops

What becomes of a stopping point that was missed (`vobc/atp/jog.py`).
"""

PHASES: Final = """\
## Phases of the operation

What the automatic operation does within all that (`vobc/ato/mode.py`).
"""


def document() -> str:
    """All tables, as diagrams and in words."""
    return "\n".join(
        [
            HEADER,
            MODES,
            *machine(modes.TRANSITIONS, OperatingMode.STANDBY),
            NEEDED,
            markdown_table(("mode", "needs"), _flag_rows(modes.NEEDED, Missing)),
            UNHEEDED,
            markdown_table(("mode", "not heeded"), _flag_rows(modes.UNHEEDED, Inhibit)),
            SUPERVISION,
            *machine(supervision.TRANSITIONS, Supervision.NO_AUTHORITY),
            EMERGENCIES,
            markdown_table(
                (
                    "cause",
                    "comes when",
                    "looked for",
                    "reset by",
                    "released by itself when",
                    "words",
                ),
                map(_rule_row, emergencies.RULES),
            ),
            ALARMS,
            *_alarm_tables(),
            TERMS,
            _terms("doors are enabled on the platform side", doors.WITHHELD_WITHOUT),
            _terms("departure", departure.INHIBIT_WITHOUT),
            JOG,
            *machine(jog.TRANSITIONS, jog.JogState.NONE),
            PHASES,
            *machine(ato_phases.TRANSITIONS, AtoPhase.OFF),
        ]
    )


def machine(table: Table, first: enum.Enum) -> Iterator[str]:
    """A state diagram, then its rows, then what the guards say of themselves."""
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {first.name}"]
    for state, rows in table.items():
        lines += [f"    {state.name} --> {to.name}: {words(guard)}" for guard, to in rows]
    yield "\n".join([*lines, "```", ""])
    yield markdown_table(
        ("from", "when", "to"),
        [
            (state.name, words(guard), to.name)
            for state, rows in table.items()
            for guard, to in rows
        ],
    )
    guards = dict.fromkeys(guard for rows in table.values() for guard, _ in rows)
    told = [(words(guard), said(guard)) for guard in guards if said(guard)]
    if told:
        yield markdown_table(("guard", "meaning"), told)


def words(guard: Callable[[Any], bool]) -> str:
    return guard.__name__.replace("_", " ")


def said(guard: Callable[[Any], bool]) -> str:
    return " ".join((inspect.getdoc(guard) or "").split())


def _flag_rows(
    table: Mapping[OperatingMode, int], kind: type[enum.IntFlag]
) -> Iterator[tuple[str, str]]:
    for mode, number in table.items():
        yield mode.name, _names(kind(number))


def _names(flags: enum.IntFlag) -> str:
    names = [str(flag.name) for flag in type(flags) if flag and flag in flags]
    return ", ".join(names) or "–"


def _rule_row(rule: EmergencyRule) -> tuple[str, ...]:
    meaning = said(rule.comes)
    comes = words(rule.comes) + (f": {meaning}" if meaning else "")
    by_itself = "–" if rule.by_itself is emergencies.never else words(rule.by_itself)
    who = " or ".join(str(each.name).lower() for each in Reset if each & rule.reset_by)
    return rule.cause.name, comes, rule.when.value, who, by_itself, rule.words


def _alarm_tables() -> Iterator[str]:
    for title, table in (
        ("Passenger alarm", alarms.PASSENGER_ALARM),
        ("Fire", alarms.FIRE),
        ("Door not locked, in motion", alarms.DOOR_UNLOCKED),
    ):
        yield f"### {title}\n"
        yield markdown_table(
            ("where", "leaving", "answer"),
            [
                (place.where.value, "yes" if place.leaving else "no", _answer(answer))
                for place, answer in table.items()
            ],
        )


def _answer(answer: AlarmResponse) -> str:
    parts = [f"emergency brake ({answer.emergency.name})"] if answer.emergency else []
    parts += ["stop now"] if answer.stop_now else []
    parts += ["stop at the next station"] if answer.stop_next else []
    parts += ["stay, doors open"] if answer.stay else []
    return ", ".join(parts) or "go on"


def _terms(of: str, table: Mapping[str, enum.IntFlag]) -> str:
    rows = [(term.replace("_", " "), str(flag.name)) for term, flag in table.items()]
    return f"For {of}:\n\n{markdown_table(('term', 'else'), rows)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Write the document, or with --check only say whether it is current."""
    return write_or_check(
        argv,
        module="metro_tools.table_doc",
        description=__doc__,
        default_path=DEFAULT_PATH,
        document=document,
    )


if __name__ == "__main__":
    sys.exit(main())
