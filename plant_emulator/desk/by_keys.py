"""A desk of the plant that a person operates by keys, recorded so that it can be replayed."""

from collections.abc import Callable, Iterable
from typing import Final

from can_dbc.cab import CabMode, Desk
from plant_emulator.desk.attendant import Attendant
from plant_emulator.desk.display import DeskDisplay
from plant_emulator.desk.hands import Hands, press, unattended
from plant_emulator.desk.recording import change_line

NS_PER_S: Final = 1_000_000_000


def keyed(
    pressed: Callable[[], Iterable[str]],
    record: Callable[[str], object],
    *,
    mode: CabMode,
    start_ns: int,
) -> Attendant:
    """Return an operator of the desk who does what the keys say.

    Args:
        pressed: returns the names of the keys that were pressed since the last call.
        record: receives a line of a desk recording for each change.
        mode: mode of the desk before the first key.
        start_ns: instant from which the recording counts.
    """
    hands, recorded = Hands(unattended(mode)), None

    def drive(display: DeskDisplay, now_ns: int) -> Desk:
        nonlocal hands, recorded
        for key in pressed():
            hands = press(hands, key, now_ns)
        desk = hands.at(now_ns)
        if desk != recorded:
            record(change_line((now_ns - start_ns) / NS_PER_S, recorded, desk))
            recorded = desk
        return desk

    return drive
