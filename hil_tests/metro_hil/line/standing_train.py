"""One train at rest in its own process over zenoh; prints the authorities that it accepts."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import collect_garbage, enter_realtime
from firmware_py.ports import TunableRadioPort
from firmware_py.radio.zenoh_radio import SessionRole, open_peer, open_radio
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.storage.nvram import NvramState
from firmware_py.trackdb.areas import Area, AreaMap, TrackSection
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import OwnTrain, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config.timers import TIMER_SETS

BEAT_NS: Final = 2_000_000
GARBAGE_NS: Final = 1_000_000_000
CYCLE_NS: Final = 50_000_000
"""Cycle of a controller, in which authorities are applied."""
HEADWAY_M: Final = 300.0
LENGTH_M: Final = 80.0
LINE_M: Final = 20_000.0
SECTION_M: Final = 100.0
AXLES: Final = 16
LINE: Final = AreaMap(
    "trial",
    (Area(1, 0.0, LINE_M),),
    tuple(
        [
            TrackSection(n + 1, n * SECTION_M, (n + 1) * SECTION_M)
            for n in range(round(LINE_M / SECTION_M))
        ]
    ),
)


def front_of(address: int) -> float:
    """Return where a train stands; train 1 is the foremost."""
    return LINE_M - 200.0 - HEADWAY_M * (address - 1)


def config_of(timers: str) -> T2tConfig:
    return T2tConfig(timers=TIMER_SETS[timers])


def main(argv: Sequence[str] | None = None) -> int:
    """Run until the process is ended; print a line of JSON for each accepted authority."""
    parser = argparse.ArgumentParser(
        prog="python -m metro_hil.line.standing_train", description=__doc__
    )
    parser.add_argument("address", type=int)
    parser.add_argument("endpoint")
    parser.add_argument("memory", type=Path, help="file that survives the process")
    parser.add_argument("--timers", choices=sorted(TIMER_SETS), default="A")
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO; default: none")
    parser.add_argument("--peer", action="store_true", help="speak to other peers directly")
    options = parser.parse_args(argv)
    store = CheckedStore(options.memory, TrainMemory)
    found = TrainMemory() if store.state is NvramState.ABSENT else store.value
    clock = WallClock()
    core = TrainCore(
        config_of(options.timers),
        LINE,
        address=options.address,
        memory=found,
        start_ns=clock.now_ns(),
    )
    radio = LineRadio(core, LINE.name, store.put)
    with (
        open_peer(options.endpoint, None, radio.subscriptions, clock)
        if options.peer
        else open_radio(SessionRole.TRAIN, options.endpoint, radio.subscriptions, clock)
    ) as port:
        if options.priority:
            enter_realtime(options.priority)
        _run(options.address, clock, radio, port)
    return 0


def _run(address: int, clock: WallClock, radio: LineRadio, port: TunableRadioPort) -> None:
    front_m = front_of(address)
    rear_m = front_m - LENGTH_M
    own = OwnTrain(True, front_m, front_m, rear_m, rear_m, 0.0, True, front_m, front_m, AXLES)
    beat_ns = cycle_ns = clock.now_ns()
    told = (0, 0)
    garbage_ns = beat_ns
    while True:
        if beat_ns >= garbage_ns:
            garbage_ns = beat_ns + GARBAGE_NS
            collect_garbage(beat_ns)
        beat_ns = max(beat_ns + BEAT_NS, clock.now_ns() - BEAT_NS)
        clock.wait_until(beat_ns)
        now_ns = clock.now_ns()
        radio.takes(port.receive(now_ns))
        apply = now_ns >= cycle_ns
        if apply:
            cycle_ns = max(cycle_ns + CYCLE_NS, now_ns)
        elif not radio.is_due(now_ns):
            continue
        for key, payload in radio.step(now_ns, own, apply=apply):
            port.send(now_ns, key, payload)
        radio.tune(port)
        held = radio.authority
        role = radio.roles.get(1)
        if held is not None and (held.term, held.sequence) != told:
            told = (held.term, held.sequence)
            line = [now_ns, held.term, held.echo_ns, "" if role is None else role.value]
            print(json.dumps(line), flush=True)


if __name__ == "__main__":
    sys.exit(main())
