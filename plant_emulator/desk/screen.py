"""The desk's screen as lines of text that fit a terminal of 80 by 24."""

from collections.abc import Iterator
from typing import Final

from can_dbc.cab import Desk
from can_dbc.doors import DoorCars, DoorCommand, cars_text
from can_dbc.vobc import (
    Inhibit,
    Missing,
    OperatingMode,
    VobcLimits,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcSupervision,
    VobcTarget,
    Withheld,
)
from plant_emulator.desk.display import DeskDisplay
from plant_emulator.desk.dmi import (
    KMH_PER_MPS,
    NOTHING,
    StatusColour,
    colour_of,
    dial,
    intervention_text,
    limits_text,
    target_text,
)
from plant_emulator.desk.hands import KEYS

WIDTH: Final = 79
HEIGHT: Final = 23
COLOURED: Final = range(2, 4)
"""Rows of the screen in the status colour."""
KEYS_A_LINE: Final = 4
KEY_WIDTH: Final = 19
FAR_M: Final = 100_000.0
"""Distance from which on the screen shows no target, m."""


def lines(display: DeskDisplay, desk: Desk, now_ns: int, note: str = "") -> list[str]:
    """Return the lines of the screen; `note` is the last one."""
    body = [
        "METRO DRIVER'S DESK".center(WIDTH).rstrip(),
        display.silence(now_ns).center(WIDTH).rstrip(),
        *_speeds(display, now_ns),
        "",
        *_state(display, now_ns),
        "",
        *_desk_lines(desk),
        "",
        *_keys(),
        note,
    ]
    assert len(body) <= HEIGHT
    return [line[:WIDTH] for line in body]


def status_colour(display: DeskDisplay, now_ns: int) -> StatusColour | None:
    """Return the colour of the speed; None while the display lacks a frame for it."""
    motion, told = display.speeds(now_ns), display.latest(VobcSupervision, now_ns)
    return None if motion is None or told is None else colour_of(motion, told)


def _speeds(display: DeskDisplay, now_ns: int) -> Iterator[str]:
    motion, told = display.speeds(now_ns), display.latest(VobcSupervision, now_ns)
    limits, colour = display.latest(VobcLimits, now_ns), status_colour(display, now_ns)
    speed = f"{NOTHING:>6}" if motion is None else f"{KMH_PER_MPS * motion.speed_mps:6.1f}"
    status = NOTHING if colour is None else f"{colour.shown}: {colour.meaning}"
    yield f"{'speed':>10}  {speed} km/h  {status}"
    yield f"{'':>10}  {NOTHING if motion is None else dial(motion, limits, told)}"
    yield f"{'limits':>10}  {NOTHING if motion is None else limits_text(motion, limits)}"
    yield f"{'target':>10}  {NOTHING if told is None else target_text(told)}"
    yield f"{'protection':>10}  {_intervention(told, display.latest(VobcMode, now_ns))}"


def _intervention(told: VobcSupervision | None, mode: VobcMode | None) -> str:
    """Show what protection does; of a controller that does not send it, the emergency's cause."""
    if told is not None:
        return intervention_text(told)
    return NOTHING if mode is None or not mode.cause else f"emergency: {_as_text(mode.cause.name)}"


def _state(display: DeskDisplay, now_ns: int) -> Iterator[str]:
    status, mode = display.latest(VobcStatus, now_ns), display.latest(VobcMode, now_ns)
    supervision = NOTHING if status is None else _as_text(status.supervision.name)
    phase = NOTHING if status is None else _as_text(status.ato_phase.name)
    yield f"{'mode':>10}  {_mode(mode):24}{'supervision':>12}  {supervision:14}ATO  {phase}"
    missing = NOTHING if status is None else _flags(status.missing)
    yield f"{'missing':>10}  {missing}"
    yield f"{'departure':>10}  {_departure(mode, display.speeds(now_ns))}"
    doors, cars = display.latest(DoorCommand, now_ns), display.latest(DoorCars, now_ns)
    yield f"{'doors':>10}  {_doors(mode, doors, cars)}"
    position, target = display.latest(VobcPosition, now_ns), display.latest(VobcTarget, now_ns)
    yield f"{'front':>10}  {_place(position, target)}"


def _mode(mode: VobcMode | None) -> str:
    if mode is None:
        return NOTHING
    alarm = "  ALARM" if mode.alarm_raised else ""
    attempts = f" {mode.jog_attempts}" if mode.mode is OperatingMode.JOG else ""
    return f"{_as_text(mode.mode.name)}{attempts}{alarm}"


def _departure(mode: VobcMode | None, motion: VobcMotion | None) -> str:
    """Show the departure inhibits; none while the train is moving."""
    if mode is None or motion is None or abs(motion.speed_mps) > 0.0:
        return NOTHING
    return _flags(mode.departure_inhibits) if mode.departure_inhibits else "permitted"


def _doors(mode: VobcMode | None, doors: DoorCommand | None, cars: DoorCars | None) -> str:
    """Show the enabled sides or cars, or else why doors are withheld; away from platforms none
    exists.
    """
    if doors is not None and (doors.enable_left or doors.enable_right):
        sides = (("left", doors.enable_left), ("right", doors.enable_right))
        return "enabled " + " and ".join(name for name, enabled in sides if enabled)
    if cars is not None and (cars.left_cars or cars.right_cars):
        of_sides = (("left", cars.left_cars), ("right", cars.right_cars))
        return "enabled " + " and ".join(
            f"{name} in {cars_text(chosen)}" for name, chosen in of_sides if chosen
        )
    if mode is None or not mode.doors_withheld:
        return NOTHING
    return _flags(mode.doors_withheld)


def _place(position: VobcPosition | None, target: VobcTarget | None) -> str:
    if position is None:
        return NOTHING
    text = f"{position.front_m:.1f} m ± {position.uncertainty_m:.1f} m"
    if target is not None and target.distance_to_authority_m < FAR_M:
        text += f"   authority ends in {target.distance_to_authority_m:.0f} m"
    return text


def _desk_lines(desk: Desk) -> Iterator[str]:
    pressed = [
        words
        for on, words in (
            (not desk.emergency_released, "EMERGENCY"),
            (not desk.no_passenger_alarm, "passenger alarm"),
            (desk.departure_requested, "departure"),
            (desk.reset_requested, "reset"),
            (desk.open_left_requested, "left doors"),
            (desk.open_right_requested, "right doors"),
            (desk.restricted_requested, "restricted"),
            (desk.door_bypass_requested, "door bypass"),
        )
        if on
    ]
    yield f"{'key':>10}  {desk.mode.name:24}{'lever':>12}  {desk.lever_percent:+.0f} %"
    yield f"{'pressed':>10}  {', '.join(pressed) or NOTHING}"


def _keys() -> Iterator[str]:
    shown = [f"{key} {words}"[:KEY_WIDTH].ljust(KEY_WIDTH) for key, words, _ in KEYS]
    for at in range(0, len(shown), KEYS_A_LINE):
        yield " ".join(shown[at : at + KEYS_A_LINE]).rstrip()


def _flags(flags: Inhibit | Missing | Withheld) -> str:
    return ", ".join(_as_text(flag.name or "") for flag in type(flags) if flag & flags) or "nothing"


def _as_text(name: str) -> str:
    return name.lower().replace("_", " ")
