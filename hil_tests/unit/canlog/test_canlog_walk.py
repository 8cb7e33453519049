"""Each record of a file is either read, skipped or counted as damage."""

import random
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import ReadOptions, stream
from hil_tests.log_benchmarks.situations import SITUATIONS, Situation, by_canlog, is_right
from hil_tests.unit.canlog.test_canlog_blf import Made, contained, packed

FRAME, FOREIGN, BROKEN = "frame", "foreign", "broken"
ASC_LINES = {
    FRAME: "   0.{at:06d} 1  123             Rx   d 2 01 02",
    FOREIGN: "   0.{at:06d} 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.00%",
    BROKEN: "   0.{at:06d} 1  123             Rx   d 8 01 02",
}
TRC_LINES = {
    FRAME: "{at:7d} {at:13d}.000 DT  1     0123 Rx -  2    01 02",
    FOREIGN: "{at:7d} {at:13d}.000 ST  1     -    Rx -  4    00 00 00 04",
    BROKEN: "{at:7d} {at:13d}.000 DT  1     0123 Rx -  8    01 02",
}
CANDUMP_LINES = {
    FRAME: "({at:010d}.000000) can0 123#0102",
    FOREIGN: "({at:010d}.000000) can0 045#81:00:12345678#1122",
    BROKEN: "({at:010d}.000000) can0 123#01020",
}
GVRET_LINES = {FRAME: "{at},00000123,false,Rx,0,2,01,02", BROKEN: "{at},00000123,maybe,Rx,0,2,01"}
KVASER_LINES = {
    FRAME: " 0    00000123         2  01  02                      {at:7d}.000000 R",
    FOREIGN: "a remark of the user",
    BROKEN: " 0    00000123         8  01  02                      {at:7d}.000000 R",
}


def lines(head: str, shapes: dict[str, str]) -> Callable[[Sequence[str]], bytes]:
    """Return a writer of text logs with a line per record; a kind without a line becomes a
    frame.
    """

    def made(records: Sequence[str]) -> bytes:
        body = [shapes.get(each, shapes[FRAME]).format(at=at) for at, each in enumerate(records)]
        return (head + "".join(f"{line}\n" for line in body)).encode()

    return made


def blf(records: Sequence[str]) -> bytes:
    """Return objects in one container; a broken one is too short for a frame."""
    shapes = {
        FRAME: packed(Made(1, 5, 1, 0x123, False, False, b"\1\2", False)),
        FOREIGN: packed(Made(0, 5, 1, 0, False, False, bytes(9), False)),
        BROKEN: packed(Made(1, 5, 1, 0x123, False, False, b"\1", False))[:40],
    }
    shapes[BROKEN] = shapes[BROKEN][:8] + (40).to_bytes(4, "little") + shapes[BROKEN][12:]
    return contained(b"".join(shapes[each] for each in records), [])


ASC_HEAD = "date Tue Jan 07 01:14:48.626 pm 2020\nbase hex  timestamps absolute\n"
TRC_HEAD = ";$FILEVERSION=2.1\n;$STARTTIME=46062.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
FORMATS: Sequence[tuple[str, Callable[[Sequence[str]], bytes], set[str]]] = (
    ("x.asc", lines(ASC_HEAD, ASC_LINES), set(ASC_LINES)),
    ("x.trc", lines(TRC_HEAD, TRC_LINES), set(TRC_LINES)),
    ("x.log", lines("", CANDUMP_LINES), set(CANDUMP_LINES)),
    ("x.csv", lines("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n", GVRET_LINES), set(GVRET_LINES)),
    ("x.txt", lines("Chn Identifier Flg   DLC  D0...1...2\n", KVASER_LINES), set(KVASER_LINES)),
    ("x.blf", blf, {FRAME, FOREIGN, BROKEN}),
)


@pytest.mark.parametrize(("name", "writer", "known"), FORMATS)
@pytest.mark.parametrize("compiled", [True, False])
@given(seed=st.integers(0, 1 << 20), count=st.integers(1, 40))
@settings(max_examples=15, deadline=None)
def test_every_record_is_read_or_skipped_or_damaged(
    name: str,
    writer: Callable[[Sequence[str]], bytes],
    known: set[str],
    seed: int,
    count: int,
    *,
    compiled: bool,
) -> None:
    draw = random.Random(seed)
    records = [FRAME, *(draw.choice(sorted(known)) for _ in range(count))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(writer(records))
        source = stream(path, ReadOptions(compiled=compiled))
        read = sum(len(block) for block in source)

    dates = ("local time", "no date")
    damaged = sum(each.count for each in source.warnings if each.kind not in dates)
    assert read == records.count(FRAME)
    assert sum(source.skipped.values()) == records.count(FOREIGN)
    assert damaged == records.count(BROKEN)


@pytest.mark.parametrize("situation", SITUATIONS, ids=[each.name for each in SITUATIONS])
def test_situations_of_public_bug_reports_are_right(situation: Situation, tmp_path: Path) -> None:
    for name, content in situation.files.items():
        (tmp_path / name).write_bytes(content)
    dbc = tmp_path / situation.dbc if situation.dbc else None

    assert is_right(by_canlog(tmp_path / situation.log, dbc), situation.right)
