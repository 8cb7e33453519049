"""The log of a controller's ports: written entries are read back, and damage is named."""

from pathlib import Path

import pytest

from firmware_py.clock.executive import Executive, Task
from firmware_py.handed_ports import HandedPorts
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from firmware_py.storage.nvram import NvramRecord
from firmware_py.storage.port_log import PORTS_LOG, PortLog
from firmware_py.trackdb import load_line
from hil_tests.native_rig import in_both_languages  # noqa: F401
from metro_hil.replay import RecordingError, read_recording
from metro_hil.replay.recording import Output, parse_recording
from vobc.config import load_config, plan_mission
from vobc.process import Commission, read_commission
from vobc.vocabulary import OdometryRecord

FRAMES = [
    CanFrame(1_000_001, 0x185, bytes.fromhex("E6BF")),
    CanFrame(1_000_002, 0x7FF, b""),
    CanFrame(1_000_003, 0x1234567, b"\x01", extended=True),
    CanFrame(1_000_004, 0x123, b"\x00\x00", remote=True),
    CanFrame(1_000_005, 0x20, b"\xff", error=True),
]
CHUNK = SerialChunk(1_500_001, b"\x7e\x01")
MESSAGE = RadioMessage(1_700_001, "m/florence/w/0/ma/1/1", b"\x01\x02")


def commission(start: OdometryRecord | None = None) -> Commission:
    line = load_line("florence")
    mission = plan_mission(line, "II", "IV")
    memory = NvramRecord(boot_count=7, wheel_diameter_m=0.8512345678901234)
    return Commission(load_config("florence4"), line, mission, memory, 5, start, grid_ns=11)


def record(path: Path) -> None:
    """Record a controller with one task that receives and sends one message of each kind and
    then ends."""
    log, handed = PortLog(path / PORTS_LOG), HandedPorts()
    can, tags, radio = log.can(handed.can), log.tags(handed.tags), log.radio(handed.radio)

    def cycle(now_ns: int) -> None:
        can.receive(now_ns)
        tags.receive(now_ns)
        radio.receive(now_ns)
        can.send(now_ns, 0x101, b"\xd0\x57")
        tags.send(now_ns, b"\x05")
        radio.send(now_ns, "m/florence/w/1/st/1", b"\x0a")

    executive = Executive([Task("control", 50.0, cycle)], 11)
    log.start(commission().table(), executive, virtual=True)
    handed.hand(FRAMES, [CHUNK], [MESSAGE])
    executive.run_next(2_000_000, 412)
    can.send(9_000_000, 0x101, b"")
    can.send(9_000_000, 0x102, b"")
    log.close()


def test_everything_that_passed_the_ports_is_read_back_unchanged(tmp_path: Path) -> None:
    record(tmp_path)

    recording = read_recording(tmp_path)

    (segment,) = recording.segments
    cycle, stop = segment.steps
    assert recording.complete
    assert segment.virtual
    assert segment.commission == commission()
    assert (cycle.task, cycle.begin_ns, cycle.execution_ns) == ("control", 2_000_000, 412)
    assert cycle.frames == FRAMES
    assert cycle.chunks == [CHUNK]
    assert cycle.messages == [MESSAGE]
    assert cycle.outputs == [
        Output("can", "101", b"\xd0\x57"),
        Output("tags", "", b"\x05"),
        Output("radio", "m/florence/w/1/st/1", b"\x0a"),
    ]
    assert (stop.task, stop.begin_ns) == ("stop", 9_000_000)
    assert stop.outputs == [Output("can", "101", b""), Output("can", "102", b"")]


@pytest.mark.parametrize("start", [None, OdometryRecord(12.5, 2.0, 0.0105)])
def test_the_commission_of_a_controller_is_read_back_unchanged(
    start: OdometryRecord | None,
) -> None:
    told = commission(start)

    assert read_commission(told.table(), "here") == told


def test_an_older_version_ignores_unknown_entries() -> None:
    table = commission().table()
    table["params"]["atp"]["later_m"] = 1.0
    table["line"]["stations"][0]["colour"] = "red"
    left_out: list[str] = []

    known = read_commission(table, "hello", left_out)

    assert known == commission()
    assert left_out == ["line.stations[0].colour", "params.atp.later_m"]


def test_a_killed_recorder_loses_its_last_step_only(tmp_path: Path) -> None:
    record(tmp_path)
    whole = (tmp_path / PORTS_LOG).read_bytes()
    cut = whole[: whole.index(b"\nstop") + 3]

    recording = parse_recording(Path("ports.log"), cut)

    assert not recording.complete
    assert [step.task for step in recording.segments[0].steps] == []


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda data: data.replace(b"rx tags", b"rx tugs"), ["line 8", "rx tugs"]),
        (lambda data: data.replace(b" E6BF", b" E6B"), ["line 3", "E6B"]),
        (lambda data: data.replace(b"rx tags 1500001 7E01\n", b""), ["line", "must follow"]),
        (lambda data: data.replace(b'"version": 1', b'"version": 9'), ["line 1", "version 9"]),
        (lambda data: data.split(b"\n", 1)[1], ["line 1", "no start of a controller"]),
        (lambda data: data + b"run control 5 5\n", ["follows the end"]),
        (lambda data: b"", ["no start of a controller"]),
        (lambda data: data.replace(b'"cycle_ms"', b'"cycle_mm"'), ["line 1", "cycle_mm"]),
    ],
)
def test_damage_is_named_with_its_line(tmp_path: Path, damage, words: list[str]) -> None:  # type: ignore[no-untyped-def]
    record(tmp_path)
    path = tmp_path / PORTS_LOG
    path.write_bytes(damage(path.read_bytes()))

    with pytest.raises(Exception, match=str(path)) as complaint:
        read_recording(tmp_path)

    for word in words:
        assert word in str(complaint.value)


def test_a_folder_without_a_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path)


def test_a_task_that_wakes_itself_runs_at_its_instant(tmp_path: Path) -> None:
    ran: list[int] = []

    def run(now_ns: int) -> int:
        ran.append(now_ns)
        return now_ns + (3 if len(ran) % 2 else 0)

    executive = Executive.woken("grant", run, 4)

    began = [executive.run_next(now_ns) for now_ns in range(9)]

    assert ran == [4, 7, 8]
    assert began.count("grant") == 3
