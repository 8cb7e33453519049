"""What a controller hears in one cycle, for tests to change a few things of."""

from can_dbc.cab import CabMode, Desk
from vobc.vocabulary import CycleInput, Orders

SILENCE = CycleInput(now_ns=0, dt_s=0.05)
"""A cycle of 50 ms in which nobody has ever said anything."""
DESK = Desk(CabMode.AUTO, 0.0, True, True, False, False, False, False)
"""Automatic, nothing pressed."""
NO_ORDERS = Orders(
    awake=False,
    hold=False,
    skip_next=False,
    stop_next=False,
    emergency=False,
    releases=0,
    creep=False,
    restricted=False,
    doors_left=False,
    doors_right=False,
    platform_doors_locked=False,
)
"""Of a centre that permits nothing and wants nothing."""
