"""Events for the changes from one cycle to the next, with cause and sources."""

import enum
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from can_dbc.doors import ALL_CARS, cars_text
from can_dbc.vobc import EventKind, Inhibit, OperatingMode, Supervision, Withheld
from vobc.events.brake import brake_found
from vobc.events.causes import emergency_applied, emergency_released
from vobc.events.inputs import (
    authority_changed,
    inputs_changed,
    orders_changed,
    units_not_ready,
)
from vobc.events.movement import motion_changed
from vobc.events.words import flag_words, name_words, place_words
from vobc.vocabulary import CycleInput, CycleOutput, Event, Source

NOTHING: Final[Sequence[Event]] = ()

MODE_SOURCES: Final[Mapping[OperatingMode, tuple[Source, ...]]] = {
    OperatingMode.RESTRICTED: (Source.DESK, Source.ORDERS),
    OperatingMode.CREEP: (Source.ORDERS,),
    OperatingMode.AUTHORISED: (Source.AUTHORITY, Source.TAG),
}
"""Inputs that let the train enter a mode."""
INHIBIT_SOURCES: Final[Mapping[enum.IntFlag, Source]] = {
    Inhibit.DOORS: Source.DOORS,
    Inhibit.PLATFORM_DOORS: Source.ORDERS,
    Inhibit.AUTHORITY: Source.AUTHORITY,
    Inhibit.HOLD: Source.ORDERS,
    Inhibit.PASSENGER_ALARM: Source.DESK,
    Inhibit.FIRE: Source.ALARMS,
    Inhibit.OBSTACLE: Source.ALARMS,
    Inhibit.ASLEEP: Source.ORDERS,
    Inhibit.CENTRE_SILENT: Source.ORDERS,
}
WITHHELD_SOURCES: Final[Mapping[enum.IntFlag, Source]] = {
    Withheld.MOVING: Source.TACHO,
    Withheld.NOT_LOCALISED: Source.TAG,
    Withheld.NO_PLATFORM: Source.TAG,
    Withheld.MISALIGNED: Source.TACHO,
    Withheld.OFF_PLATFORM: Source.TACHO,
    Withheld.NOT_HELD: Source.BRAKE,
    Withheld.TRACTION: Source.TRACTION,
    Withheld.NOT_AUTHORISED: Source.ORDERS,
    Withheld.CENTRE_SILENT: Source.ORDERS,
}


def events_between(
    before: CycleOutput | None,
    inputs: CycleInput,
    output: CycleOutput,
    inputs_before: CycleInput | None = None,
) -> Sequence[Event]:
    """All events of the step from `before` to `output`, the most important first.

    Each change of the supervision makes exactly one event, and so does each change of the mode.

    Args:
        before: output of the cycle before. None: this is the first cycle.
        inputs: inputs of `output`.
        inputs_before: inputs of `before`. None: changes of received messages are not reported.
    """
    if before is None:
        return tuple(_first(output))
    # Nearly every cycle changes nothing, and must then cost almost no time. Fields with few values
    # are compared by identity here and examined only below.
    found: list[Event] = []
    if (
        output.supervision is not before.supervision
        or output.emergency_cause is not before.emergency_cause
    ):
        found.extend(_supervision(before, inputs, output, inputs_before))
    if output.mode is not before.mode or output.jog_attempts != before.jog_attempts:
        found.extend(_mode(before, output))
    if output.missing is not before.missing:
        found.extend(inputs_changed(before, inputs, output))
    if inputs.overruns:
        found.append(_overrun(inputs))
    if output.motion is not None:
        found.extend(motion_changed(before.motion, output.motion))
    if (
        output.departure_inhibits is not before.departure_inhibits
        or output.doors_withheld is not before.doors_withheld
        or output.enable_left is not before.enable_left
        or output.enable_right is not before.enable_right
        or output.door_cars != before.door_cars
        or _stands(output) is not _stands(before)
    ):
        found.extend(_station(before, output))
    if (
        output.alarm_raised is not before.alarm_raised
        or output.door_bypass is not before.door_bypass
        or output.replicas_agree is not before.replicas_agree
    ):
        found.extend(_alarms(before, inputs, output))
    if output.brake_finding is not None:
        found.append(brake_found(output.brake_finding, output))
    _extend_by_messages(found, inputs_before, inputs)
    return found or NOTHING


def _extend_by_messages(found: list[Event], before: CycleInput | None, inputs: CycleInput) -> None:
    """Add the events of received messages that changed."""
    if before is None:
        return
    if before.brake is None or before.traction is None:
        found.extend(units_not_ready(before, inputs))
    if inputs.authority is not before.authority:
        found.extend(authority_changed(before.authority, inputs.authority))
    if inputs.orders is not before.orders:
        found.extend(orders_changed(before.orders, inputs.orders))


def _first(output: CycleOutput) -> Iterator[Event]:
    """Events of the first cycle."""
    words = f"the controller starts: protection is in {name_words(output.supervision)}"
    if output.cause:
        words += f", {output.cause}"
    yield Event(EventKind.SUPERVISION, words, (), int(output.supervision))
    words = f"the controller starts in mode {name_words(output.mode)}"
    yield Event(EventKind.MODE, words, (), int(output.mode))


def _supervision(
    before: CycleOutput, inputs: CycleInput, output: CycleOutput, inputs_before: CycleInput | None
) -> Iterator[Event]:
    state = output.supervision
    if state is Supervision.EMERGENCY:
        yield emergency_applied(before, inputs, output)
    elif before.supervision is Supervision.EMERGENCY:
        yield emergency_released(before, inputs, output, inputs_before)
    elif state is Supervision.SERVICE and before.supervision is not state:
        yield _service_brake(inputs, output)
    elif state is not before.supervision:
        yield _state(before, output)


def _service_brake(inputs: CycleInput, output: CycleOutput) -> Event:
    ceiling, motion = output.ceiling, output.motion
    words = f"protection brakes with the service brake: {output.cause or 'speed too high'}"
    if ceiling is not None and motion is not None:
        words += (
            f"; speed at most {motion.speed_mps.high:.2f} m/s, service limit"
            f" {ceiling.service_mps:.2f} m/s, {ceiling.distance_to_authority_m:.1f} m before the"
            f" end of authority, which is {inputs.authority_age_s:.2f} s old"
        )
    return Event(EventKind.SERVICE_BRAKE, words, (Source.TACHO, Source.AUTHORITY))


def _state(before: CycleOutput, output: CycleOutput) -> Event:
    words = f"protection goes from {name_words(before.supervision)} to"
    words += f" {name_words(output.supervision)}"
    if output.cause:
        words += f": {output.cause}"
    return Event(
        EventKind.SUPERVISION,
        words + place_words(output),
        (Source.TACHO,),
        int(output.supervision),
    )


def _mode(before: CycleOutput, output: CycleOutput) -> Iterator[Event]:
    mode, old = output.mode, before.mode
    number = int(mode)
    if output.jog_attempts > before.jog_attempts:
        words = f"jog {output.jog_attempts} at this stop begins{place_words(output)}"
        yield Event(EventKind.JOG_BEGAN, words, (Source.TACHO,), output.jog_attempts)
    elif mode is OperatingMode.JOG and old not in (mode, OperatingMode.ASLEEP):
        words = f"a jog begins{place_words(output)}"
        yield Event(EventKind.JOG_BEGAN, words, (Source.TACHO,), output.jog_attempts)
    if mode is old:
        return
    if old is OperatingMode.JOG:
        words = f"the jog ends in mode {name_words(mode)}{place_words(output)}"
        yield Event(EventKind.JOG_ENDED, words, (Source.TACHO,), output.jog_attempts)
    elif old is OperatingMode.ASLEEP:
        words = f"woken by the centre, now in mode {name_words(mode)}"
        yield Event(EventKind.WOKEN, words, (Source.ORDERS, Source.COLD), number)
    elif mode is OperatingMode.ASLEEP:
        words = f"put to sleep{place_words(output)}"
        yield Event(EventKind.PUT_TO_SLEEP, words, (Source.ORDERS,), number)
    elif mode is not OperatingMode.JOG:
        words = f"mode goes from {name_words(old)} to {name_words(mode)}{_why_over(output)}"
        words += place_words(output)
        yield Event(EventKind.MODE, words, MODE_SOURCES.get(mode, (Source.TACHO,)), number)


def _why_over(output: CycleOutput) -> str:
    """Reason why the movement ended, for a train that is back in standby."""
    if output.mode is not OperatingMode.STANDBY:
        return ""
    if output.supervision is Supervision.EMERGENCY:
        return f" after the emergency brake ({name_words(output.emergency_cause)})"
    return f" for lack of {flag_words(output.missing)}" if output.missing else ""


def _overrun(inputs: CycleInput) -> Event:
    cycles = (
        "1 control cycle was" if inputs.overruns == 1 else f"{inputs.overruns} control cycles were"
    )
    words = f"{cycles} missed: {inputs.dt_s:.3f} s since the last one"
    return Event(EventKind.OVERRUN, words, (Source.CLOCK,), inputs.overruns)


def _stands(output: CycleOutput) -> bool:
    return output.motion is not None and output.motion.standstill


def _station(before: CycleOutput, output: CycleOutput) -> Iterator[Event]:
    if _enabled(output) != _enabled(before):
        yield _doors_enabled(output) if any(_enabled(output)) else _doors_withheld(output)
    elif output.doors_withheld != before.doors_withheld and _at_platform(output):
        yield _doors_withheld(output)
    if output.stands_in and not before.stands_in:
        words = f"the train stands in a zone in which none should stop: {output.stands_in}"
        yield Event(EventKind.STOPPED_IN_ZONE, words + place_words(output), (Source.TACHO,))
    inhibits = output.departure_inhibits
    news = inhibits != before.departure_inhibits or (inhibits and not _stands(before))
    if not news or not _stands(output):
        return
    if inhibits == Inhibit.NONE:
        words = "departure is permitted"
        sources = _sources_of(before.departure_inhibits, INHIBIT_SOURCES)
        yield Event(EventKind.DEPARTURE_PERMITTED, words, sources)
        return
    words = f"departure is not permitted: {flag_words(inhibits)}"
    gained = inhibits & ~before.departure_inhibits if _stands(before) else inhibits
    sources = _sources_of(gained or inhibits, INHIBIT_SOURCES)
    yield Event(EventKind.DEPARTURE_INHIBITED, words, sources, int(inhibits))


def _enabled(output: CycleOutput) -> tuple[int, int]:
    """Enabled cars, left and right."""
    cars = output.door_cars
    return cars if output.enable_left else 0, cars if output.enable_right else 0


def _at_platform(output: CycleOutput) -> bool:
    return (
        _stands(output)
        and output.doors_withheld != Withheld.NONE
        and not output.doors_withheld & Withheld.NO_PLATFORM
    )


def _doors_enabled(output: CycleOutput) -> Event:
    sides = [
        name
        for name, on in (("left", output.enable_left), ("right", output.enable_right))
        if on
    ]  # fmt: skip
    cars = "" if output.door_cars == ALL_CARS else f" in {cars_text(output.door_cars)}"
    words = f"doors enabled on the {' and the '.join(sides)}{cars}{place_words(output)}"
    number = int(output.enable_left) + 2 * int(output.enable_right)
    sources = (Source.TACHO, Source.BRAKE, Source.TRACTION, Source.TAG, Source.ORDERS)
    return Event(EventKind.DOORS_ENABLED, words, sources, number)


def _doors_withheld(output: CycleOutput) -> Event:
    withheld = output.doors_withheld
    words = "no door is enabled"
    if withheld:
        words += f": {flag_words(withheld)}"
    sources = _sources_of(withheld, WITHHELD_SOURCES)
    return Event(EventKind.DOORS_WITHHELD, words + place_words(output), sources, int(withheld))


def _sources_of(flags: enum.IntFlag, table: Mapping[enum.IntFlag, Source]) -> tuple[Source, ...]:
    return tuple(dict.fromkeys(source for flag, source in table.items() if flag & flags))


def _alarms(before: CycleOutput, inputs: CycleInput, output: CycleOutput) -> Iterator[Event]:
    if before.replicas_agree and not output.replicas_agree:
        words = "the two computations of protection disagree"
        yield Event(EventKind.REPLICAS_DISAGREE, words + place_words(output), (Source.TACHO,))
    if output.alarm_raised and not before.alarm_raised:
        reasons, sources = _alarm_reasons(inputs)
        words = f"the train needs help: {reasons or 'it cannot correct its stop by itself'}"
        yield Event(EventKind.ALARM_RAISED, words + place_words(output), sources)
    elif before.alarm_raised and not output.alarm_raised:
        yield Event(EventKind.ALARM_CLEARED, "the train no longer needs help", (Source.DESK,))
    if output.door_bypass and not before.door_bypass:
        words = "the sealed switch lets the train depart although its doors are not proven locked"
        yield Event(EventKind.DOOR_BYPASS, words, (Source.DESK, Source.DOORS), 1)
    elif before.door_bypass and not output.door_bypass:
        words = "the sealed switch no longer bypasses the door lock"
        yield Event(EventKind.DOOR_BYPASS, words, (Source.DESK, Source.DOORS))


def _alarm_reasons(inputs: CycleInput) -> tuple[str, tuple[Source, ...]]:
    found: list[tuple[str, Source]] = []
    if inputs.desk is not None and not inputs.desk.no_passenger_alarm:
        found.append(("passenger alarm", Source.DESK))
    if inputs.alarms is not None and not inputs.alarms.no_fire:
        found.append(("fire", Source.ALARMS))
    if inputs.alarms is not None and not inputs.alarms.no_obstacle:
        found.append(("obstacle", Source.ALARMS))
    sources = dict.fromkeys(source for _, source in found)
    return ", ".join(words for words, _ in found), tuple(sources)
