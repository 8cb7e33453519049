"""`plant wayside`: arbiters, objects and axle counters of a line whose trains command
themselves.
"""

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from firmware_py.clock.clock import WallClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.clock.realtime import collect_garbage, die_with_parent, enter_realtime
from firmware_py.interrupts import Interrupts
from firmware_py.ports import RadioPort
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.zenoh_radio import SessionRole, open_radio
from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import AreaMap, load_areas
from plant_emulator.cli.network_wayside import NetworkPlan, NetworkPrograms, plan_network
from plant_emulator.cli.wayside_parts import ALL, ARBITER, ROUTER, TRACK, LineParts, credentials_of
from plant_emulator.cli.words import say
from plant_emulator.wayside.detection import Detection, Place, key_of, packed, subscription
from plant_emulator.wayside.line_wayside import WaysideTruth
from plant_emulator.world import World
from zenoh_config.secured import train_name
from zenoh_config.sessions import check_secured

BEAT_MS: Final = 5.0
FEED_MS: Final = 20.0
DOORS_MS: Final = 10.0
GARBAGE_MS: Final = 1000.0
REFUSED_MS: Final = 1000.0
AXLES: Final = 16
INBOX_MESSAGES: Final = 8192
"""Maximum number of messages between two steps: each train reports its place 50 times a second."""
NS_PER_S: Final = 1_000_000_000


def serve_line(options: argparse.Namespace) -> int:
    """Serve until asked to end and return the exit code.

    Raises SettingsError, RadioError, OSError.
    """
    if options.parent is not None:
        die_with_parent(options.parent)
    _check_secured(options)
    _check_part(options)
    served = plan_network(options) if options.routes else load_areas(options.line)
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock()
        device: _Line | NetworkPrograms
        if isinstance(served, NetworkPlan):
            device = NetworkPrograms(options, served, clock, stack)
        else:
            device = _Line(options, served, clock, stack)
        tasks = [Task("line", BEAT_MS, device.beat), Task("refused", REFUSED_MS, device.refused)]
        if isinstance(device, _Line):
            tasks.append(Task("doors", DOORS_MS, device.doors))
        if options.priority:
            enter_realtime(options.priority)
            tasks.append(Task("garbage", GARBAGE_MS, collect_garbage, offset_ms=GARBAGE_MS))
        end_ns = None
        if options.duration_s is not None:
            end_ns = clock.now_ns() + round(options.duration_s * NS_PER_S)
        what = "wayside" if options.part == ALL else options.part
        say(f"{what} of {device.text}, {options.line_radio}")
        run(
            [Executive(tasks, clock.now_ns())],
            clock,
            lambda now_ns: ending.asked or (end_ns is not None and now_ns >= end_ns),
        )
    return ending.exit_code


class _Line:
    def __init__(
        self, options: argparse.Namespace, areas: AreaMap, clock: WallClock, stack: ExitStack
    ) -> None:
        folder = None if options.memory is None else Path(options.memory)
        part, secure = options.part, credentials_of(options, clock)
        listens = part in (ALL, ROUTER)
        line = load_line(options.line)
        self._parts = LineParts(options, areas, line, folder, clock, secure)
        self._wayside = self._parts.wayside
        self._detection = Detection(areas)
        counters = (subscription(areas.name),) if part in (ALL, TRACK) else ()
        topics = () if part == ROUTER else (*self._wayside.subscriptions, *counters)
        self._port = open_radio(
            SessionRole.WAYSIDE if listens else SessionRole.TRAIN,
            options.line_radio,
            topics,
            clock,
            inbox_messages=INBOX_MESSAGES,
            secure=secure,
        )
        stack.callback(self._port.close)
        self.text = f"{areas.name}: {len(areas.areas)} areas"

    def beat(self, now_ns: int) -> None:
        heard = self._detection.on_message(self._port.receive(now_ns))
        truth = WaysideTruth(self._detection.axles() if heard else {}, self._detection.occupied())
        for key, payload in self._wayside.step(now_ns, heard, truth):
            self._port.send(now_ns, key, payload)
        self._parts.print_grants()

    def refused(self, now_ns: int) -> None:
        """Report refused messages, so that a wrongly configured line becomes visible."""
        self._parts.print_refused()

    def doors(self, now_ns: int) -> None:
        self._parts.centre.step_doors(now_ns)


def _check_part(options: argparse.Namespace) -> None:
    """Raise SettingsError for a part that the line does not have."""
    part = options.part
    if part.startswith(ARBITER) and int(part.removeprefix(ARBITER)) > options.arbiters:
        raise SettingsError(f"--part {part}: the line has --arbiters {options.arbiters}")


def _check_secured(options: argparse.Namespace) -> None:
    """Raise SettingsError if others can reach a line that is not secured."""
    try:
        check_secured(
            options.line_radio, secured=options.secure is not None, insecure=options.insecure
        )
    except ValueError as error:
        raise SettingsError(f"--line-radio {error}") from error


def feed_of(
    options: argparse.Namespace, line_name: str, world: World, clock: WallClock, stack: ExitStack
) -> Executive:
    """Return the executive that reports the train's true place to the line's axle counters."""
    _check_secured(options)
    secure = None
    if options.secure is not None:
        secure = load_credentials(options.secure, train_name(options.train), clock.epoch_ns())
    port: RadioPort = open_radio(SessionRole.TRAIN, options.line_radio, (), clock, secure=secure)
    stack.callback(port.close)
    key = key_of(line_name, options.train)

    def tell(now_ns: int) -> None:
        place = Place(world.front_m, world.front_m - world.length_m, AXLES, now_ns)
        port.send(now_ns, key, packed(place))

    return Executive([Task("rails", FEED_MS, tell)], clock.now_ns())
