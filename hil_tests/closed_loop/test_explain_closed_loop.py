"""Events of whole runs: on the bus and in the log, each with frames that were really sent."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from can_dbc import binding
from can_dbc.codec import Decoder
from can_dbc.vobc import EventKind, VobcEvent
from metro_hil.cli.vobc import main
from metro_hil.model.run_folder import RunFolder
from metro_hil.report.explain.bus_log import located
from metro_hil.report.explain.event_log import read_story
from metro_hil.report.explain.known import known_at

Sent = tuple[float, int, bytes]
TICK_S = 1e-3
"""Resolution of the log's stamps, which are truncated to microseconds, as a tolerance in s."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run from II to III in virtual time."""
    path = tmp_path_factory.mktemp("explain") / "run"
    assert main(["run", "--lockstep", "--from", "II", "--to", "III", "--out", str(path)]) == 0
    return path


def on_the_bus(folder: Path) -> list[Sent]:
    frames = []
    for line in (folder / "bus.log").read_text(encoding="ascii").splitlines():
        stamp, _, frame = line.split(" ")
        can_id, _, data = frame.partition("#")
        frames.append((float(stamp.strip("()")), int(can_id, 16), bytes.fromhex(data)))
    return frames


def test_the_bus_carries_the_same_events_as_the_log(folder: Path) -> None:
    decoder = Decoder([VobcEvent])
    heard = [
        decoder.decode(can_id, data, 0)
        for _, can_id, data in on_the_bus(folder)
        if can_id == binding.can_id(VobcEvent)
    ]

    told = read_story(folder).events

    assert len(told) > 10
    assert [(each.event.name, each.number, each.cause) for each in heard
            if isinstance(each, VobcEvent)] == [
        (each.kind, each.number, each.value) for each in told
    ]  # fmt: skip


def test_every_frame_named_by_an_event_was_on_the_bus_before_it(folder: Path) -> None:
    frames: dict[tuple[int, bytes], list[float]] = {}
    for stamp_s, can_id, data in on_the_bus(folder):
        frames.setdefault((can_id, data), []).append(stamp_s)
    known = {kind.name for kind in EventKind}
    checked: Counter[str] = Counter()

    for event in read_story(folder).events:
        assert event.kind in known
        for source in event.sources:
            if source.number is None or not source.source.isupper():
                continue
            assert source.heard_s is not None
            assert source.heard_s <= event.t_s
            stamps_s = frames[source.number, source.payload]
            assert any(abs(stamp_s - source.heard_s) <= TICK_S for stamp_s in stamps_s)
            checked[source.source] += 1

    assert len(checked) >= 6


def test_every_frame_named_by_an_event_is_in_the_bus_log(folder: Path) -> None:
    lines = (folder / "bus.log").read_text(encoding="ascii").splitlines()
    found = 0

    for event in located(read_story(folder)).events:
        for source in event.sources:
            if source.number is None or not source.source.isupper():
                continue
            assert source.frame is not None
            assert source.heard_s is not None
            stamp, _, frame = lines[source.frame - 1].split(" ")
            assert frame == f"{source.number:03X}#{source.payload.hex().upper()}"
            assert abs(float(stamp.strip("()")) - source.heard_s) <= TICK_S
            found += 1

    assert found > 20


def test_a_driverless_run_has_a_complete_event_log(folder: Path) -> None:
    kinds = Counter(event.kind for event in read_story(folder).events)

    assert kinds["EMERGENCY_APPLIED"] == kinds["SERVICE_BRAKE"] == 0
    assert kinds["DOORS_ENABLED"] == 1
    assert kinds["TAG_ACCEPTED"] >= 5
    assert kinds["MODE"] >= 2


def test_the_same_run_has_the_same_event_log(folder: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    main(["run", "--lockstep", "--from", "II", "--to", "III", "--out", str(again)])

    for name in ("events.jsonl", "bus.log"):
        assert (again / name).read_bytes() == (folder / name).read_bytes()


def test_the_inputs_of_an_event_fit_its_cycle(folder: Path) -> None:
    known = known_at(RunFolder(folder), 30.01)

    assert float(known.cycle["t_s"]) == pytest.approx(30.0)
    ages_s = {heard.name.split(" ", 1)[1]: 30.0 - heard.at_s for heard in known.heard}
    for kind in binding.kinds():
        name = binding.message(kind).name
        if name in ages_s:
            assert 0.0 <= ages_s[name] <= binding.period_s(kind) + 0.02, name
    assert {"TACHO", "BRAKE_STATUS", "DESK"} <= set(ages_s)


def test_json_is_one_object_on_standard_output(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", str(folder), "--json"]) == 0

    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert document["line"] == "florence"
    assert document["stations"] == ["II", "III"]
    assert document["arrived"]
