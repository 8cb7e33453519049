"""J1939 messages of several sources, short and reassembled, are tables of their own."""

import tempfile
from pathlib import Path
from typing import Any

import asammdf
import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import LogError, read
from canlog.bus_model import LogPart, part_names
from canlog.command import main
from canlog.exports import SignalsMf4
from canlog.frames import EXTENDED
from canlog.reader import Log
from canlog.rows import from_rows
from canlog.table import Groups
from canlog.views.page_data import page_data
from canlog.views.traces import find_names, trace_of
from hil_tests.unit.canlog.canlog_rig import MS, bus, random_frames, write_candump
from hil_tests.unit.canlog.test_canlog_transport import broadcast, connection

DBC = """\
VERSION ""
BU_: A
BO_ 2364540158 EEC1: 8 Vector__XXX
 SG_ EngSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Vector__XXX
BO_ 2348810494 TSC1: 8 Vector__XXX
 SG_ Torque : 24|8@1+ (1,-125) [0|0] "%" Vector__XXX
BO_ 2566843646 CI: 20 Vector__XXX
 SG_ First : 0|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ Last : 152|8@1+ (0.5,0) [0|0] "kg" Vector__XXX
BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_  "VFrameFormat" "J1939PG";
"""
CI_GROUP = 2566843646 >> 8 & 0x3FFFF
RPM = {0x0CF00400: 1000, 0x0CF00403: 2000, 0x18F00403: 3000}
"""Raw speeds by identifier; source 3 sends with two priorities."""


def dbc_of(log: Path) -> Path:
    return log.parent / "x.dbc"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    sent = [(key, EXTENDED, bytes(3) + raw.to_bytes(2, "little") + bytes(3))
            for _ in range(20) for key, raw in RPM.items()]  # fmt: skip
    sent += [(0x0C00_000B, EXTENDED, bytes([0, 0, 0, 130, 0, 0, 0, 0])),
             (0x0C00_0F0B, EXTENDED, bytes([0, 0, 0, 120, 0, 0, 0, 0]))]  # fmt: skip
    for number in range(3):
        sent += broadcast(CI_GROUP, 0, bytes([number, *range(1, 19), 2 * number]))
    sent += broadcast(65226, 1, bytes(10))
    sent += connection(CI_GROUP, 5, 0xF9, bytes([77, *range(1, 19), 66]))
    frames = from_rows([(at * MS, key, flags, "can0", data)
                        for at, (key, flags, data) in enumerate(sent)])  # fmt: skip
    (tmp_path / "x.dbc").write_text(DBC)
    return write_candump(tmp_path / "x.log", frames)


def test_each_source_is_a_message_of_its_own(log: Path) -> None:
    found = read(log, dbc_of(log))

    assert list(found.messages) == [
        *("TSC1@0B-00", "TSC1@0B-0F", "EEC1@00", "EEC1@03", "CI@00", "CI@05-F9"),
    ]
    assert set(found.table("EEC1@00")["EngSpeed"].tolist()) == {125.0}
    assert set(found.table("EEC1@03")["EngSpeed"].tolist()) == {250.0, 375.0}
    assert found.table("TSC1@0B-0F")["Torque"].tolist() == [-5]
    assert len(found.table("EEC1")) == 60
    with pytest.raises(LogError, match=r"name one of EEC1@00\.EngSpeed, EEC1@03\.EngSpeed"):
        find_names(found, "EEC1.EngSpeed")
    with pytest.raises(LogError, match="no message EEC2"):
        found.table("EEC2@00")


def test_a_message_of_one_source_keeps_its_plain_name(log: Path) -> None:
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(line for line in lines if "F00403#" not in line))

    found = read(log, dbc_of(log))

    assert "EEC1" in found.messages
    assert len(found.table("EEC1")) == 20


def test_reassembled_messages_are_tables_like_others(log: Path) -> None:
    found = read(log, dbc_of(log))

    table = found.table("CI@00")
    assert (table["First"].tolist(), table["Last"].tolist()) == ([0, 1, 2], [0.0, 1.0, 2.0])
    assert [found.frames.payload(row)[0] for row in table.rows] == [3, 3, 3]
    trace = trace_of(found, "CI@05-F9.Last")
    assert (trace.values.tolist(), trace.unit) == ([33.0], "kg")


def test_the_page_names_every_source_apart(log: Path) -> None:
    """Two priorities of one source are two identifiers, which need two names in the page."""
    data = page_data(read(log, dbc_of(log)), "x", [], with_frames=True)

    names = [each["name"] for each in data.head["messages"] if each["known"]]
    assert [name for name in names if "EEC1" in name] == [
        *("EEC1@00", "EEC1@03", "EEC1@03 18F00403"),
    ]
    assert len(set(names)) == len(names)
    assert [each["name"] for each in data.head["extras"]] == [
        *("CI@00.First", "CI@00.Last", "CI@05-F9.First", "CI@05-F9.Last"),
    ]


def test_the_page_knows_which_bits_change(log: Path) -> None:
    data = page_data(read(log, dbc_of(log)), "x", [], with_frames=True)

    packets = next(each for each in data.head["messages"] if each["id"] == 0x18EB_FF00)
    # Nine packets 1 2 3 1 2 3 1 2 3: bit 0 stays from 3 to 1, bit 1 from 2 to 3.
    assert packets["flips"][:8] == [0, 0, 0, 0, 0, 0, 5, 6]
    assert packets["entropy"][0] == pytest.approx(np.log2(3), abs=1e-3)


@pytest.mark.parametrize("form", ["parquet", "csv", "npz", "mf4"])
def test_extract_writes_each_source_with_its_addresses(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    out = tmp_path / "out"

    assert main(["extract", str(log), "--dbc", str(dbc_of(log)), "-o", str(out), "--as", form]) == 0

    said, noted = capsys.readouterr()
    assert form == "npz" or noted == "canlog: 1 messages of PGN 65226 are in no DBC file\n"
    names = ("CI@00", "CI@05-F9", "EEC1@00", "EEC1@03", "TSC1@0B-00", "TSC1@0B-0F")
    if form == "mf4":
        assert all(f"signals.mf4: {name}: " in said for name in names)
        return
    assert sorted(path.name for path in out.iterdir()) == [f"{name}.{form}" for name in names]
    if form == "parquet":
        table = pyarrow.parquet.read_table(out / "CI@05-F9.parquet").to_pylist()
        assert [(row["source_address"], row["destination_address"]) for row in table] == [(5, 0xF9)]
        assert [(row["First"], row["Last"], row["channel"]) for row in table] == [
            (77, 33.0, "can0")
        ]


def test_one_source_may_be_asked_for(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["extract", str(log), "--dbc", str(dbc_of(log)), "-o", str(tmp_path / "out")]

    assert main([*words, "--message", "EEC1@03"]) == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["EEC1.parquet"]
    assert main([*words, "--message", "EEC1"]) == 0
    assert len(list((tmp_path / "out").iterdir())) == 3
    assert main([*words, "--message", "EEC9@03"]) == 2


@given(seed=st.integers(0, 1000), count=st.integers(1, 60), block=st.integers(1, 40))
@settings(max_examples=15, deadline=None)
def test_mf4_holds_the_values_of_every_signal(seed: int, count: int, block: int) -> None:
    """asammdf reads them back: scaled, signed, floats, names of states, and absent ones."""
    found = Log(Path("x.log"), random_frames(count, seed), bus())
    with tempfile.TemporaryDirectory() as folder:
        export, parts = SignalsMf4(Path(folder)), dict[LogPart, None]()
        for first in range(0, count, block):
            groups = Groups(found.frames[first : first + block])
            for key, channel in groups.places:
                part = LogPart(found.bus.name_of(key), channel)
                parts[part] = None
                export.add(part, groups.table(found.bus.by_key[key], channel))
        names = part_names(parts)
        list(export.close(names, Path(folder)))

        file: Any
        with asammdf.MDF(str(Path(folder) / "signals.mf4")) as file:
            groups_there = {
                group.channel_group.acq_name: index for index, group in enumerate(file.groups)
            }
            assert sorted(groups_there) == sorted(names.values())
            start_ns = file.header.abs_time
            for name, index in groups_there.items():
                table = found.table(name)
                for spec in table.spec.signals:
                    signal = file.get(spec.name, group=index)
                    valid = table.valid(spec.name)
                    assert signal.unit == spec.unit
                    at_ns = np.rint(signal.timestamps * 1e9).astype(np.int64) + start_ns
                    assert at_ns.tolist() == table.at_ns[valid].tolist()
                    if spec.is_state:
                        labels = np.array(table.labels(spec.name))[valid].tolist()
                        assert [str(each, "utf-8") for each in signal.samples.tolist()] == [
                            label or "" for label in labels
                        ]
                    else:
                        np.testing.assert_allclose(
                            signal.samples.astype(np.float64),
                            table[spec.name][valid].astype(np.float64),
                            rtol=1e-12,
                        )
