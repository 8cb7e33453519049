"""`python -m vobc`: the bare controller in real time on a bus, for a plant or a real train."""

import argparse
import json
import os
import signal
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Final

from firmware_py import rendezvous
from firmware_py.assertions import require_assertions
from firmware_py.buses import BusError, open_can, parse_spec, resolve_auto
from firmware_py.clock import WallClock
from firmware_py.executive import Executive, Task, run
from firmware_py.nvram import Nvram, NvramRecord
from firmware_py.ports import LinkCounters, SerialChunk, SerialPort
from firmware_py.radio.zenoh_radio import DEFAULT_ENDPOINT, RadioError, Role, open_radio
from firmware_py.realtime import (
    RealtimeReport,
    collect_garbage,
    die_with_parent,
    enter_realtime,
)
from firmware_py.recorder import LineLog, RecorderError
from firmware_py.settings import SettingsError
from firmware_py.tag_reader.serial_line import SerialError, open_serial
from firmware_py.trackdb import LineMap, load_line
from vobc.config import CYCLE_MS_MAX, CYCLE_MS_MIN, VobcConfig, load_config, plan_mission
from vobc.process import CYCLE_COLUMNS, CycleLog, VobcDevice, remembered_start
from vobc.vocabulary import SAFE_OUTPUT, Mission, OdometryRecord
from vobc.wire import HEARD_IDS
from zenoh_config import keys

EXIT_OK: Final = 0
EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_ENVIRONMENT: Final = 3
EXIT_INTERRUPTED: Final = 130

AUTO: Final = "auto"
NS_PER_S: Final = 1_000_000_000
RETRY_NS: Final = 500_000_000
PRIORITY_MAX: Final = 99
GARBAGE_MS: Final = 1000.0
"""Between collections, since none comes by itself on a real-time run."""
_ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)

EPILOG: Final = """\
The controller stays braked until everything that it needs is heard, and says what it waits for.
exit codes: 0 ended by SIGTERM or after --duration; 1 the controller failed and braked; 2 wrong
usage or configuration; 3 bus, rights or a folder missing; 130 ended by Ctrl-C
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = argparse.ArgumentParser(
        prog="python -m vobc",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("verb", nargs="?", choices=("run",), default="run", help="default: run")
    top.add_argument("--bus", default=AUTO, metavar="SPEC", help="auto, socketcan:can0, ...")
    top.add_argument("--tags", default=AUTO, metavar="DEVICE", help="such as /dev/ttyUSB0")
    top.add_argument("--radio", default=AUTO, metavar="ENDPOINT", help="tcp/HOST:PORT")
    top.add_argument("--line", default="florence", metavar="NAME|FILE", help="default: florence")
    top.add_argument(
        "--consist", default="florence4", metavar="NAME|FILE", help="parameters of the train"
    )
    top.add_argument("--from", dest="start", metavar="STATION", help="where the train stands")
    top.add_argument("--to", dest="end", metavar="STATION", help="default: the last of the line")
    top.add_argument("--cycle-ms", type=_cycle_ms, metavar="MS", help="default: as parameters say")
    top.add_argument("--duration", type=_seconds, metavar="SECONDS", help="end after so long")
    top.add_argument("--priority", type=_priority, default=80, help="of SCHED_FIFO; 0: none")
    top.add_argument("--out", metavar="FOLDER", help="for cycles.csv, realtime.json, vobc.json")
    top.add_argument("--nvram", metavar="FILE", help="default: nothing survives a power cycle")
    return top


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that can be checked before the first device is opened."""

    config: VobcConfig
    line: LineMap
    mission: Mission
    nvram: Nvram
    start: OdometryRecord | None
    bus: str
    tags: str
    radio: str


def plan(options: argparse.Namespace, epoch_ns: int) -> Plan:
    """Raises SettingsError or BusError for what cannot be.

    A board without a memory takes the time of day for its boot count: it has to grow with each
    start, or the wayside would take the new incarnation for messages out of order.
    """
    config = load_config(options.consist, cycle_ms=options.cycle_ms)
    line = load_line(options.line)
    nvram = Nvram(options.nvram, NvramRecord(boot_count=epoch_ns // NS_PER_S))
    start, first = None, options.start
    if first is None and (start := remembered_start(config, nvram.record)) is not None:
        first = _nearest_station(line, start.front_m)
    mission = plan_mission(line, first, options.end)
    bus = _bus(options.bus)
    name = parse_spec(bus).name
    tags, radio = options.tags, options.radio
    if tags == AUTO:
        tags = str(rendezvous.tags_link(name))
    if radio == AUTO:
        radio = rendezvous.read_radio(name) or DEFAULT_ENDPOINT
    return Plan(config, line, mission, nvram, start, bus, tags, radio)


def _nearest_station(line: LineMap, front_m: float) -> str:
    return min(line.stations, key=lambda station: abs(station.stop_m - front_m)).name


def _bus(wanted: str) -> str:
    if wanted != AUTO:
        return wanted
    choice = resolve_auto()
    if choice.spec is None:
        raise BusError(f"no bus: {choice.reason}; `vcan up` makes one")
    return choice.spec


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, check, run; whatever the user got wrong is one line."""
    require_assertions("vobc")
    options = parser().parse_args(argv)
    try:
        return _run(options, plan(options, WallClock().epoch_ns()))
    except SettingsError as error:
        _say(str(error))
        return EXIT_USAGE
    except (BusError, RadioError, RecorderError, OSError) as error:
        _say(str(error))
        return EXIT_ENVIRONMENT
    except Exception:
        traceback.print_exc()
        _say("the controller failed; its last word on the bus was the safe output")
        return EXIT_FAILED


def _run(options: argparse.Namespace, planned: Plan) -> int:
    die_with_parent(os.getppid())
    ending = Ending()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock()
        out = _folder(options.out)
        vobc = _device(planned, out, clock, stack)
        executives = [vobc.executive]
        granted = None
        if options.priority:
            granted = enter_realtime(options.priority)
            garbage = Task("garbage", GARBAGE_MS, collect_garbage, offset_ms=GARBAGE_MS)
            executives.append(Executive([garbage], clock.now_ns()))
        if out is not None:
            _write_json(out / "realtime.json", _granted_words(granted))
        end_ns = None
        if options.duration is not None:
            end_ns = clock.now_ns() + round(options.duration * NS_PER_S)
        words = Words(vobc)

        def until(now_ns: int) -> bool:
            words.tell()
            return ending.asked or (end_ns is not None and now_ns >= end_ns)

        run(executives, clock, until)
        vobc.stop(clock.now_ns())
        if out is not None:
            _write_json(out / "vobc.json", _summary(vobc))
    return ending.exit_code


def _device(
    planned: Plan,
    out: Path | None,
    clock: WallClock,
    stack: ExitStack,
) -> VobcDevice:
    """Open everything. What is opened is closed by the stack, the bus last."""
    stack.callback(planned.nvram.close)
    can = open_can(planned.bus, clock=clock, node="VOBC", accept_ids=HEARD_IDS)
    stack.callback(can.close)
    log: CycleLog | None = None
    if out is not None:
        cycles = LineLog(out / "cycles.csv", CYCLE_COLUMNS)
        stack.callback(cycles.close)
        log = cycles
    tags = PatientLine(planned.tags)
    stack.callback(tags.close)
    topics = (keys.authorities(planned.line.name, planned.config.address),)
    radio = open_radio(Role.TRAIN, planned.radio, topics, clock)
    stack.callback(radio.close)
    return VobcDevice(
        planned.config,
        planned.line,
        planned.mission,
        can=can,
        tags=tags,
        radio=radio,
        nvram=planned.nvram,
        cycle_log=log,
        start_ns=clock.now_ns(),
        start=planned.start,
    )


class PatientLine:
    """A serial line that may not be there yet: a train that waits is braked, not broken."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._line: SerialPort | None = None
        self._retry_ns = 0
        self._counters = LinkCounters()
        self.error = ""
        """Why it is not open; empty when it is."""

    @property
    def counters(self) -> LinkCounters:
        return self._counters if self._line is None else self._line.counters

    def send(self, now_ns: int, data: bytes) -> None:
        if self._line is not None:
            self._line.send(now_ns, data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        if self._line is None and now_ns >= self._retry_ns:
            self._retry_ns = now_ns + RETRY_NS
            self._open()
        return () if self._line is None else self._line.receive(now_ns)

    def _open(self) -> None:
        try:
            self._line = open_serial(self._path)
            self.error = ""
        except SerialError as error:
            self._counters.errors += 1
            if str(error) != self.error:
                self.error = str(error)
                _say(f"waits for the tag reader: {error}")

    def close(self) -> None:
        if self._line is not None:
            self._line.close()


class Ending:
    """SIGINT and SIGTERM as a wish that the loop looks at."""

    def __init__(self) -> None:
        self.exit_code = EXIT_OK
        self.asked = False

    @contextmanager
    def caught(self) -> Iterator[None]:
        before = [(number, signal.signal(number, self._ask)) for number in _ENDING_SIGNALS]
        try:
            yield
        finally:
            for number, handler in before:
                signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        self.exit_code = EXIT_INTERRUPTED if number == signal.SIGINT else EXIT_OK


class Words:
    """Says on standard error what protection does or waits for, whenever that changes."""

    def __init__(self, vobc: VobcDevice) -> None:
        self._vobc = vobc
        self._said = ""

    def tell(self) -> None:
        output = self._vobc.output
        if output is SAFE_OUTPUT:
            return
        state = output.supervision.name.lower().replace("_", " ")
        words = f"{state}: {output.cause}" if output.cause else state
        if words != self._said:
            self._said = words
            _say(words)


def _summary(vobc: VobcDevice) -> dict[str, object]:
    """How the tasks kept their rhythm, and what was not acted on."""
    return {
        "slips": vobc.slips,
        "tasks": [asdict(report) for report in vobc.executive.report()],
        "refused": vobc.refused,
    }


def _granted_words(granted: RealtimeReport | None) -> dict[str, str]:
    if granted is None:
        return {"real time": "not asked for"}
    return {
        measure.name: measure.detail if measure.granted else f"not granted, {measure.detail}"
        for measure in granted.measures
    }


def _folder(out: str | None) -> Path | None:
    if out is None:
        return None
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def _say(words: str) -> None:
    print(f"vobc: {words}", file=sys.stderr, flush=True)


def _cycle_ms(text: str) -> float:
    return _number(text, CYCLE_MS_MIN, CYCLE_MS_MAX)


def _seconds(text: str) -> float:
    return _number(text, 0.0, 1e9)


def _number(text: str, least: float, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text} is not a number in {least:g}..{most:g}")
    return value


def _priority(text: str) -> int:
    if not text.isdecimal() or int(text) > PRIORITY_MAX:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number in 0..{PRIORITY_MAX}")
    return int(text)
