"""Memory, start, logs and commission of the device, each alone and at its edges."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from can_dbc.binding import can_id
from can_dbc.vobc import AtoPhase, EventKind, Missing, OperatingMode, Supervision, VobcEvent
from firmware_py.handed_ports import HandedPorts
from firmware_py.settings import SettingsError
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.test_vobc_wire import CEILING, MOTION
from vobc.config import load_config, plan_mission
from vobc.process import (
    CYCLE_COLUMNS,
    Commission,
    EventLines,
    commissioned_start,
    read_commission,
    remembered_start,
    unknown_start,
)
from vobc.process.commission import plain
from vobc.process.cycle_log import cycle_row
from vobc.process.event_log import EventQueue
from vobc.process.identity import Identity, identity_of
from vobc.process.line_silence import LineSilence
from vobc.vocabulary import SAFE_OUTPUT, Event, OdometryRecord, PlaceProof, Source
from vobc.wire import Evidence

LINE = load_line("florence")
CONFIG = load_config("florence4")
MISSION = plan_mission(LINE, "II", "IV")
SURVEY, OTHER_SURVEY = 0xB << 60, 0xA << 60
VITAL, OTHER_VITAL = 0xD << 60, 0xC << 60
OWN = Identity(train=7, line="florence", database=SURVEY, parameters=VITAL, software="1.0")
STORED = NvramRecord(
    boot_count=3, wheel_diameter_m=0.84, front_m=1234.0, standing=True, highest_term=9,
    emergency_count=2, train=7, line="florence", database=SURVEY, parameters=VITAL, software="1.0",
)  # fmt: skip
S = 1_000_000_000


@pytest.mark.parametrize(
    ("change", "says", "keeps_term"),
    [
        ({"train": 8}, "it belongs to train 8, this is train 7", 9),
        ({"train": 0}, "it belongs to train 0, this is train 7", 9),
        ({"line": "hefei"}, "it belongs to line hefei, this is line florence", 0),
        (
            {"database": OTHER_SURVEY},
            "it belongs to another survey of line florence: a0000000, this is b0000000",
            9,
        ),
        (
            {"parameters": OTHER_VITAL},
            "it belongs to other vital parameters: c0000000, these are d0000000",
            9,
        ),
        ({"software": "0.9"}, "software 0.9 stored it, this is 1.0", 9),
    ],
)
def test_a_memory_of_another_identity_gives_no_place_and_says_why(
    change: dict[str, Any], says: str, keeps_term: int
) -> None:
    foreign = replace(STORED, **change)

    assert OWN.foreign(foreign) == says
    assert OWN.own(foreign) == replace(
        foreign, wheel_diameter_m=None, front_m=None, standing=False, highest_term=keeps_term
    )


def test_a_memory_of_this_identity_or_of_none_is_kept() -> None:
    for record in (STORED, NvramRecord(boot_count=4)):
        assert OWN.foreign(record) == ""
        assert OWN.own(record) is record
    assert OWN.foreign(replace(STORED, train=8, front_m=None)).startswith("it belongs to train 8")
    assert OWN.stamped(NvramRecord(boot_count=4)) == NvramRecord(
        boot_count=4, train=7, line="florence", database=SURVEY, parameters=VITAL, software="1.0"
    )


def test_the_identity_has_train_line_and_vital_parameters() -> None:
    own = identity_of(CONFIG, LINE)
    weaker = replace(CONFIG, atp=replace(CONFIG.atp, guaranteed_decel_mps2=0.9))

    assert (own.train, own.line) == (CONFIG.address, "florence")
    assert identity_of(weaker, LINE).parameters != own.parameters
    assert identity_of(replace(CONFIG, cycle_ms=20.0), LINE) == own
    surveyed = replace(LINE, gradients=LINE.gradients[1:])
    assert identity_of(CONFIG, surveyed).database != own.database


def test_each_start_knows_its_place_as_well_as_its_proof_allows() -> None:
    own = identity_of(CONFIG, LINE)
    stood = own.stamped(NvramRecord(front_m=1234.0, standing=True, wheel_diameter_m=0.84))
    scale: Any = pytest.approx(math.pi * 0.84 / 256)

    set_up = commissioned_start(CONFIG, LINE, MISSION, stood)
    back = remembered_start(CONFIG, LINE, stood)
    lost = unknown_start(CONFIG, LINE, stood)

    assert set_up == OdometryRecord(MISSION.start.stop_m, 0.5, scale, PlaceProof.SET_UP)
    assert back == OdometryRecord(1234.0, 2.0, scale, PlaceProof.REMEMBERED)
    assert lost.proof is PlaceProof.UNKNOWN
    assert lost.front_m - lost.bound_m == LINE.start_m
    assert lost.front_m + lost.bound_m == LINE.end_m
    other = replace(stood, line="hefei")
    assert remembered_start(CONFIG, LINE, other) is None
    nominal = pytest.approx(math.pi * CONFIG.train.wheel_diameter_m / 256)
    assert unknown_start(CONFIG, LINE, other).m_per_pulse == nominal
    for gone in (replace(stood, front_m=None), replace(stood, standing=False)):
        assert remembered_start(CONFIG, LINE, gone) is None


ROW = {
    "t_s": 1.5, "front_low_m": 99.0, "front_m": 100.0, "front_high_m": 101.5, "speed_mps": 10.0,
    "speed_high_mps": 10.2, "accel_mps2": 0.1, "demand_mps2": 0.3, "target_mps": 12.0,
    "permitted_mps": 15.0, "warning_mps": 16.0, "service_mps": 17.0, "emergency_mps": 18.0,
    "distance_to_stop_m": 77.0, "distance_to_authority_m": 400.0, "mode": OperatingMode.AUTHORISED,
    "supervision": Supervision.WARNING, "phase": AtoPhase.RUNNING, "missing": "DOORS|ALARMS",
    "cause": "why", "force_n": 5e4, "decel_mps2": 0.2, "emergency_released": True,
    "holding_released": False, "doors_enabled": True, "tags": "7 8", "slip": True,
    "work_us": 321.0, "lateness_us": 12.0, "slips": 2,
}  # fmt: skip
OUTPUT = replace(
    SAFE_OUTPUT, motion=replace(MOTION, accepted_tag_ids=(7, 8), slip=True), ceiling=CEILING,
    accel_demand_mps2=0.3, target_mps=12.0, distance_to_stop_m=77.0, mode=OperatingMode.AUTHORISED,
    supervision=Supervision.WARNING, ato_phase=AtoPhase.RUNNING,
    missing=Missing.DOORS | Missing.ALARMS, cause="why", force_n=5e4, service_decel_mps2=0.2,
    emergency_released=True, enable_right=True,
)  # fmt: skip


def row(**changes: Any) -> dict[str, object]:
    output = replace(OUTPUT, **changes)
    values = cycle_row(1.5, output, work_us=321.0, lateness_us=12.0, slips=2)
    return dict(zip(CYCLE_COLUMNS, values, strict=True))


def test_a_row_of_the_cycle_log_has_each_value_in_its_column() -> None:
    assert tuple(ROW) == CYCLE_COLUMNS
    assert row() == ROW


@pytest.mark.parametrize(
    ("changes", "columns"),
    [
        (
            {"motion": None},
            {
                **dict.fromkeys([*list(ROW)[1:7]]),
                "tags": "",
                "slip": False,
            },
        ),
        ({"ceiling": None}, dict.fromkeys([*list(ROW)[9:13], "distance_to_authority_m"])),
        ({"distance_to_stop_m": math.inf}, {"distance_to_stop_m": None}),
        ({"distance_to_stop_m": math.inf, "ceiling": None},
         dict.fromkeys([*list(ROW)[9:13], "distance_to_stop_m", "distance_to_authority_m"])),
        ({"missing": Missing.NOTHING}, {"missing": ""}),
        ({"enable_right": False}, {"doors_enabled": False}),
        ({"enable_right": False, "enable_left": True}, {"doors_enabled": True}),
    ],
)  # fmt: skip
def test_a_value_that_is_unknown_in_a_cycle_is_an_empty_field(
    changes: dict[str, Any], columns: dict[str, object]
) -> None:
    assert row(**changes) == {**ROW, **columns}


class Lines:
    """An event log in memory."""

    def __init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self.flushed = 0

    def event(self, entry: dict[str, Any]) -> None:
        self.entries.append(entry)

    def flush(self) -> None:
        self.flushed += 1


def look(source: Source, number: int) -> Evidence | None:
    return None if source is Source.CLOCK else Evidence(source, number + 1, b"\x0a\xff", 3 * S)


def test_an_event_in_the_log_has_its_number_its_time_and_its_sources() -> None:
    log = Lines()
    queue = EventQueue(log, look, 1 * S)
    queue.tell(2 * S, [Event(EventKind.OVERRUN, "late")])

    queue.tell(
        2001 * S + 1234, [Event(EventKind.TAG_ACCEPTED, "tag", (Source.TAG, Source.CLOCK), 204)]
    )

    assert queue.told == 2
    assert [each["number"] for each in log.entries] == [1, 2]
    assert log.entries[1] == {
        "t_s": 2000.000001, "number": 2, "kind": "TAG_ACCEPTED", "words": "tag", "value": 204,
        "sources": [
            {"source": "tag telegram", "id": 205, "payload": "0aff", "heard_s": 2.0},
            {"source": "clock"},
        ],
    }  # fmt: skip
    queue.flush()
    assert log.flushed == 1


def test_events_wait_for_the_bus_four_at_a_time_and_the_last_256_of_them() -> None:
    queue = EventQueue(None, look, 0)
    assert queue.due() == ()
    queue.tell(0, [Event(EventKind.OVERRUN, "late")] * 257)
    queue.flush()

    sent = [queue.due() for _ in range(65)]

    assert [len(each) for each in sent] == [4] * 64 + [0]
    first = sent[0][0]
    assert isinstance(first, VobcEvent)
    assert first.number == 2


def test_the_event_log_is_written_when_1024_lines_wait_and_when_it_closes(tmp_path: Path) -> None:
    log = EventLines(tmp_path / "events.jsonl")
    log.flush()
    for number in range(1023):
        log.event({"number": number, "words": "Straße"})
    assert len(log._lines) == 1023
    log.event({"number": 1023})
    assert log._lines == []
    log.event({"number": 1024})

    log.close()

    text = log.path.read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["number"] for line in text] == list(range(1025))
    assert "Straße" in text[0]
    assert log.lost_lines == 0
    log.event({"number": 1025})
    log.flush()
    assert log.lost_lines == 1, "after the end nothing is written"
    with pytest.raises(ValueError, match="Out of range float"):
        log.event({"number": math.nan})


def test_a_silence_of_just_5_s_is_reported_once() -> None:
    silence = LineSilence("tcp/a:1")
    assert silence.look(1 * S, 0) is None
    assert silence.look(6 * S - 1, 0) is None

    lost = silence.look(6 * S, 0)

    assert lost is not None
    assert lost.kind is EventKind.INPUT_LOST
    assert "tcp/a:1" in silence.words
    assert silence.look(7 * S, 0) is None
    back = silence.look(8 * S, 1)
    assert back == Event(EventKind.INPUT_BACK, "the line's radio is back")
    assert silence.words == ""
    assert silence.look(13 * S - 1, 1) is None
    assert silence.look(13 * S, 1) is not None


def test_arbiters_are_slow_over_the_budget_and_quick_below_nine_tenths_of_it() -> None:
    silence = LineSilence("tcp/a:1")
    assert silence.look_at_answers(0.0, 100) is None
    assert silence.look_at_answers(100.0, 100) is None

    slow = silence.look_at_answers(100.5, 100)

    assert slow == Event(EventKind.INPUT_LOST, "arbiters answer after 100 ms, need < 100")
    assert silence.slow == slow.words
    assert silence.look_at_answers(500.0, 100) is None
    assert silence.look_at_answers(90.0, 100) is None
    assert silence.look_at_answers(89.9, 100) == Event(
        EventKind.INPUT_BACK, "arbiters answer after 90 ms"
    )
    assert silence.slow == ""


STANDING = OdometryRecord(1500.0, 2.0, 0.01, PlaceProof.REMEMBERED)
COMMISSION = Commission(
    CONFIG, LINE, MISSION, NvramRecord(boot_count=7), start_ns=5, start=STANDING, grid_ns=11,
    forgotten=True,
)  # fmt: skip


@pytest.mark.parametrize(
    "commission", [COMMISSION, replace(COMMISSION, start=None, forgotten=False)]
)
def test_a_commission_comes_back_from_its_table(commission: Commission) -> None:
    table = json.loads(json.dumps(commission.table()))

    assert read_commission(table, "ports.log") == commission
    assert table["mission"] == {"start": "II", "stops": ["III", "IV"]}
    assert (table["standing"] is None) is (commission.start is None)


def test_without_a_grid_the_tasks_start_with_the_controller() -> None:
    free = Commission(CONFIG, LINE, MISSION, COMMISSION.nvram, 5)

    assert (free.start, free.forgotten) == (None, False)
    assert free.table()["grid_ns"] == 5
    assert read_commission(free.table(), "ports.log") == replace(free, grid_ns=5)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"start_ns": "now"}, "ports.log: start_ns: 'now' is no instant"),
        ({"grid_ns": None}, "ports.log: grid_ns: None is no instant"),
        ({"mission": None}, "ports.log: mission: missing table"),
        ({"memory": []}, "ports.log: memory: missing table"),
        ({"mission": {"start": "II", "stops": ["Oz"]}}, "ports.log: mission: .*Oz"),
        ({"memory": {"boot_count": 7, "colour": 1}}, "ports.log: memory.*colour"),
    ],
)
def test_a_wrong_commission_is_refused_with_file_key_and_value(
    change: dict[str, Any], says: str
) -> None:
    with pytest.raises(SettingsError, match=says):
        read_commission({**COMMISSION.table(), **change}, "ports.log")


def test_keys_of_a_later_version_are_left_out_and_named() -> None:
    table = json.loads(json.dumps(COMMISSION.table()))
    table["memory"]["colour"] = 1
    table["line"]["stations"][1]["shops"] = 3
    table["params"]["atp"]["timeouts"]["tea_s"] = 5.0
    table["params"]["train"]["doors"] = {"left": 1}
    left_out: list[str] = []

    found = read_commission(table, "ports.log", left_out)

    assert found == COMMISSION
    assert sorted(left_out) == [
        "line.stations[1].shops",
        "memory.colour",
        "params.atp.timeouts.tea_s",
        "params.train.doors",
    ]


@pytest.mark.parametrize(("key", "value"), [("train", 5), ("cycle_ms", {"a": 1})])
def test_a_part_of_a_wrong_kind_is_refused_also_where_keys_may_be_left_out(
    key: str, value: object
) -> None:
    table = COMMISSION.table()
    table["params"][key] = value

    with pytest.raises(SettingsError, match=rf"ports\.log: params\.{key}"):
        read_commission(table, "ports.log", [])


def test_plain_values_are_those_of_json() -> None:
    assert plain(PlaceProof.SET_UP) == "set_up"
    assert plain((1, [PlaceProof.UNKNOWN])) == [1, ["unknown"]]
    assert plain(STANDING)["front_m"] == 1500.0
    assert plain(STANDING)["proof"] == "remembered"
    assert "wheel_diameter_m" not in plain(NvramRecord())


def test_a_commission_makes_its_device() -> None:
    ports, log = HandedPorts(), Lines()
    wires: Any = {"can": ports.can, "tags": ports.tags, "radio": ports.radio}

    device = COMMISSION.device(**wires, event_log=log)
    given = Nvram(None, NvramRecord(boot_count=40))
    COMMISSION.device(**wires, nvram=given)

    assert [each["kind"] for each in log.entries] == ["MEMORY_LOST"]
    assert device._nvram.record.boot_count == 8
    assert given.record.boot_count == 41
    assert device.executive.next_due_ns() >= 11
    free = replace(COMMISSION, grid_ns=None).device(**wires)
    assert free.executive.next_due_ns() == 5
    assert can_id(VobcEvent)
