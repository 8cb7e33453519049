"""Bodies between header and safety code of each message, in msgpack."""

from typing import Final

import msgspec

# The fields are in the order of docs/reference/radio_interface.md.
REPORT_BODY: Final = msgspec.msgpack.Decoder(tuple[int, float, float, float, float, bool, int])
AUTHORITY_BODY: Final = msgspec.msgpack.Decoder(tuple[int, int, int, float, float | None, int])


class StatusBody(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    boot: int
    mode: int
    supervision: int
    cause: int
    localised: bool
    standstill: bool
    front_m: float
    doors_locked: bool
    open_left: bool
    open_right: bool
    passenger_alarm: bool
    fire: bool
    obstacle: bool
    alarm_raised: bool
    emergency_number: int


class OrdersBody(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    boot: int
    echo_stamp_ns: int
    awake: bool
    hold: bool
    skip_next: bool
    stop_next: bool
    emergency: bool
    releases: int
    creep: bool
    restricted: bool
    doors_left: bool
    doors_right: bool
    platform_doors_locked: bool
    restrictions: list[tuple[float, float, float]]
    released_emergency: int


STATUS_BODY: Final = msgspec.msgpack.Decoder(StatusBody)
ORDERS_BODY: Final = msgspec.msgpack.Decoder(OrdersBody)
