"""`vobc device`: the bare controller in real time on a bus, for a plant or a real train."""

import argparse
import json
import traceback
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

from firmware_py.arguments import of_file, words_of
from firmware_py.assertions import require_assertions
from firmware_py.buses import BusError, open_can
from firmware_py.clock.clock import REALTIME_SPIN_S, WallClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.clock.realtime import (
    RealtimeReport,
    collect_garbage,
    die_with_parent,
    enter_realtime,
)
from firmware_py.clock.watchdog import ProcessWatchdog
from firmware_py.interrupts import Interrupts
from firmware_py.ports import RadioPort, SerialPort
from firmware_py.radio.recorded_radio import RecordedRadio
from firmware_py.radio.zenoh_radio import RadioError, SessionRole, open_radio
from firmware_py.settings import SettingsError
from firmware_py.storage.nvram import NvramState
from firmware_py.storage.port_log import PORTS_LOG, PortLog
from firmware_py.storage.recorder import LineLog, Lossy, RadioLog, SerialLog, loss_text, lost_lines
from firmware_py.storage.whole_file import write_whole
from firmware_py.tag_reader.recorded_line import RecordedLine
from vobc.cli import grant
from vobc.cli.host import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_USAGE,
    PatientLine,
    ProtectionNotices,
    say,
)
from vobc.cli.line import LINE_LOG, open_line
from vobc.cli.options import DevicePlan, parser, plan
from vobc.process import CYCLE_COLUMNS, EVENTS_LOG, Commission, CycleLog, EventLines, VobcDevice
from vobc.process.line_command import LineCommand
from vobc.wire import RECEIVED_IDS
from zenoh_config import keys

NS_PER_S: Final = 1_000_000_000
WATCHDOG_S: Final = 1.0
"""Duration of a cycle after which it counts as hanging. The train brakes by itself after 150 ms."""
GARBAGE_MS: Final = 1000.0
"""Period of garbage collection, because a real-time run disables the automatic one."""


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, check, run. A user error gives one line."""
    require_assertions("vobc")
    words = words_of("vobc", argv)
    if words[:1] == ["grant"]:
        return grant.main(words[1:])
    if words[:1] == ["device"]:
        del words[0]
    options = parser(is_command=argv is None).parse_args(words)
    try:
        return _run(options, plan(options, WallClock().epoch_ns()))
    except SettingsError as error:
        say(str(error))
        return EXIT_USAGE
    except (BusError, RadioError) as error:
        say(str(error))
        return EXIT_ENVIRONMENT
    except OSError as error:
        say(of_file(error))
        return EXIT_ENVIRONMENT
    except Exception:
        traceback.print_exc()
        say("the controller failed; it ended with the safe output on the bus")
        return EXIT_FAILED


def _run(options: argparse.Namespace, planned: DevicePlan) -> int:
    if options.parent is not None:
        die_with_parent(options.parent)
    if planned.note:
        say(planned.note)
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock(spin_s=REALTIME_SPIN_S if options.priority else 0.0)
        out = _folder(options.out)
        recording = None if out is None else PortLog(out / PORTS_LOG)
        logs: list[Lossy] = []
        if recording is not None:
            stack.callback(recording.close)
            logs.append(recording)
        commission = _commission(planned, clock.now_ns())
        command = None
        if planned.areas is not None:
            parts = (planned.config, planned.line, planned.areas)
            said = None if out is None else RadioLog(out / LINE_LOG, commission.start_ns)
            logs += [] if said is None else [said]
            command = open_line(options, *parts, clock, stack, planned.secure, said)
        vobc = _device(planned, commission, out, recording, clock, stack, command, logs)
        executives = [vobc.executive]
        granted = None
        if options.priority:
            granted = enter_realtime(options.priority)
            garbage = Task("garbage", GARBAGE_MS, collect_garbage, offset_ms=GARBAGE_MS)
            executives.append(Executive([garbage], clock.now_ns()))
        if out is not None:
            _note(out / "realtime.json", _granted_words(granted))
        end_ns = None
        if options.duration is not None:
            end_ns = clock.now_ns() + round(options.duration * NS_PER_S)
        words = ProtectionNotices(vobc)
        watchdog = ProcessWatchdog(WATCHDOG_S)
        stack.callback(watchdog.stop)

        def until(now_ns: int) -> bool:
            watchdog.kick()
            words.tell()
            return ending.asked or (end_ns is not None and now_ns >= end_ns)

        grid_ns = clock.now_ns()
        vobc.executive.start_at(grid_ns)
        if recording is not None:
            table = replace(commission, grid_ns=grid_ns).table()
            recording.start(table, vobc.executive, virtual=False)
        run(executives, clock, until)
        watchdog.stop()
        vobc.stop(clock.now_ns())
    if out is not None:
        lost = lost_lines(logs)
        _write_json(out / "vobc.json", {**_summary(vobc), "lost_log_lines": lost})
        if lost:
            say(loss_text(lost))
            return EXIT_ENVIRONMENT
    if ending.by_keyboard:
        say("ended by Ctrl-C; the brakes are on")
    return ending.exit_code


def _commission(planned: DevicePlan, start_ns: int) -> Commission:
    return Commission(
        config=planned.config,
        line=planned.line,
        mission=planned.mission,
        nvram=planned.nvram.record,
        start_ns=start_ns,
        start=planned.start,
        forgotten=planned.nvram.state is NvramState.CORRUPT,
    )


def _device(
    planned: DevicePlan,
    commission: Commission,
    out: Path | None,
    recording: PortLog | None,
    clock: WallClock,
    stack: ExitStack,
    command: LineCommand | None,
    logs: list[Lossy],
) -> VobcDevice:
    """Open everything. The stack closes it, the bus last. Logs are added to `logs`."""
    stack.callback(planned.nvram.close)
    can = open_can(planned.bus, clock=clock, node="VOBC", accept_ids=RECEIVED_IDS)
    stack.callback(can.close)
    log: CycleLog | None = None
    events: EventLines | None = None
    if out is not None:
        cycles = LineLog(out / "cycles.csv", CYCLE_COLUMNS)
        stack.callback(cycles.close)
        log = cycles
        events = EventLines(out / EVENTS_LOG)
        stack.callback(events.close)
        logs += [cycles, events]
    tags: SerialPort = PatientLine(planned.tags)
    if out is not None:
        serial = SerialLog(out / "serial.log", commission.start_ns)
        tags = RecordedLine(tags, serial)
        logs.append(serial)
    stack.callback(tags.close)
    train = planned.config.address
    topics = (
        keys.authorities(planned.line.name, train),
        keys.orders(planned.line.name, train),
    )
    secure = planned.secure if planned.radio == planned.line_radio else None
    radio: RadioPort = open_radio(SessionRole.TRAIN, planned.radio, topics, clock, secure=secure)
    if out is not None:
        messages = RadioLog(out / "radio.log", commission.start_ns)
        radio = RecordedRadio(radio, messages)
        logs.append(messages)
    stack.callback(radio.close)
    return commission.device(
        can=can if recording is None else recording.can(can),
        tags=tags if recording is None else recording.tags(tags),
        radio=radio if recording is None else recording.radio(radio),
        nvram=planned.nvram,
        cycle_log=log,
        event_log=events,
        command=command,
    )


def _summary(vobc: VobcDevice) -> dict[str, object]:
    """Timing of the tasks, and refused inputs."""
    return {
        "slips": vobc.slips,
        "tasks": [asdict(report) for report in vobc.executive.report()],
        "refused": vobc.refused,
    }


def _granted_words(granted: RealtimeReport | None) -> dict[str, str]:
    if granted is None:
        return {"real time": "not requested"}
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


def _note(path: Path, content: object) -> None:
    """Write an optional file. A full disk does not stop the train."""
    try:
        _write_json(path, content)
    except OSError as error:
        say(of_file(error))


def _write_json(path: Path, content: object) -> None:
    write_whole(path, json.dumps(content, indent=2) + "\n")
