"""Opens the ports of one train in real time: bus, tag reader's line, wayside radio."""

from contextlib import ExitStack
from typing import Final

from can_dbc.binding import can_id, kinds, sender
from can_dbc.nodes import Node
from firmware_py import rendezvous
from firmware_py.buses import BusError, open_can, parse_spec
from firmware_py.clock.clock import Clock
from firmware_py.ports import SerialPort
from firmware_py.radio.zenoh_radio import (
    DEFAULT_ENDPOINT,
    RadioError,
    SessionRole,
    ZenohRadio,
    open_radio,
    pick_endpoint,
)
from firmware_py.tag_reader.serial_line import open_pty, open_serial
from firmware_py.trackdb import LineMap
from plant_emulator.cli.options import AUTO
from plant_emulator.cli.words import say
from plant_emulator.wayside.railway import subscriptions

LISTEN_NS: Final = 250_000_000
"""Time to listen for another plant; longer than the period of its slowest vital status."""


def refuse_second_plant(spec: str, clock: Clock, *, desk_elsewhere: bool) -> None:
    """Raise BusError if another plant already sends on this bus."""
    others = {Node.VOBC.name, Node.DESK.name} if desk_elsewhere else {Node.VOBC.name}
    ours = {can_id(kind): sender(kind) for kind in kinds() if sender(kind) not in others}
    with ExitStack() as stack:
        probe = open_can(spec, clock=clock, node="PLANT_PROBE", accept_ids=frozenset(ours))
        stack.callback(probe.close)
        clock.wait_until(clock.now_ns() + LISTEN_NS)
        heard = {ours[frame.can_id] for frame in probe.receive(clock.now_ns())}
    if heard:
        raise BusError(
            f"{spec}: a train is already on this bus; received {', '.join(sorted(heard))}"
        )


def open_tags(wanted: str, spec: str, stack: ExitStack, *, quiet: bool = False) -> SerialPort:
    tags: SerialPort
    if wanted == AUTO:
        tags, path = open_pty()
        link = rendezvous.publish_tags(parse_spec(spec).name, path)
        words = f"{path}, linked from {link}"
    else:
        tags, words = open_serial(wanted), wanted
    if not quiet:
        say(f"tags: {words}")
    stack.callback(tags.close)
    return tags


def open_wayside(
    wanted: str,
    line: LineMap,
    spec: str,
    clock: Clock,
    stack: ExitStack,
    *,
    quiet: bool = False,
) -> ZenohRadio:
    topics = subscriptions(line.name)
    if wanted != AUTO:
        radio = open_radio(SessionRole.WAYSIDE, wanted, topics, clock)
    else:
        try:
            radio = open_radio(SessionRole.WAYSIDE, DEFAULT_ENDPOINT, topics, clock)
        except RadioError:
            radio = open_radio(SessionRole.WAYSIDE, pick_endpoint(), topics, clock)
    stack.callback(radio.close)
    rendezvous.publish_radio(parse_spec(spec).name, radio.endpoint)
    if not quiet:
        say(f"wayside: {radio.endpoint}")
    return radio
