"""Inputs that a controller receives in one cycle; tests change single fields of them."""

from can_dbc.cab import CabMode, Desk
from vobc.vocabulary import CycleInput, Orders

SILENCE = CycleInput(now_ns=0, dt_s=0.05)
"""A cycle of 50 ms before any frame has arrived."""
DESK = Desk(CabMode.AUTO, 0.0, True, True, False, False, False, False)
"""A driver's desk in automatic mode with no button pressed."""
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
"""Orders of a centre that permits nothing and requests nothing."""
