"""Writes docs/reference/faults.md from the catalogue of faults, or checks that it is current."""

import sys
from collections.abc import Iterator, Sequence
from typing import Final

from metro_tools.generated_doc import markdown_table, write_or_check
from plant_emulator.faults.described import (
    BY_KIND,
    BY_PLACE,
    PLACE_TITLES,
    Described,
    FaultParameter,
    all_described,
)
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.truth import SIGNALS

DEFAULT_PATH: Final = "docs/reference/faults.md"

HEADER: Final = """\
# Faults

Generated from the declarations in `plant_emulator/faults/` by `python -m metro_tools.fault_doc`;
change those and generate it anew. `hil faults` shows the same in the terminal.

A fault is a table of a scenario file: its kind, when it acts, and its parameters. What is left out
takes its default.

```toml
[[fault]]                       # a tacho slips for 8 s
kind = "wheel_slip"
start_s = 30.0
duration_s = 8.0
slip_ratio = 0.3

[[fault]]                       # traction runs away once the train is fast
kind = "traction_runaway"
when = "speed_mps > 16.6"
accel_mps2 = 1.0

[[fault]]                       # brake commands arrive late as long as the train brakes, every time
kind = "frame_delay"
frames = "BRAKE_CMD*"
way = "to_train"
delay_s = 0.04
when = "accel_mps2 < -0.3"
until = "speed_mps == 0"
repeat = true

[[fault]]                       # the same share of telegrams is torn whatever the seed of the case
kind = "telegram_torn"
share_ratio = 0.5
seed = 7
```

## When a fault acts

| key | meaning |
| --- | --- |
| `start_s` | not before this, in seconds of the run; default 0 |
| `when` | and not before this holds, an expression over the truth of the plant |
| `end_s` | until this instant of the run |
| `duration_s` | until so long after it began |
| `until` | until this holds |
| `repeat` | whether it may begin again after it has ended; default false |
| `seed` | of its own draws; else they come from the case's seed and its place in the file |

The first end that comes counts; without any the fault acts to the end of the run. Begin and end are
looked for in each step of the plant, every 10 ms. A fault that never begins makes the case
blocked, not passed. Faults that act at once are applied in the order of the file, and each draws
from a generator of its own, so that one more changes nothing in what the others draw.

Expressions know {signals}.
A train that stands at its first station has `to_stop_m` 0: what shall begin on the way to the next
one is better said with `front_m`.

`frames` names messages of the [CAN interface](can_interface.md), with `*` and `?` as in a shell; a
twin has a name of its own, so `BRAKE_CMD*` means both halves. A name that matches nothing is
refused when the file is checked. `way` is seen from the controller.
"""

NOTES: Final = """\
## How errors on the bus are modelled

In virtual time each node has the error counters of ISO 11898-1. A destroyed frame costs its bits up
to the error, the superposed error flags (6 to 12 bits, by what the receivers see of the stuffing),
8 bits of delimiter and 3 of intermission; then it is arbitrated for again. Its sender's counter
rises by 8, every receiver's by 1, and each good frame takes 1 back. From 128 on a node is passive:
its flags are recessive, and it waits 8 bits more after a frame of its own. From 256 on it is off,
drops what it had to say, and comes back after 128 times 11 recessive bits, 5.6 ms on an idle bus.
So one node's frames, when more than one in nine is destroyed, take it off the bus in the end; when
the fault ends it comes back.

What a node says while it is off or cut off is lost; nothing old is said when it is back.

`after_crc` leaves no frame that the codec would accept, if the message has a CRC at all;
`before_crc` leaves counter, CRC and twin right and signals wrong, each within its range.
"""


def document() -> str:
    """The whole catalogue."""
    signals = ", ".join(f"`{name}`" for name in SIGNALS)
    parts = [HEADER.format(signals=signals), _benches(), _overview()]
    for place in FaultPlace:
        parts += [f"## {PLACE_TITLES[place]}\n", *_kinds(place)]
    return "\n".join([*parts, NOTES])


def _benches() -> str:
    rows = [
        (
            PLACE_TITLES[place],
            BY_PLACE[place].lockstep,
            BY_PLACE[place].processes,
            BY_PLACE[place].hardware,
        )
        for place in FaultPlace
    ]
    rows += [
        (f"`{name}`", each.lockstep, each.processes, each.hardware)
        for name, each in BY_KIND.items()
    ]
    return "## Who brings it about\n\n" + markdown_table(
        ("fault", "lockstep", "processes", "hardware"), rows
    )


def _overview() -> str:
    rows = [
        (f"[`{each.name}`](#{each.name})", PLACE_TITLES[each.place], "; ".join(each.hazards))
        for each in all_described()
    ]
    return "## Kinds\n\n" + markdown_table(("kind", "place", "what may come of it"), rows)


def _kinds(place: FaultPlace) -> Iterator[str]:
    for each in all_described():
        if each.place is place:
            yield _kind(each)


def _kind(each: Described) -> str:
    text = f"### {each.name}\n\n{each.story}\n"
    if not each.parameters:
        return text
    heads = ("parameter", "value", "unit", "default", "range", "meaning")
    return f"{text}\n{markdown_table(heads, map(_row, each.parameters))}"


def _row(parameter: FaultParameter) -> tuple[str, ...]:
    default = f"`{parameter.default}`" if parameter.kind == "text" else parameter.default
    return (
        f"`{parameter.name}`",
        parameter.kind,
        parameter.unit,
        default,
        parameter.range,
        parameter.story,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Write the document, or with --check only say whether it is current."""
    return write_or_check(
        argv,
        module="metro_tools.fault_doc",
        description=__doc__,
        default_path=DEFAULT_PATH,
        document=document,
    )


if __name__ == "__main__":
    sys.exit(main())
