"""Events of inputs that fell silent or came back, and of new orders and authorities."""

import math
from collections.abc import Iterator
from typing import Final

from can_dbc.brake import BrakeStatus
from can_dbc.traction import TractionStatus
from can_dbc.vobc import EventKind, Missing
from vobc.vocabulary import Authority, CycleInput, CycleOutput, Event, Orders, Source

INPUTS: Final = (
    (Missing.BRAKE, "brake unit", Source.BRAKE, "brake_age_s"),
    (Missing.TRACTION, "traction unit", Source.TRACTION, "traction_age_s"),
    (Missing.ODOMETER, "odometer", Source.TACHO, "tacho_age_s"),
    (Missing.DOORS, "door unit", Source.DOORS, "doors_age_s"),
    (Missing.DESK, "desk", Source.DESK, "desk_age_s"),
    (Missing.TAG_READER, "tag reader", Source.TAG_READER, "tag_reader_age_s"),
    (Missing.AUTHORITY, "movement authority", Source.AUTHORITY, "authority_age_s"),
    (Missing.ALARMS, "obstacle and fire detection", Source.ALARMS, "alarms_age_s"),
)
"""Flag, text, source and age of each input. Lost localisation has its own event."""


UNITS: Final = {Missing.BRAKE: "brake", Missing.TRACTION: "traction"}
"""Units that report whether they are ready, with the field of their status."""


def inputs_changed(before: CycleOutput, inputs: CycleInput, output: CycleOutput) -> Iterator[Event]:
    changed = output.missing ^ before.missing
    for flag, words, source, age in INPUTS:
        if not changed & flag:
            continue
        if output.missing & flag:
            told = f"{words} lost: {_age_words(getattr(inputs, age))}"
            if flag in UNITS and _is_unready(getattr(inputs, UNITS[flag])):
                told = f"{words} reports that it is not ready"
            yield Event(EventKind.INPUT_LOST, told, (source,), int(flag))
        else:
            yield Event(EventKind.INPUT_BACK, f"{words} is available", (source,), int(flag))


def units_not_ready(before: CycleInput, inputs: CycleInput) -> Iterator[Event]:
    """Units whose first message reports that they are not ready."""
    for flag, words, source, _ in INPUTS:
        name = UNITS.get(flag)
        if name and getattr(before, name) is None and _is_unready(getattr(inputs, name)):
            yield Event(
                EventKind.INPUT_LOST, f"{words} reports that it is not ready", (source,), int(flag)
            )


def _is_unready(status: BrakeStatus | TractionStatus | None) -> bool:
    return status is not None and not status.ready


def _age_words(age_s: float) -> str:
    return "never received" if math.isinf(age_s) else f"last received {age_s:.2f} s ago"


def authority_changed(before: Authority | None, now: Authority | None) -> Iterator[Event]:
    if now is None:
        return
    # The protected place of the rear follows the train. Only its presence is reported.
    if before is not None and (before.end_m, before.rear_m is None, before.term) == (
        now.end_m,
        now.rear_m is None,
        now.term,
    ):
        return
    words = f"movement authority to {now.end_m:.2f} m"
    if now.rear_m is not None:
        words += f", rear protected back to {now.rear_m:.2f} m"
    words += f", term {now.term}, sequence {now.sequence}"
    if before is None:
        words += "; the first one"
    elif before.end_m != now.end_m:
        words += f"; it ended at {before.end_m:.2f} m before"
    yield Event(EventKind.AUTHORITY_CHANGED, words, (Source.AUTHORITY,), now.term)


ORDER_WORDS: Final = (
    ("awake", "be awake", "sleep"),
    ("hold", "hold at the platform", "hold ended"),
    ("skip_next", "skip the next station", "skip no station"),
    ("stop_next", "stop at the next station", "stop by the plan"),
    ("emergency", "emergency brake", "emergency brake order ended"),
    ("creep", "creep", "creep order ended"),
    ("restricted", "drive on sight", "driving on sight ended"),
    ("doors_left", "doors on the left may open", "doors on the left stay closed"),
    ("doors_right", "doors on the right may open", "doors on the right stay closed"),
    ("platform_doors_locked", "platform doors are locked", "platform doors are not locked"),
)
"""Field of the orders, with its text when set and when ended."""


def orders_changed(before: Orders | None, now: Orders | None) -> Iterator[Event]:
    if now is None or now is before or now == before:
        return
    changes = [
        yes if getattr(now, name) else no
        for name, yes, no in ORDER_WORDS
        if getattr(now, name) != (before is not None and getattr(before, name))
    ]
    if now.releases != (0 if before is None else before.releases):
        changes.append(f"reset {now.releases}")
    if now.restrictions != (before.restrictions if before is not None else ()):
        changes.append(_restrictions(now))
    begin = "the centre's first orders" if before is None else "the centre orders"
    words = f"{begin}: {', '.join(changes) or 'none'}"
    yield Event(EventKind.ORDERS_CHANGED, words, (Source.ORDERS,))


def _restrictions(orders: Orders) -> str:
    if not orders.restrictions:
        return "no speed restriction"
    return "restricted to " + ", ".join(
        f"{each.limit_mps:.2f} m/s from {each.start_m:.1f} m to {each.end_m:.1f} m"
        for each in orders.restrictions
    )
