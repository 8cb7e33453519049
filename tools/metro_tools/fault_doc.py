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
from plant_emulator.truth import REPORTED, SIGNALS

DEFAULT_PATH: Final = "docs/reference/faults.md"

HEADER: Final = """\
# Faults

Generated from the declarations in `plant_emulator/faults/` by `python -m metro_tools.fault_doc`;
change those and generate it again. `hil faults` shows the same in the terminal.

A fault is a table of a scenario file: its kind, its time window, and its parameters. A missing
key has its default.

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

[[fault]]                       # brake commands arrive late while the train brakes, every time
kind = "frame_delay"
frames = "BRAKE_CMD*"
way = "to_train"
delay_s = 0.04
when = "accel_mps2 < -0.3"
until = "speed_mps == 0"
repeat = true

[[fault]]                       # the same telegrams are truncated for any seed of the case
kind = "telegram_torn"
share_ratio = 0.5
seed = 7
```

## When a fault acts

| key | meaning |
| --- | --- |
| `start_s` | earliest begin, in seconds of the run; default 0 |
| `when` | condition that must also hold at the begin, an expression over signals as below |
| `end_s` | end, in seconds of the run |
| `duration_s` | duration from the begin |
| `until` | condition that ends the fault |
| `repeat` | whether the fault may begin again after its end; default false |
| `train` | number of the train of several on which it acts; default: on each |
| `trip` | number of the trip of a service in which it acts; default: in each |
| `seed` | seed of its random numbers; by default the case's seed and its place in the file |

The earliest of these ends counts; without any, the fault acts to the end of the run. The plant
checks begin and end in each step, every 10 ms. A fault that never begins makes the case blocked,
not passed. Concurrent faults are applied in the order of the file. Each has its own random
generator, so an additional fault does not change the random numbers of the others.

Expressions can use {signals}.

They can also use what the controller last reported on the bus, by number or by name in quotes,
such as `supervision == "emergency"`:

{reported}

A train that stands at its first station has `to_stop_m` 0. For a
fault on the way to the next station, use `front_m`.

`frames` names messages of the [CAN interface](can_interface.md), with `*` and `?` as in a shell;
a twin has its own name, so `BRAKE_CMD*` selects both halves. A name without a match is an error
when the file is checked. `way` is the direction as seen from the controller.
"""

NOTES: Final = """\
## How errors on the bus are modelled

In virtual time each node has the error counters of ISO 11898-1. A destroyed frame costs its bits
up to the error, the superposed error flags (6 to 12 bits, by what the receivers see of the
stuffing), 8 bits of delimiter and 3 of intermission; then its sender arbitrates again. Its
sender's counter rises by 8, every receiver's by 1, and each good frame subtracts 1. From 128 on a
node is error passive: its flags are recessive, and it waits 8 more bits after its own frame. From
256 on it is bus off, drops its frames, and returns after 128 times 11 recessive bits, 5.6 ms on
an idle bus. So a node goes bus off in the end when more than one in nine of its frames is
destroyed; it returns when the fault ends.

Frames of a node that is bus off or cut off are lost; it sends no old frames when it returns.

`after_crc` damages frames so that the codec rejects every one, if the message has a CRC;
`before_crc` keeps counter, CRC and twin valid and makes signals wrong, each within its range.
"""


def document() -> str:
    """Return the whole catalogue."""
    signals = ", ".join(f"`{name}`" for name in SIGNALS)
    reported = "\n".join(f"- `{name}`: {', '.join(values)}" for name, values in REPORTED.items())
    header = HEADER.format(signals=signals, reported=reported)
    parts = [header, _benches(), _overview()]
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
    return "## How each bench applies faults\n\n" + markdown_table(
        ("fault", "lockstep", "processes", "hardware"), rows
    )


def _overview() -> str:
    rows = [
        (f"[`{each.name}`](#{each.name})", PLACE_TITLES[each.place], "; ".join(each.hazards))
        for each in all_described()
    ]
    return "## Kinds\n\n" + markdown_table(("kind", "place", "possible consequences"), rows)


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
    """Write the document, or with --check only report whether it is current."""
    return write_or_check(
        argv,
        module="metro_tools.fault_doc",
        description=__doc__,
        default_path=DEFAULT_PATH,
        document=document,
    )


if __name__ == "__main__":
    sys.exit(main())
