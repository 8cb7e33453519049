"""Translates key presses into the desk's lever, switches and buttons."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from can_dbc.cab import CabMode, Desk

PRESS_NS: Final = 1_000_000_000
"""Time for which a spring-loaded button stays pressed after its key."""
NOTCH_PERCENT: Final = 10.0
FULL_PERCENT: Final = 100.0


def unattended(mode: CabMode) -> Desk:
    """Return the desk of an unattended train: all inputs permissive, no button pressed."""
    return Desk(
        mode=mode,
        lever_percent=0.0,
        emergency_released=True,
        no_passenger_alarm=True,
        departure_requested=False,
        reset_requested=False,
        open_left_requested=False,
        open_right_requested=False,
    )


@dataclass(frozen=True, slots=True)
class Hands:
    """The desk as last operated, and until when its spring-loaded buttons stay pressed."""

    desk: Desk
    departure_until_ns: int = 0
    reset_until_ns: int = 0
    gone: bool = False
    """The person has left."""

    def at(self, now_ns: int) -> Desk:
        return replace(
            self.desk,
            departure_requested=now_ns < self.departure_until_ns,
            reset_requested=now_ns < self.reset_until_ns,
        )


def press(hands: Hands, key: str, now_ns: int) -> Hands:
    """Apply the action of one key; unknown keys have none."""
    action = _ACTIONS.get(key)
    return hands if action is None else action(hands, now_ns)


def _to(**fields: object) -> Callable[[Hands, int], Hands]:
    def act(hands: Hands, now_ns: int) -> Hands:
        return replace(hands, desk=replace(hands.desk, **fields))  # type: ignore[arg-type]

    return act


def _flip(field: str) -> Callable[[Hands, int], Hands]:
    def act(hands: Hands, now_ns: int) -> Hands:
        return _to(**{field: not getattr(hands.desk, field)})(hands, now_ns)

    return act


def _notch(by_percent: float) -> Callable[[Hands, int], Hands]:
    def act(hands: Hands, now_ns: int) -> Hands:
        lever_percent = hands.desk.lever_percent + by_percent
        lever_percent = max(-FULL_PERCENT, min(FULL_PERCENT, lever_percent))
        return _to(lever_percent=lever_percent)(hands, now_ns)

    return act


def _depart(hands: Hands, now_ns: int) -> Hands:
    return replace(hands, departure_until_ns=now_ns + PRESS_NS)


def _reset(hands: Hands, now_ns: int) -> Hands:
    return replace(hands, reset_until_ns=now_ns + PRESS_NS)


def _leave(hands: Hands, now_ns: int) -> Hands:
    return replace(hands, gone=True)


KEYS: Final[tuple[tuple[str, str, Callable[[Hands, int], Hands]], ...]] = (
    ("up", "lever up", _notch(NOTCH_PERCENT)),
    ("down", "lever down", _notch(-NOTCH_PERCENT)),
    ("space", "lever to 0", _to(lever_percent=0.0)),
    ("b", "full brake", _to(lever_percent=-FULL_PERCENT)),
    ("a", "AUTO", _to(mode=CabMode.AUTO)),
    ("m", "MANUAL", _to(mode=CabMode.MANUAL)),
    ("o", "OFF", _to(mode=CabMode.OFF)),
    ("d", "depart", _depart),
    ("r", "reset", _reset),
    ("e", "EMERGENCY button", _flip("emergency_released")),
    ("left", "left doors", _flip("open_left_requested")),
    ("right", "right doors", _flip("open_right_requested")),
    ("x", "restricted", _flip("restricted_requested")),
    ("y", "door bypass", _flip("door_bypass_requested")),
    ("p", "passenger alarm", _flip("no_passenger_alarm")),
    ("q", "leave the desk", _leave),
)
"""Key, its description on the screen, and its action."""
_ACTIONS: Final[Mapping[str, Callable[[Hands, int], Hands]]] = {
    key: action for key, _, action in KEYS
}
